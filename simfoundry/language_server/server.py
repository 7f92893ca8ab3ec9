"""The server: it receives what the editor tells and asks, and passes it on to the modules beside it.

Messages are handled on one thread, documents are checked on another, and names are looked up on a third. A check
consists of two parts, the structure and the geometry, and stops if the editor has sent a newer text.
"""

from __future__ import annotations

import asyncio
import gc
import os
import sys
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import BinaryIO, ParamSpec, TypeVar

from lsprotocol import types
from pygls.lsp.server import LanguageServer

from simfoundry import __version__
from simfoundry.language_server.actions.features import add_actions
from simfoundry.language_server.analysis import Analysis, analyzed, linted
from simfoundry.language_server.completion.features import add_completion
from simfoundry.language_server.diagnostics import published
from simfoundry.language_server.display.features import add_displays
from simfoundry.language_server.navigation.features import add_navigation
from simfoundry.language_server.protocol import Protocol, is_fault_of_client
from simfoundry.language_server.synchronization import add_synchronization
from simfoundry.language_server.workspace import Buffer, Workspace, is_ours

P = ParamSpec("P")
T = TypeVar("T")

# Interval [s] after which a thread passes on the interpreter; the default of 5 ms would delay each answer several times
# while a document is checked.
SWITCH_INTERVAL = 0.0005

# Number of new objects after which Python searches for unreachable ones. Checking 1,000 objects makes some 100,000,
# which are freed without a search. With the default of 700, searches took a third of the time.
GC_THRESHOLD = 50_000


# Maximum number of dependent documents that are checked although they are not open; a scene may have many cousins.
MOST_CLOSED = 50


class _NewerTextError(Exception):
    """Raised to stop a check because the editor has sent a newer text."""


