"""Reach a model in another environment of this machine: a command reads a bundle and writes one.

The command receives the request on its standard input, and writes the answer to its standard output. With the argument
``--describe``, it writes the description of its tasks as JSON.
"""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import tempfile
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from simfoundry.models.contract import ModelError, plain
from simfoundry.models.transports.http import TIMEOUT_S
from simfoundry.models.wire import MAX_BUNDLE_BYTES, MAX_JSON_BYTES, BundleError, read_json

DESCRIBE_S = (
    60.0  # Time limit for a description [s]; activating an environment and importing Python packages takes 10 s
)

CHUNK = 2**20  # Bytes read at a time


@dataclass(frozen=True)
class ProcessTransport:
    """A command that speaks ``bundle/1`` on its standard input and output. It is started once for each request.

    Attributes:
        command: Program and arguments. No shell is involved.
        timeout_s: Time limit for one answer, with the start of the program [s].
    """

    command: tuple[str, ...]
    timeout_s: float = TIMEOUT_S

    @property
    def place(self) -> str:
        """The command."""
        text = " ".join(shlex.join(self.command).split())
        return f"`{text if len(text) <= 80 else f'{text[:77]}...'}`"

    def exchange(self, task: str, digest: str, data: bytes) -> bytes:
        """Run the command with a request, and return the answer's bytes."""
        return self._run(self.command, data, self.timeout_s, MAX_BUNDLE_BYTES)

    def describe(self) -> Mapping[str, Any]:
        """Return the description of the command's tasks."""
        limit_s = min(DESCRIBE_S, self.timeout_s)
        try:
            return read_json(self._run((*self.command, "--describe"), b"", limit_s, MAX_JSON_BYTES), "description")
        except BundleError as error:
            raise ModelError(f"{self.place} {error}") from None

    def _run(self, command: tuple[str, ...], data: bytes, limit_s: float, max_bytes: int) -> bytes:
        with tempfile.TemporaryFile() as log:
            try:
                pipe = subprocess.PIPE
                process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=log, start_new_session=True)
            except (OSError, ValueError) as error:
                raise ModelError(f"{self.place} could not be started ({error})") from None
            reader = _Reader(process, data, max_bytes)
            reader.thread.join(limit_s)
            in_time = not reader.thread.is_alive()
            code = _end(process, wait_s=1.0 if in_time and not reader.is_too_large else 0.0)
            reader.thread.join(1.0)
            if reader.is_too_large:
                raise ModelError(f"{self.place} wrote more than {max_bytes // 2**20} MiB")
            if not in_time:
                raise ModelError(f"{self.place} did not answer within {limit_s:g} s")
            if code:
                how = f"crashed ({signal.Signals(-code).name})" if code < 0 else f"exited with code {code}"
                raise ModelError(f"{self.place} {how}{_last_line(log)}")
            if not reader.output:
                raise ModelError(f"{self.place} wrote no answer{_last_line(log)}")
            return bytes(reader.output)


class _Reader:
    """Feeds a process and reads its output, each in a thread, so that neither side waits for the other."""

    def __init__(self, process: subprocess.Popen[bytes], data: bytes, max_bytes: int) -> None:
        self.output, self.is_too_large = bytearray(), False
        self._process, self._data, self._max_bytes = process, data, max_bytes
        threading.Thread(target=self._feed, daemon=True).start()
        self.thread = threading.Thread(target=self._read, daemon=True)
        self.thread.start()

    def _feed(self) -> None:
        assert self._process.stdin is not None
        with suppress(OSError, ValueError):  # the process may end before it has read everything
            self._process.stdin.write(self._data)
        with suppress(OSError, ValueError):
            self._process.stdin.close()

    def _read(self) -> None:
        assert self._process.stdout is not None
        with suppress(OSError, ValueError):
            while chunk := self._process.stdout.read1(CHUNK):  # type: ignore[attr-defined]
                self.output += chunk
                if len(self.output) > self._max_bytes:
                    self.is_too_large = True
                    return


def _end(process: subprocess.Popen[bytes], wait_s: float) -> int:
    """Wait for a process, kill it and all that it has started, and return its exit code."""
    code: int | None = None
    with suppress(subprocess.TimeoutExpired):
        code = process.wait(wait_s)
    with suppress(OSError):
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
    process.wait()
    for stream in (process.stdin, process.stdout):
        with suppress(OSError, ValueError):
            if stream is not None:
                stream.close()
    # A process that has written its answer but does not exit has answered.
    return code if code is not None else 0


def _last_line(log: Any) -> str:
    log.seek(max(0, log.seek(0, os.SEEK_END) - 10_000))
    lines = [line for line in map(plain, log.read().decode(errors="replace").splitlines()) if line]
    return f"; its last output was: {lines[-1]}" if lines else ""
