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
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import BinaryIO, ParamSpec, TypeVar

from lsprotocol import types
from pygls.exceptions import JsonRpcException
from pygls.lsp.server import LanguageServer

from simfoundry import __version__
from simfoundry.language_server import navigation
from simfoundry.language_server.analysis import Analysis, analyzed, linted
from simfoundry.language_server.completion import SIGNATURE_TRIGGERS, TRIGGERS, complete, has_snippets, signature
from simfoundry.language_server.diagnostics import published
from simfoundry.language_server.displays import add_displays
from simfoundry.language_server.protocol import Protocol, RequestFailedError, is_fault_of_client
from simfoundry.language_server.workspace import Buffer, Workspace, is_ours, path_of
from simfoundry.spec.files import MESH_SUFFIXES, PANORAMA_SUFFIXES, PICTURE_SUFFIXES, TEXTURE_SUFFIXES
from simfoundry.spec.names.project import ProjectNames
from simfoundry.spec.names.rename import RenameError

P = ParamSpec("P")
T = TypeVar("T")

# Interval [s] after which a thread passes on the interpreter; the default of 5 ms would delay each answer several times
# while a document is checked.
SWITCH_INTERVAL = 0.0005

# Number of new objects after which Python searches for unreachable ones. Checking 1,000 objects makes some 100,000,
# which are freed without a search. With the default of 700, searches took a third of the time.
GC_THRESHOLD = 50_000

# Suffixes of the files that documents refer to. The editor tells when such a file changes on disk.
WATCHED = (".yaml", *MESH_SUFFIXES, *TEXTURE_SUFFIXES, *PANORAMA_SUFFIXES, *PICTURE_SUFFIXES)


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
    _add_synchronization(server)
    add_displays(server)
    _add_completion(server)
    _add_navigation(server)
    _add_actions(server)
    return server


def _add_synchronization(server: Server) -> None:
    """Register what keeps the texts of the server equal to those of the editor."""
    documents = server.documents

    @server.feature(types.INITIALIZED)
    async def initialized(ls: Server, _: types.InitializedParams) -> None:
        documents.encoding = str(ls.workspace.position_encoding or types.PositionEncodingKind.Utf16.value)
        workspace = ls.client_capabilities.workspace
        watching = workspace.did_change_watched_files if workspace is not None else None
        if watching is not None and watching.dynamic_registration:
            watchers = [types.FileSystemWatcher(f"**/*{suffix}") for suffix in dict.fromkeys(WATCHED)]
            options = types.DidChangeWatchedFilesRegistrationOptions(watchers)
            method = types.WORKSPACE_DID_CHANGE_WATCHED_FILES
            with suppress(JsonRpcException):  # an editor that cannot watch files after all
                await ls.client_register_capability_async(
                    types.RegistrationParams([types.Registration("files", method, options)])
                )

    @server.feature(types.TEXT_DOCUMENT_DID_OPEN)
    async def did_open(ls: Server, params: types.DidOpenTextDocumentParams) -> None:
        item = params.text_document
        ls.show(documents.open(item.uri, item.text, item.version))

    @server.feature(types.TEXT_DOCUMENT_DID_CHANGE)
    async def did_change(ls: Server, params: types.DidChangeTextDocumentParams) -> None:
        item = params.text_document
        buffer = documents.change(item.uri, params.content_changes, item.version)
        if buffer is not None:
            ls.show(buffer)

    @server.feature(types.TEXT_DOCUMENT_DID_SAVE)
    async def did_save(ls: Server, params: types.DidSaveTextDocumentParams) -> None:
        documents.texts.forget()
        documents.rescan()
        path = path_of(params.text_document.uri)
        ls.check_dependents(path, await ls.look_up(documents.dependents, path))

    @server.feature(types.TEXT_DOCUMENT_DID_CLOSE)
    async def did_close(ls: Server, params: types.DidCloseTextDocumentParams) -> None:
        buffer = documents.close(params.text_document.uri)
        if buffer is None:
            return
        for listener in ls.closed:
            listener(buffer.uri, buffer.path)
        dependents = await ls.look_up(documents.dependents, buffer.path)
        if documents.buffer_of(buffer.path) is not None:
            return  # it was opened again
        ls.withdraw(buffer.path)
        concerned = {each.path for each in documents.buffers.values()}
        for path in tuple(concerned):
            concerned |= await ls.look_up(documents.dependents, path)
        concerned |= {each.path for each in documents.buffers.values()}  # those that were opened meanwhile
        for path in documents.analyzed_files() - concerned:
            ls.withdraw(path)
        ls.check_dependents(buffer.path, dependents & concerned)  # they see the text on disk again

    @server.feature(types.WORKSPACE_DID_CHANGE_WATCHED_FILES)
    async def did_change_files(ls: Server, _: types.DidChangeWatchedFilesParams) -> None:
        documents.texts.forget()
        documents.rescan()
        for buffer in documents.buffers.values():
            if is_ours(buffer):
                ls.check(buffer.path, changed=False)


