"""Devices behind sockets: a TCP connection to a program, or UDP packets from one."""

from __future__ import annotations

import contextlib
import hmac
import json
import socket
from threading import Event, Thread

from simfoundry.errors import SimfoundryError
from simfoundry.teleop.links.link import LOOK_S, READ_BYTES, Channel, TeleopLink
from simfoundry.teleop.sources import LiveSource

# Longest time to wait for a connection [s].
CONNECT_S = 2.0


class SocketChannel(Channel):
    """A TCP connection."""

    def __init__(self, connection: socket.socket) -> None:
        self._socket = connection

    def fileno(self) -> int:
        """Return the file descriptor."""
        return self._socket.fileno()

    def read(self) -> bytes:
        """Return bytes that have arrived."""
        return self._socket.recv(READ_BYTES)

    def write(self, data: bytes) -> None:
        """Send bytes."""
        self._socket.sendall(data)

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


def open_tcp(host: str, port: int) -> Channel:
    """Connect to a program.

    Raises:
        OSError: If it does not answer.
    """
    connection = socket.create_connection((host, port), timeout=CONNECT_S)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return SocketChannel(connection)


class UdpLink(TeleopLink):
    """A link that receives one or more lines of JSON in each UDP packet.

    Attributes:
        port: The port, which differs from the requested one if that was 0.
    """

    def __init__(self, source: LiveSource, host: str, port: int, token: str = "") -> None:
        """Start to receive.

        Args:
            source: Receives the packets.
            host: The address of an interface of this machine.
            port: The port.
            token: What packets must contain as ``"token"``, or empty if only this machine can send them.

        Raises:
            SimfoundryError: If the port cannot be used.
        """
        self._source, self._token, self._ended = source, token.encode(), Event()
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise SimfoundryError(f"packets cannot be received at {host}:{port}: {error.strerror or error}") from None
        self._socket.settimeout(LOOK_S)
        self.port: int = self._socket.getsockname()[1]
        self._thread = Thread(target=self._work, name="teleop-udp", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop receiving."""
        self._ended.set()
        self._thread.join(timeout=5)
        self._socket.close()

    def _work(self) -> None:
        while not self._ended.is_set():
            try:
                data = self._socket.recv(READ_BYTES + 1)
            except TimeoutError:
                continue
            except OSError:  # an earlier answer was refused, which means nothing here
                self._ended.wait(LOOK_S)
                continue
            if len(data) > READ_BYTES:
                self._source.refuse(f"it is longer than {READ_BYTES} bytes")
            elif self._is_accepted(data):
                self._source.packet(data if data.endswith(b"\n") else data + b"\n")
            else:
                self._source.refuse("it does not contain the token")

    def _is_accepted(self, data: bytes) -> bool:
        if not self._token:
            return True
        with contextlib.suppress(ValueError, RecursionError, AttributeError):
            given = json.loads(data).get("token", "")
            return isinstance(given, str) and hmac.compare_digest(given.encode(), self._token)
        return False
