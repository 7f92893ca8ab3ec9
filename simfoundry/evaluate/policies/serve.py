"""A policy of one's own behind openpi's protocol, so that every policy comes through the same door."""

from __future__ import annotations

import http
import threading
import traceback
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from simfoundry.evaluate.policies.codec import pack, unpack
from simfoundry.evaluate.policies.missing import needed

if TYPE_CHECKING:
    from websockets.http11 import Request, Response
    from websockets.sync.server import Server, ServerConnection

LARGEST = 256 * 2**20
"""Bytes of the largest question that is taken."""

Infer = Callable[[Mapping[str, Any]], Mapping[str, Any]]
"""An observation to an answer with ``actions``, shape (steps, numbers of an action)."""


def serve(infer: Infer, metadata: Mapping[str, Any], host: str = "127.0.0.1", port: int = 8000) -> Server:
    """A server that answers once ``serve_forever`` of it is called; port 0 takes a free one (``server.socket``).

    It begins with ``metadata``. Where ``infer`` raises, the client gets the traceback as a text and the server hangs
    up, as openpi's does; the next connection finds it whole. One question is answered at a time. ``GET /healthz`` is
    answered with OK.
    """
    server = needed("websockets.sync.server", "serving a policy")
    needed("msgpack", "serving a policy")
    one_at_a_time = threading.Lock()

    def handle(connection: ServerConnection) -> None:
        connection.send(pack(dict(metadata)))
        for data in connection:
            try:
                if isinstance(data, str):
                    raise ValueError("a question is a binary message, not a text")
                with one_at_a_time:
                    answer = pack(dict(infer(unpack(data))))
            except Exception:  # whatever it is, the client is told
                connection.send(traceback.format_exc())
                connection.close(1011, "the traceback is in the message before")
                return
            connection.send(answer)

    started: Server = server.serve(
        handle, host, port, compression=None, max_size=LARGEST, ping_interval=None, process_request=_health
    )
    return started


def _health(connection: ServerConnection, request: Request) -> Response | None:
    return connection.respond(http.HTTPStatus.OK, "OK\n") if request.path == "/healthz" else None