def _add_completion(server: Server) -> None:
    """Register completion and the signatures of predicates. Both use the current text, without waiting for checks."""
    documents = server.documents

    @server.feature(types.TEXT_DOCUMENT_COMPLETION, types.CompletionOptions(trigger_characters=list(TRIGGERS)))
    async def completion(ls: Server, params: types.CompletionParams) -> types.CompletionList | None:
        buffer = documents.buffers.get(params.text_document.uri)
        if buffer is None:
            return None
        snippets = has_snippets(ls.client_capabilities)
        return complete(buffer.path, buffer.lines, params.position, documents.parsed(buffer.path), snippets)

    @server.feature(
        types.TEXT_DOCUMENT_SIGNATURE_HELP, types.SignatureHelpOptions(trigger_characters=list(SIGNATURE_TRIGGERS))
    )
    async def signature_help(_: Server, params: types.SignatureHelpParams) -> types.SignatureHelp | None:
        buffer = documents.buffers.get(params.text_document.uri)
        return signature(buffer.lines, params.position) if buffer is not None else None


_PositionParams = (
    types.DefinitionParams | types.ReferenceParams | types.DocumentHighlightParams | types.PrepareRenameParams
)


def _add_navigation(server: Server) -> None:
    """Register what finds the definitions and uses of names."""
    documents = server.documents

    async def names_at(params: _PositionParams) -> tuple[ProjectNames, Path, int] | None:
        """Return the names of the project, the document and the offset in it, or None if the document is not open."""
        buffer = documents.buffers.get(params.text_document.uri)
        if buffer is None:
            return None
        names = await server.look_up(documents.names, buffer.path)
        return names, buffer.path, buffer.lines.offset(params.position)

    @server.feature(types.TEXT_DOCUMENT_DEFINITION)
    async def definition(params: types.DefinitionParams) -> list[types.Location]:
        at = await names_at(params)
        return navigation.definitions(*at, documents.location) if at is not None else []

    @server.feature(types.TEXT_DOCUMENT_REFERENCES)
    async def references(params: types.ReferenceParams) -> list[types.Location]:
        at = await names_at(params)
        with_definitions = params.context.include_declaration
        return navigation.references(*at, documents.location, with_definitions) if at is not None else []

    @server.feature(types.TEXT_DOCUMENT_DOCUMENT_HIGHLIGHT)
    async def highlight(params: types.DocumentHighlightParams) -> list[types.DocumentHighlight]:
        at = await names_at(params)
        return navigation.highlights(*at, documents.location) if at is not None else []

    @server.feature(types.TEXT_DOCUMENT_PREPARE_RENAME)
    async def prepare_rename(params: types.PrepareRenameParams) -> types.PrepareRenamePlaceholder | None:
        at = await names_at(params)
        if at is None:
            return None
        return navigation.renameable(*at, documents.buffers[params.text_document.uri].lines)

    @server.feature(types.TEXT_DOCUMENT_RENAME, types.RenameOptions(prepare_provider=True))
    async def rename(params: types.RenameParams) -> types.WorkspaceEdit | None:
        buffer = documents.buffers.get(params.text_document.uri)
        if buffer is None:
            return None
        project, offset = documents.project(buffer.path), buffer.lines.offset(params.position)
        try:
            edits = await server.look_up(project.rename, buffer.path, offset, params.new_name)
        except RenameError as error:
            raise RequestFailedError(str(error)) from None
        return navigation.workspace_edit(edits, documents)

    @server.feature(types.WORKSPACE_SYMBOL)
    async def workspace_symbol(params: types.WorkspaceSymbolParams) -> list[types.WorkspaceSymbol]:
        projects = [await server.look_up(documents.names, folder) for folder in documents.folders()]
        return navigation.project_symbols(projects, params.query, documents.location)


def _add_actions(server: Server) -> None:
    """Register the corrections of findings, and the rewrites of values."""
    from simfoundry.language_server.actions import KINDS, code_actions

    @server.feature(types.TEXT_DOCUMENT_CODE_ACTION, types.CodeActionOptions(code_action_kinds=KINDS))
    async def code_action(ls: Server, params: types.CodeActionParams) -> list[types.CodeAction]:
        analysis = await ls.current(params.text_document.uri)
        if analysis is None:
            return []
        findings = [*analysis.findings, *ls.documents.findings(analysis.path)]
        uri, only = params.text_document.uri, params.context.only
        return await ls.run(code_actions, analysis, findings, uri, params.range, only)


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
