"""The server of the page, with the same rules for connections as the studio."""

from __future__ import annotations

import io
import secrets
from contextlib import redirect_stdout
from types import TracebackType
from typing import TYPE_CHECKING, Self

from simfoundry.errors import SimfoundryError
from simfoundry.studio.guard import LOCAL_HOSTS, TOKEN, ConnectionGuard, guarded
from simfoundry.teleop.page.socket import PageSocket

if TYPE_CHECKING:
    from viser import ViserServer


def page_token(host: str, token: str) -> str:
    """Return the token that browsers must know: the given one, or a random one if it is needed.

    Raises:
        SimfoundryError: If the token could be guessed or misread.
    """
    if token and not TOKEN.match(token):
        raise SimfoundryError("a token consists of at least 16 letters, digits, `-` and `_`")
    return token or ("" if host in LOCAL_HOSTS else secrets.token_urlsafe(24))


class PageServer:
    """The running server of a page. It is a context manager, which stops the server at its end.

    Attributes:
        viser: The server of the view.
        port: The port.
    """

    def __init__(self, socket: PageSocket, host: str, port: int, token: str) -> None:
        """Start the server.

        Args:
            socket: The socket of the page.
            host: The address to listen on.
            port: The port; if it is taken, the next free one. Zero stands for any free port.
            token: The token that browsers must know, or empty.
        """
        import viser

        self._host, self._token = host, token
        address = "127.0.0.1" if host == "localhost" else host
        with guarded(ConnectionGuard(token), socket.extend), redirect_stdout(io.StringIO()):  # viser prints a banner
            self.viser: ViserServer = viser.ViserServer(host=address, port=port, verbose=False)
        self.port: int = self.viser.get_port()

    @property
    def address(self) -> str:
        """The address to open in a browser, including the token."""
        host = self._host if self._host not in ("0.0.0.0", "::") else "localhost"
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/" + (f"?token={self._token}" if self._token else "")

    def stop(self) -> None:
        """Stop the server."""
        with redirect_stdout(io.StringIO()):
            self.viser.stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
