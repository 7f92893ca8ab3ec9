"""Serve a user-defined policy over openpi's protocol, so that it can be used like any other policy server."""

from __future__ import annotations

import http
import threading
import traceback
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from simfoundry.evaluate.policies.codec import OPENPI_CODEC
from simfoundry.evaluate.policies.remote import needed

if TYPE_CHECKING:
    from websockets.http11 import Request, Response
    from websockets.sync.server import Server, ServerConnection

# Maximum size of a request [bytes].
LARGEST = 256 * 2**20

# Function that maps an observation to a response with ``actions``, shape (steps, action size).
Infer = Callable[[Mapping[str, Any]], Mapping[str, Any]]


def serve(infer: Infer, metadata: Mapping[str, Any], host: str = "127.0.0.1", port: int = 8000) -> Server:
    """Create a policy server.

    The server runs once its ``serve_forever`` method is called. It sends ``metadata`` when a client connects. If
    ``infer`` raises an exception, the client receives the traceback as text and the connection is closed, as with
    openpi's server. Later connections are not affected. Requests are answered one at a time. ``GET /healthz`` returns
    OK.

    Args:
        infer: The function that computes the response to a request.
        metadata: The first message sent to each client.
        host: The network address to listen on.
        port: The port to listen on. If it is 0, a free port is selected, which can be read from ``server.socket``.
    """
    server = needed("websockets.sync.server", "serving a policy")
    needed("msgpack", "serving a policy")
    one_at_a_time = threading.Lock()

    def handle(connection: ServerConnection) -> None:
        connection.send(OPENPI_CODEC.pack(dict(metadata)))
        for data in connection:
            try:
                if isinstance(data, str):
                    raise ValueError("a request must be a binary message, not text")
                with one_at_a_time:
                    answer = OPENPI_CODEC.pack(dict(infer(OPENPI_CODEC.unpack(data))))
            except Exception:  # report any error to the client
                connection.send(traceback.format_exc())
                connection.close(1011, "the traceback is in the previous message")
                return
            connection.send(answer)

    started: Server = server.serve(
        handle, host, port, compression=None, max_size=LARGEST, ping_interval=None, process_request=_health
    )
    return started


def _health(connection: ServerConnection, request: Request) -> Response | None:
    return connection.respond(http.HTTPStatus.OK, "OK\n") if request.path == "/healthz" else None
