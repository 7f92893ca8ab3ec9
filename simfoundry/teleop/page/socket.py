"""The socket of the page: packets of the windows in which it is open, one of which drives."""

from __future__ import annotations

import gzip
import json
from contextlib import suppress
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from simfoundry.teleop.commands import ControlPress
from simfoundry.teleop.device import MAX_PACKET, InvalidPacketError, json_object
from simfoundry.teleop.devices.page_keys import HeldKeys
from simfoundry.teleop.keys import KNOWN
from simfoundry.teleop.sources import LiveSource

if TYPE_CHECKING:
    from websockets.asyncio.server import ServerConnection
    from websockets.http11 import Request, Response

SCRIPT, SOCKET = "/teleop.js", "/teleop-socket"

# Devices all of whose packets come from the page.
PAGE_DEVICES = ("keyboard", "gizmo")

# Largest number of windows; each takes little, but an endless number of them does not.
MAX_WINDOWS = 32


class PageSocket:
    """The windows of the page, and the additions to viser's server.

    The window that was opened last drives, until another one asks for it. The packets of the others are ignored.
    """

    def __init__(self, source: LiveSource, device: str, is_headset: bool) -> None:
        """Receive packets for a device; ``is_headset`` is set if a headset's browser may send them."""
        self._source, self._device, self._is_headset = source, device, is_headset
        self._windows: list[ServerConnection] = []
        self._keys = HeldKeys()
        if self._is_source:
            source.lost("no window of the page is open")

    @property
    def _is_source(self) -> bool:
        """True if the device is lost without a window."""
        return self._device in PAGE_DEVICES or self._is_headset

    def extend(self, handler: Any, options: dict[str, Any]) -> Any:
        """Add the script and the socket to viser's server, as :func:`simfoundry.studio.guard.guarded` asks for."""
        answer = options["process_request"]

        def process_request(connection: Any, request: Request) -> Response | None:
            path = request.path.partition("?")[0]
            if path == SCRIPT:
                return _script_response(connection, self.script())
            response: Response | None = answer(connection, request)
            if response is not None and path in ("/", "/index.html") and response.status_code == 200:
                _add_script(response)
            return response

        async def handle(connection: ServerConnection) -> None:
            if connection.request is not None and connection.request.path.partition("?")[0] == SOCKET:
                await self._serve(connection)
            else:
                await handler(connection)

        options["process_request"] = process_request
        return handle

    def script(self) -> str:
        """Return the script of the page, with what it has to know."""
        known = (
            f"const KNOWN_KEYS = {json.dumps(sorted(KNOWN))};\nconst HAS_HEADSET = {json.dumps(self._is_headset)};\n"
        )
        return known + (files(__package__) / "teleop.js").read_text(encoding="utf-8")

    async def _serve(self, connection: ServerConnection) -> None:
        from websockets.exceptions import ConnectionClosed

        if len(self._windows) >= MAX_WINDOWS:
            await connection.close(1013, "too many windows are open")
            return
        with suppress(ConnectionClosed):
            await self._drive(connection)
            async for message in connection:
                data = message.encode() if isinstance(message, str) else message
                if len(data) > MAX_PACKET:
                    self._source.refuse(f"it is longer than {MAX_PACKET} bytes")
                elif data == b'{"take":true}':
                    await self._drive(connection)
                elif connection is self._windows[-1]:
                    self._receive(data)
        self._windows.remove(connection)
        if self._windows:
            with suppress(ConnectionClosed):
                await self._drive(self._windows[-1])
        elif self._is_source:
            self._source.lost("the window of the page was closed")

    async def _drive(self, connection: ServerConnection) -> None:
        """Let a window drive, and tell all of them."""
        from websockets.exceptions import ConnectionClosed

        self._windows = [*(each for each in self._windows if each is not connection), connection]
        self._source.found()
        for each in tuple(self._windows):
            with suppress(ConnectionClosed):
                await each.send(json.dumps({"drives": each is connection}))

    def _receive(self, data: bytes) -> None:
        """Put in a packet of the window that drives. Keys of other devices only control the attempt."""
        if self._device in PAGE_DEVICES:
            self._source.packet(data)
            return
        try:
            found = json_object(data)
            if "keys" in found:
                for command in self._keys.update(found["keys"]):
                    if isinstance(command, ControlPress):
                        self._source.press(command.control)
            elif self._is_headset:
                self._source.packet(data + b"\n")
        except InvalidPacketError as error:
            self._source.refuse(str(error))


def _script_response(connection: Any, text: str) -> Response:
    response: Response = connection.respond(200, text)
    del response.headers["Content-Type"]
    response.headers["Content-Type"] = "application/javascript; charset=utf-8"
    return response


def _add_script(response: Response) -> None:
    """Load the script at the beginning of viser's page, so that it sees keys before the page does."""
    is_packed = response.headers.get("Content-Encoding") == "gzip"
    page = gzip.decompress(response.body) if is_packed else response.body
    page = page.replace(b"<head>", b'<head><script src="teleop.js"></script>', 1)
    response.body = gzip.compress(page) if is_packed else page
    del response.headers["Content-Length"]
    response.headers["Content-Length"] = str(len(response.body))