class Server(LanguageServer):
    """A language server for SimFoundry documents."""

    def __init__(self) -> None:
        super().__init__("simfoundry", __version__, protocol_cls=Protocol)
        self.documents = Workspace()
        self._queue: dict[Path, bool] = {}  # documents to check, and whether their text has changed
        self._checking: asyncio.Task[None] | None = None
        self._worker = ThreadPoolExecutor(1, "check")
        self._names_worker = ThreadPoolExecutor(1, "names")
        self.checked: list[Callable[[Analysis], None]] = []  # called with each finished check
        self.closed: list[Callable[[str, Path], None]] = []  # called with each document that the editor has closed

    def report_server_error(self, error: Exception, source: object) -> None:
        """Log an error. Editors interrupt the user with messages that are shown instead."""
        kind = types.MessageType.Warning if is_fault_of_client(error, source) else types.MessageType.Error
        self.window_log_message(types.LogMessageParams(kind, f"{type(error).__name__}: {error}"))

    async def look_up(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Run a function on the thread that looks up names, which does not wait for documents to be checked."""
        return await asyncio.get_running_loop().run_in_executor(self._names_worker, partial(function, *args, **kwargs))

    async def run(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Run a function on the thread that checks documents, after what is already waiting there."""
        return await asyncio.get_running_loop().run_in_executor(self._worker, partial(function, *args, **kwargs))

    def check(self, path: Path, changed: bool = True) -> None:
        """Check a document soon. If its text has changed, check it first, and then the documents that depend on it."""
        others = {other: value for other, value in self._queue.items() if other != path}
        self._queue = {path: True, **others} if changed else {**others, path: self._queue.get(path, False)}
        if self._checking is None or self._checking.done():
            self._checking = asyncio.get_running_loop().create_task(self._check_queue())

    def show(self, buffer: Buffer) -> None:
        """Check an open document after a change of its text, or withdraw its findings if it is of another kind."""
        if is_ours(buffer):
            self.check(buffer.path)
        elif self.documents.latest(buffer.path) is not None:
            self.withdraw(buffer.path)

    @property
    def is_checking(self) -> bool:
        """Return True while documents are checked."""
        return self._checking is not None and not self._checking.done()

    async def idle(self) -> None:
        """Wait until no documents are checked."""
        while self._checking is not None and not self._checking.done():
            await asyncio.wait({self._checking})

    async def current(self, uri: str) -> Analysis | None:
        """Return the analysis of the current text of an open document, or None if it is not open."""
        buffer = self.documents.buffers.get(uri)
        if buffer is None:
            return None
        latest = self.documents.latest(buffer.path)
        if latest is None or latest.lines is not buffer.lines:
            latest = await self._analyzed(buffer.path)
        return latest

    async def _check_queue(self) -> None:
        while self._queue:
            path = next(iter(self._queue))
            changed = self._queue.pop(path)
            try:
                await self._check(path, changed)
            except Exception as error:  # an error of ours must not end the server
                self.window_log_message(types.LogMessageParams(types.MessageType.Error, f"{path}: {error!r}"))

    async def _check(self, path: Path, changed: bool) -> None:
        analysis = await self._analyzed(path)
        if analysis is None:
            self.withdraw(path)
            return
        if not analysis.has_errors:
            try:
                lowered = self.documents.lowered(path)
                earlier = lowered.draft if lowered is not None else None
                analysis = await self.run(linted, analysis, partial(self._stop_for_newer_text, path), earlier)
            except _NewerTextError:
                self._queue.setdefault(path, changed)
                return
            self.documents.store(analysis)
        if path in self._queue:
            return
        if changed:
            self.documents.drop_outdated(path)
        for file in self.documents.report(path, analysis.findings):
            self._publish(file)
        for listener in self.checked:
            listener(analysis)
        if changed:
            self.check_dependents(path, await self.look_up(self.documents.dependents, path))

    def check_dependents(self, path: Path, dependents: Collection[Path]) -> None:
        """Check the documents that depend on one that has changed: those that are open first, then a few others."""
        opened = {buffer.path for buffer in self.documents.buffers.values()}
        closed = [other for other in sorted(dependents) if other not in opened]
        for other in (*sorted(opened & {*dependents} - {path}), *closed[:MOST_CLOSED]):
            self.check(other, changed=False)

    def _stop_for_newer_text(self, path: Path) -> None:
        """Stop a check if the text of this or another document has changed. Called on the thread that checks them."""
        if path in self._queue or any(self._queue.values()):
            raise _NewerTextError

    async def _analyzed(self, path: Path) -> Analysis | None:
        """Analyze the structure of a document, or return None if it is neither open nor can be read."""
        buffer = self.documents.buffer_of(path)
        lines = self.documents.lines(path)
        if lines is None:
            return None
        version = buffer.version if buffer is not None else None
        analysis = await self.run(analyzed, path, lines, version, self.documents.texts)
        self.documents.store(analysis)
        return analysis

    def withdraw(self, path: Path) -> None:
        """Remove the findings of a document that no longer concerns the editor."""
        self.documents.forget(path)
        for file in self.documents.report(path, ()):
            self._publish(file)

    def _publish(self, file: Path) -> None:
        """Send the findings in a file, unless its text has changed since; they then follow with its own check."""
        buffer, latest = self.documents.buffer_of(file), self.documents.latest(file)
        if buffer is not None and (latest is None or latest.lines is not buffer.lines):
            return
        lines = self.documents.lines(file)
        found = published(self.documents.findings(file), lines) if lines is not None else []
        version = buffer.version if buffer is not None else None
        self.text_document_publish_diagnostics(
            types.PublishDiagnosticsParams(self.documents.uri(file), found, version=version)
        )


def make_server() -> Server:
    """Return a server with all features."""
    server = Server()
    for add_features in (add_synchronization, add_displays, add_completion, add_navigation, add_actions):
        add_features(server)
    return server


def serve() -> None:
    """Serve one editor over standard input and output until it ends the connection."""
    sys.setswitchinterval(SWITCH_INTERVAL)
    gc.set_threshold(GC_THRESHOLD)
    make_server().start_io(sys.stdin.buffer, _protocol_output())


def _protocol_output() -> BinaryIO:
    """Return the standard output for the protocol alone. What others print goes to standard error from now on."""
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    return output
