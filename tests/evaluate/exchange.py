"""Exchanges with websocket servers: recorded on the way, and replayed byte for byte."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Thread
from typing import Any

import msgpack
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.sync.server import Server, ServerConnection, serve

EXCHANGES = Path(__file__).parent / "exchanges"
Frames = list[tuple[str, bytes | str]]
"""Who spoke, ``client`` or ``server``, and what."""


def read_exchange(protocol: str) -> list[Frames]:
    """What was recorded, by connection."""
    found = msgpack.unpackb((EXCHANGES / f"{protocol}.msgpack").read_bytes())
    return [[(who, said) for who, said in connection] for connection in found]


def write_exchange(protocol: str, connections: list[Frames]) -> None:
    """Keep what was recorded."""
    EXCHANGES.mkdir(exist_ok=True)
    (EXCHANGES / f"{protocol}.msgpack").write_bytes(msgpack.packb(connections))


@contextmanager
def running(server: Server) -> Iterator[str]:
    """The address of a server while the block runs."""
    thread = Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"127.0.0.1:{server.socket.getsockname()[1]}"
    finally:
        server.shutdown()
        thread.join(5)


@contextmanager
def handled(handler: Any) -> Iterator[str]:
    """The address of a server of which each connection is given to ``handler``."""
    with running(serve(handler, "127.0.0.1", 0, compression=None, max_size=None, ping_interval=None)) as address:
        yield address


@contextmanager
def replayed(connections: list[Frames]) -> Iterator[tuple[str, list[str]]]:
    """A server that says what was recorded, and notes wherever the client says anything else than then."""
    left, wrong = [*connections], list[str]()

    def play(connection: ServerConnection) -> None:
        if not left:
            wrong.append("one connection too many")
            return
        for k, (who, said) in enumerate(left.pop(0)):
            try:
                if who == "server":
                    connection.send(said)
                elif (got := connection.recv(timeout=5)) != said:
                    wrong.append(f"message {k}: {len(got)} bytes for {len(said)}")
            except (ConnectionClosed, TimeoutError) as error:
                wrong.append(f"message {k}: {error}")
                return
        with suppress(ConnectionClosed, TimeoutError):
            extra = connection.recv(timeout=0.3)
            wrong.append(f"{len(extra)} bytes too many")

    with handled(play) as address:
        yield address, wrong
    wrong += ["a connection too few"] * len(left)


@contextmanager
def relayed(upstream: str) -> Iterator[tuple[str, list[Frames]]]:
    """A server in between, which notes every message of both sides as it passes."""
    noted: list[Frames] = []

    def relay(connection: ServerConnection) -> None:
        frames: Frames = []
        noted.append(frames)
        with connect(f"ws://{upstream}", compression=None, max_size=None, proxy=None) as server:

            def back() -> None:
                with suppress(ConnectionClosed):
                    for said in server:
                        frames.append(("server", said))
                        connection.send(said)
                connection.close()

            thread = Thread(target=back, daemon=True)
            thread.start()
            with suppress(ConnectionClosed):
                for said in connection:
                    frames.append(("client", said))
                    server.send(said)
            server.close()
            thread.join(5)

    with handled(relay) as address:
        yield address, noted
