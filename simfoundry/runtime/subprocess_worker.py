"""Work in processes of their own, so that a crash, a hang or a flood of memory in a native library is an answer.

A :class:`Worker` calls functions of modules by name. Its process starts with the first call, serves many, and is
started anew after it has failed. What a function prints goes to a log, of which the last line is told where it fails.
"""

from __future__ import annotations

import atexit
import os
import pickle
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import IO, Any

from simfoundry.errors import SimfoundryError

_START = "from simfoundry.runtime.subprocess_worker import serve; serve()"
WAIT_S = 2.0
"""How often somebody who waits is told that the call goes on [s]: soon enough to be believed."""

_LENGTH = 8
"""Bytes before each message that say how long it is."""


class FailedError(SimfoundryError):
    """A call that came to no good: how its process ended, and, in ``doing``, what it last said it was doing."""

    def __init__(self, how: str, doing: str = "") -> None:
        super().__init__(how)
        self.how, self.doing = how, doing


@dataclass(frozen=True)
class Limits:
    """What a call may take: seconds without a sign of life, and bytes of address space."""

    seconds: float
    memory: int


class Worker:
    """A process that calls functions, one at a time; usable from several threads."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self._busy = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0
        self._answers: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._log: IO[bytes] | None = None

    def call(
        self,
        function: str,
        *arguments: Any,
        hear: Callable[[str], object] = lambda said: None,
        wait: Callable[[float], object] = lambda seconds: None,
    ) -> Any:
        """What ``module:function`` gives for ``arguments``; ``hear`` gets what it says with :func:`say`.

        ``wait`` is called every :data:`WAIT_S` seconds with how long the call takes already.

        Raises :class:`FailedError` where it raises anything, crashes, or exceeds the limits.
        """
        with self._busy:
            last = ""
            started = time.monotonic()
            self._send(pickle.dumps((function, arguments)))
            while True:
                kind, content = self._receive(last, lambda: wait(time.monotonic() - started))
                if kind == "done":
                    return content
                if kind == "raised":
                    raise FailedError(content, last)
                last = content
                hear(content)

    def close(self) -> None:
        """End the process, whatever it does."""
        process, self._process = self._process, None
        atexit.unregister(self.close)
        if process is not None and self._owner == os.getpid():  # else it belongs to the process that forked this one
            process.kill()
            process.wait()
            assert process.stdin is not None and process.stdout is not None
            process.stdin.close()

    def _send(self, message: bytes) -> None:
        """Send a call; a process that has died since the last one is started anew."""
        for attempt in (1, 2):
            if self._process is not None and (self._owner != os.getpid() or self._process.poll() is not None):
                self.close()
            if self._process is None:
                self._start()
            assert self._process is not None and self._process.stdin is not None
            try:
                self._process.stdin.write(len(message).to_bytes(_LENGTH, "little") + message)
                self._process.stdin.flush()
                return
            except OSError:
                self.close()
                if attempt == 2:
                    raise FailedError("ended before it could be asked") from None

    def _receive(self, last: str, wait: Callable[[], object]) -> tuple[str, Any]:
        deadline = time.monotonic() + self.limits.seconds
        while True:
            left = deadline - time.monotonic()
            try:
                message = self._answers.get(timeout=max(0.0, min(WAIT_S, left)))
                break
            except queue.Empty:
                if left <= WAIT_S:
                    self.close()
                    raise FailedError(f"gave no sign of life for {self.limits.seconds:g} s", last) from None
                wait()
        if message is not None:
            kind, content = pickle.loads(message)
            return kind, content
        if self._process is None:
            raise FailedError("was stopped", last)
        how = _ending(self._process.wait()) + self._said()
        self.close()
        raise FailedError(how, last)

    def _start(self) -> None:
        path = os.pathsep.join(dict.fromkeys(str(Path(p).absolute()) for p in sys.path))  # "" is the current folder
        limits = [str(os.getpid()), str(self.limits.memory)]
        self._log = tempfile.TemporaryFile()  # noqa: SIM115
        self._answers = queue.SimpleQueue()
        self._owner = os.getpid()
        started: queue.SimpleQueue[subprocess.Popen[bytes] | OSError] = queue.SimpleQueue()
        command = [sys.executable, "-P", "-c", _START, *limits]
        arguments = (command, {**os.environ, "PYTHONPATH": path}, self._log, started, self._answers)
        threading.Thread(target=_run, args=arguments, daemon=True).start()
        process = started.get()
        if isinstance(process, OSError):
            raise FailedError(f"cannot be started ({process})")
        self._process = process
        atexit.register(self.close)

    def _said(self) -> str:
        """The last line of the log."""
        assert self._log is not None
        self._log.seek(0)
        lines = [line.strip() for line in self._log.read().decode(errors="replace").splitlines() if line.strip()]
        return f"; it said: {lines[-1][:200]}" if lines else ""


def _run(
    command: list[str],
    environment: dict[str, str],
    log: IO[bytes],
    started: queue.SimpleQueue[subprocess.Popen[bytes] | OSError],
    answers: queue.SimpleQueue[bytes | None],
) -> None:
    """Start a process and hand over what it answers; None at its end.

    The thread that starts a process has to live as long as that: on Linux the process dies with it.
    """
    try:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, env=environment)
    except OSError as error:
        started.put(error)
        return
    started.put(process)
    assert process.stdout is not None
    with process.stdout as stream:
        while len(head := stream.read(_LENGTH)) == _LENGTH:
            message = stream.read(int.from_bytes(head, "little"))
            answers.put(message)
    answers.put(None)


def _ending(code: int) -> str:
    if code >= 0:
        return f"ended with exit code {code}"
    try:
        return f"crashed ({signal.Signals(-code).name})"
    except ValueError:
        return f"crashed (signal {-code})"


_tell: Callable[[str, Any], None] | None = None
"""Sends a message to the process that asked; None where nobody did."""


def say(text: str) -> None:
    """Tell whoever called this function through a :class:`Worker` what is being done; it is a sign of life."""
    if _tell is not None:
        _tell("said", text)


def serve() -> None:
    """Answer calls from standard input until it ends: what a worker's process runs."""
    global _tell
    parent, memory = map(int, sys.argv[1:])
    _confine(parent, memory)
    calls = os.fdopen(os.dup(0), "rb")
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # libraries print to it

    def tell(kind: str, content: Any) -> None:
        message = pickle.dumps((kind, content))
        answers.write(len(message).to_bytes(_LENGTH, "little") + message)
        answers.flush()

    _tell = tell
    while len(head := calls.read(_LENGTH)) == _LENGTH:
        function, arguments = pickle.loads(calls.read(int.from_bytes(head, "little")))
        module, name = function.split(":")
        try:
            tell("done", getattr(import_module(module), name)(*arguments))
        except MemoryError:
            tell("raised", f"ran out of the {memory / 2**30:.3g} GiB of memory that it may use")
        except Exception as error:
            tell("raised", f"broke ({type(error).__name__}: {error})")


def _confine(parent: int, memory: int) -> None:
    """Bound the memory of this process, leave interrupts to its parent, and let it die with that (on Linux)."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform.startswith("linux"):
        import ctypes

        ctypes.CDLL(None).prctl(1, int(signal.SIGKILL))  # PR_SET_PDEATHSIG of prctl(2)
    if os.name == "posix":
        import resource

        if os.getppid() != parent:
            sys.exit("whoever started this is gone")
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        resource.setrlimit(resource.RLIMIT_AS, (memory if hard == resource.RLIM_INFINITY else min(memory, hard), hard))
