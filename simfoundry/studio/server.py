"""The studio's server: the session, its view in the browser, and the watch over its files."""

from __future__ import annotations

import gc
import io
import secrets
import time
from contextlib import redirect_stdout
from pathlib import Path
from threading import Event, Thread
from types import TracebackType
from typing import Self

from simfoundry.errors import SimfoundryError
from simfoundry.studio.guard import LOCAL_HOSTS, TOKEN, ConnectionGuard, guarded
from simfoundry.studio.journal import Journal
from simfoundry.studio.session import StudioSession
from simfoundry.studio.view.window import StudioWindow

# Interval at which files are looked at [s]: changes appear well within a second, and a look takes microseconds.
WATCH_S = 0.05

# Port of viser, which people who know it expect.
DEFAULT_PORT = 8080


def spare_collections() -> None:
    """Let the garbage collector of this process leave alone what is loaded so far.

    A full collection otherwise looks at all imported modules, which takes 0.1 s in the middle of someone's act.
    """
    gc.collect()
    gc.freeze()


class StudioServer:
    """A running studio. It is a context manager, which stops the server at its end."""

    def __init__(
        self,
        path: Path,
        host: str = "localhost",
        port: int = DEFAULT_PORT,
        token: str = "",
        is_editable: bool = True,
        capture: Path | None = None,
        policies: tuple[str, ...] = (),
    ) -> None:
        """Open a document and start the server.

        Args:
            path: The document, a scene or a task.
            host: The address to listen on. A token is required unless it is this machine's own.
            port: The port; if it is taken, the next free one. Zero stands for any free port.
            token: The token that browsers must know; if it is needed and empty, a random one is made.
            is_editable: Whether the document can be edited; otherwise, it is only shown.
            capture: The capture document of the scene; by default, it is searched in the project.
            policies: The policies that can be tried, as in `simfoundry eval`, besides the built-in ones.

        Raises:
            SimfoundryError: If the document cannot be opened, or if the token is not valid.
        """
        import viser

        if token and not TOKEN.match(token):
            raise SimfoundryError("a token consists of at least 16 letters, digits, `-` and `_`")
        is_local = host in LOCAL_HOSTS
        self.token = token or ("" if is_local else secrets.token_urlsafe(24))
        self.session = StudioSession(path)
        self.journal = Journal(self.session) if is_editable else None
        self.host = host
        with guarded(ConnectionGuard(self.token)), redirect_stdout(io.StringIO()):  # viser prints a banner
            self.viser = viser.ViserServer(host="127.0.0.1" if host == "localhost" else host, port=port, verbose=False)
        self.port = self.viser.get_port()
        self.window = StudioWindow(self.session, self.viser, is_editable, capture, self.journal, policies)
        self._ended = Event()
        self._watcher = Thread(target=self._watch, name="studio-watch", daemon=True)
        self._watcher.start()

    @property
    def address(self) -> str:
        """The address to open in a browser, including the token."""
        host = self.host if self.host not in ("0.0.0.0", "::") else "localhost"
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/" + (f"?token={self.token}" if self.token else "")

    def wait(self) -> None:
        """Wait until the server is stopped or the user interrupts the program."""
        while not self._ended.wait(1.0):
            pass

    def stop(self) -> None:
        """Stop the server."""
        if not self._ended.is_set():
            self._ended.set()
            self._watcher.join(timeout=5)
            self.window.close()
            with redirect_stdout(io.StringIO()):
                self.viser.stop()
            if self.journal is not None:
                self.journal.close()

    def _watch(self) -> None:
        """Take in changes of files that have stayed as they are for a moment, so that none is read half written."""
        before = self.session.disk_state()
        while not self._ended.wait(WATCH_S):
            now = self.session.disk_state()
            if now == before:
                continue
            time.sleep(WATCH_S / 2)
            if self.session.disk_state() != now:
                continue
            before = now
            try:
                self.session.poll()
            except (SimfoundryError, OSError) as error:
                self.window.tell("A change on disk was not taken in", str(error), is_error=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
