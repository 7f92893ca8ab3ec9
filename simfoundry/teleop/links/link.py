"""The contract of links, and the loop of those that read bytes."""

from __future__ import annotations

import os
import select
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from threading import Event, Thread
from types import TracebackType
from typing import Protocol, Self

from simfoundry.teleop.sources import LiveSource

# Largest number of bytes to read at once.
READ_BYTES = 4096

# Interval at which a lost device is searched [s]: a person who plugs it in again waits no longer than that.
RETRY_S = 0.5

# Longest time to wait for bytes [s], after which a link looks whether it should end.
LOOK_S = 0.1


class TeleopLink(ABC):
    """A link, which puts packets into a source while it is open. It is a context manager."""

    @abstractmethod
    def close(self) -> None:
        """Stop receiving."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class Channel(Protocol):
    """An open connection to a device."""

    def fileno(self) -> int:
        """Return the file descriptor to wait for."""

    def read(self) -> bytes:
        """Return bytes that have arrived, or nothing if the other end is closed."""

    def write(self, data: bytes) -> None:
        """Send bytes."""

    def close(self) -> None:
        """Close the connection."""


class FileChannel(Channel):
    """A device file."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def fileno(self) -> int:
        """Return the file descriptor."""
        return self._descriptor

    def read(self) -> bytes:
        """Return what one read gives, which is one report of an HID device."""
        return os.read(self._descriptor, READ_BYTES)

    def write(self, data: bytes) -> None:
        """Send bytes."""
        os.write(self._descriptor, data)

    def close(self) -> None:
        """Close the file."""
        os.close(self._descriptor)


class ByteLink(TeleopLink):
    """A link that reads bytes from a device, which can be unplugged and plugged in again."""

    def __init__(
        self,
        source: LiveSource,
        what: str,
        connect: Callable[[], Channel],
        request: bytes = b"",
        request_s: float = LOOK_S,
        complete: bytes = b"",
    ) -> None:
        """Start to read.

        Args:
            source: Receives what is read.
            what: The device, for sentences about it, such as ``the SpaceMouse``.
            connect: Function that opens a connection, and raises `OSError` if it cannot.
            request: Bytes that ask the device for an answer, or nothing if it sends by itself.
            request_s: Interval between requests [s].
            complete: Bytes that end each read, if the connection keeps packets apart.
        """
        self._source, self._what, self._connect = source, what, connect
        self._request, self._request_s, self._complete = request, request_s, complete
        self._ended = Event()
        self._thread = Thread(target=self._work, name="teleop-link", daemon=True)
        source.lost(f"{what} is not connected yet")
        self._thread.start()

    def close(self) -> None:
        """Stop reading."""
        self._ended.set()
        self._thread.join(timeout=5)

    def _work(self) -> None:
        while not self._ended.is_set():
            try:
                channel = self._connect()
            except OSError as error:
                self._source.lost(f"{self._what} cannot be opened: {_reason(error)}")
                self._ended.wait(RETRY_S)
                continue
            self._source.found()
            try:
                reason = self._read(channel)
            except OSError as error:
                reason = _reason(error)
            finally:
                channel.close()
            self._source.lost(f"{self._what} was unplugged or closed: {reason}")
            self._ended.wait(RETRY_S)

    def _read(self, channel: Channel) -> str:
        """Read until the device is lost or the link is closed, and return the reason."""
        asked = -self._request_s
        while not self._ended.is_set():
            now = time.monotonic()
            if self._request and now - asked >= self._request_s:
                channel.write(self._request)
                asked = now
            timeout = min(LOOK_S, max(0.0, asked + self._request_s - now)) if self._request else LOOK_S
            if select.select([channel], [], [], timeout)[0]:
                data = channel.read()
                if not data:
                    return "the other end was closed"
                self._source.packet(data + self._complete)
        return "the session has ended"


def _reason(error: OSError) -> str:
    return error.strerror or str(error) or type(error).__name__
