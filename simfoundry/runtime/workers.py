"""Worker processes, which turn a crash, hang or memory exhaustion in a native library into an error message.

A :class:`Worker` calls module-level functions by name. Its process is started on the first call, handles many calls,
and is restarted after a failure. Output from the functions is written to a log, whose last line is quoted in the error
message if a call fails. A :class:`WorkerPool` runs several workers in parallel.

Unlike with multiprocessing, loky and pebble, the caller's script does not need ``if __name__ == "__main__"``, the
timeout restarts with every progress report, and memory is limited.
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
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import IO, Any

from simfoundry.errors import SimfoundryError

_START = "from simfoundry.runtime.workers import serve; serve()"
WAIT_S = 2.0  # Interval between progress reports for a running call [s], short enough to show that it is not stuck

GRACE_S = 5.0  # Time for a worker to close connections and videos before it is killed [s]; normally less than 1 s

# Minimum address space of a worker [bytes]; importing MuJoCo, PyBullet and USD together maps about 4 GiB.
MIN_MEMORY = 6 * 2**30

_LENGTH = 8  # Size of the length field before each message [bytes]


class WorkerError(SimfoundryError):
    """Raised for a failed call. ``how`` describes the failure, and ``doing`` is the last progress report."""

    def __init__(self, how: str, doing: str = "") -> None:
        super().__init__(how)
        self.how, self.doing = how, doing


class CrashError(WorkerError):
    """Raised for a call during which the subprocess ended."""


@dataclass(frozen=True)
class Limits:
    """The limits of a call: the maximum time between progress reports [s] and the address space [bytes]."""

    seconds: float
    memory: int

    @classmethod
    def shared(cls, seconds: float, workers: int) -> Limits:
        """Return limits that give each of ``workers`` an equal share of the machine's memory."""
        if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
            total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
            return cls(seconds, max(MIN_MEMORY, total // workers))
        return cls(seconds, MIN_MEMORY)


class Worker:
    """A subprocess that executes function calls one at a time. It can be used from multiple threads."""

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
        progress: Callable[[str], object] = lambda text: None,
        wait: Callable[[float], object] = lambda seconds: None,
    ) -> Any:
        """Call a function in the subprocess and return its result.

        Args:
            function: The function to call, as ``module:function``.
            *arguments: Arguments of the function.
            progress: Callback that receives each text that the function passes to :func:`report_progress`.
            wait: Callback that is called every :data:`WAIT_S` seconds with the elapsed time of the call [s].

        Raises:
            WorkerError: If the function raised an exception, crashed, or exceeded the limits.
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
                    raise WorkerError(content, last)
                last = content
                progress(content)

    def close(self, grace_s: float = 0.0) -> None:
        """Terminate the process even if it is busy. An idle process has ``grace_s`` seconds to run exit functions."""
        process, self._process = self._process, None
        atexit.unregister(self.close)
        if process is not None and self._owner == os.getpid():  # otherwise, the process belongs to the parent of a fork
            assert process.stdin is not None
            if grace_s > 0:
                with suppress(OSError, subprocess.TimeoutExpired):
                    process.stdin.close()
                    process.wait(grace_s)
            process.kill()
            process.wait()
            with suppress(OSError):
                process.stdin.close()

    def _send(self, message: bytes) -> None:
        """Send a call, restarting the process if it has died since the last call."""
        for attempt in (1, 2):
            if self._process is not None and (self._owner != os.getpid() or self._process.poll() is not None):
                self.close()
            if self._process is None:
                self._start()
            process = self._process
            if process is None or process.stdin is None:  # closed by another thread
                raise WorkerError("was stopped")
            try:
                process.stdin.write(len(message).to_bytes(_LENGTH, "little") + message)
                process.stdin.flush()
                return
            except OSError:
                self.close()
                if attempt == 2:
                    raise WorkerError("exited before it received the call") from None

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
                    raise WorkerError(f"did not respond for {self.limits.seconds:g} s", last) from None
                wait()
        if message is not None:
            kind, content = pickle.loads(message)
            return kind, content
        process = self._process
        if process is None:
            raise WorkerError("was stopped", last)
        how = _ending(process.wait()) + self._last_output()
        self.close()
        raise CrashError(how, last)

    def _start(self) -> None:
        """Start the process in a thread that forwards its responses and sends None when the process exits.

        The thread must live as long as the process, because on Linux the process dies with the thread that started it.
        """
        path = os.pathsep.join(dict.fromkeys(str(Path(p).absolute()) for p in sys.path))  # "" means the current folder
        environment = {**os.environ, "PYTHONPATH": path}
        command = [sys.executable, "-P", "-c", _START, str(os.getpid()), str(self.limits.memory)]
        self._owner = os.getpid()
        log = self._log = tempfile.TemporaryFile()  # noqa: SIM115
        answers = self._answers = queue.SimpleQueue()
        started: queue.SimpleQueue[subprocess.Popen[bytes] | OSError] = queue.SimpleQueue()

        def run() -> None:
            pipe = subprocess.PIPE
            try:
                process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=log, env=environment)
            except OSError as error:
                started.put(error)
                return
            started.put(process)
            assert process.stdout is not None
            with process.stdout as stream:
                while len(head := stream.read(_LENGTH)) == _LENGTH:
                    answers.put(stream.read(int.from_bytes(head, "little")))
            answers.put(None)

        threading.Thread(target=run, daemon=True).start()
        process = started.get()
        if isinstance(process, OSError):
            raise WorkerError(f"could not be started ({process})")
        self._process = process
        atexit.register(self.close)

    def _last_output(self) -> str:
        """Return the last line of the log, formatted as a clause for an error message."""
        assert self._log is not None
        self._log.seek(0)
        lines = [line.strip() for line in self._log.read().decode(errors="replace").splitlines() if line.strip()]
        return f"; its last output was: {lines[-1][:200]}" if lines else ""


def _ending(code: int) -> str:
    name = next((known.name for known in signal.Signals if known == -code), f"signal {-code}")
    return f"exited with code {code}" if code >= 0 else f"crashed ({name})"


_send_message: Callable[[str, Any], None] | None = None  # Sends a message to the calling process; None outside a worker

_exit_functions: list[Callable[[], object]] = []


def report_progress(text: str) -> None:
    """Report progress to the caller of a :class:`Worker`, and restart its timeout.

    Outside a worker, this function does nothing.
    """
    if _send_message is not None:
        _send_message("progress", text)


def at_worker_exit(function: Callable[[], object]) -> None:
    """Register a function that runs when this worker shuts down, before the interpreter's own exit functions.

    Functions registered with ``atexit`` would run too late. MuJoCo registers a function there that terminates the GL
    driver, and worlds must be closed before that.
    """
    if function not in _exit_functions:
        _exit_functions.append(function)


def serve() -> None:
    """Handle calls from standard input until it is closed. This is the main loop of a worker process."""
    global _send_message
    parent, memory = map(int, sys.argv[1:])
    _confine(parent, memory)
    calls = os.fdopen(os.dup(0), "rb")
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # libraries print to standard output

    def send(kind: str, content: Any) -> None:
        message = pickle.dumps((kind, content))
        answers.write(len(message).to_bytes(_LENGTH, "little") + message)
        answers.flush()

    _send_message = send
    while len(head := calls.read(_LENGTH)) == _LENGTH:
        function, arguments = pickle.loads(calls.read(int.from_bytes(head, "little")))
        try:
            send("done", resolve_name(function)(*arguments))
        except MemoryError:
            send("raised", f"exceeded its memory limit of {memory / 2**30:.3g} GiB")
        except Exception as error:
            send("raised", f"failed ({type(error).__name__}: {error})")
    run_exit_functions()


def run_exit_functions() -> None:
    """Run the functions that :func:`at_worker_exit` has registered in this process."""
    while _exit_functions:
        _exit_functions.pop(0)()


def _confine(parent: int, memory: int) -> None:
    """Limit the memory of this process, ignore interrupts, and (on Linux) exit when the parent process does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform.startswith("linux"):
        import ctypes

        ctypes.CDLL(None).prctl(1, int(signal.SIGKILL))  # PR_SET_PDEATHSIG for prctl(2)
    if os.name == "posix":
        import resource

        if os.getppid() != parent:
            sys.exit("the parent process has exited")
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        hard = resource.getrlimit(resource.RLIMIT_AS)[1]
        resource.setrlimit(resource.RLIMIT_AS, (memory if hard == resource.RLIM_INFINITY else min(memory, hard), hard))


class WorkerPool:
    """A pool of workers that call functions in parallel. Results are returned in order of completion."""

    def __init__(
        self, size: int, limits: Limits, progress: Callable[[Any, str], object] = lambda key, text: None
    ) -> None:
        """Start ``size`` worker threads.

        ``progress`` receives the key of a call and each text that the call reports. It may be called from any thread.
        """
        self.size, self._progress, self._closed = size, progress, False
        self._calls: queue.SimpleQueue[tuple[Any, str, tuple[Any, ...], int] | None] = queue.SimpleQueue()
        self._results: queue.SimpleQueue[tuple[Any, Any]] = queue.SimpleQueue()
        self._workers = [Worker(limits) for _ in range(size)]
        self._threads = [threading.Thread(target=self._serve, args=(w,), daemon=True) for w in self._workers]
        for thread in self._threads:
            thread.start()

    def submit(self, key: Any, function: str, *arguments: Any, attempts: int = 1) -> None:
        """Queue a call to ``module:function``. If the call fails, it is retried, up to ``attempts`` calls in total."""
        self._calls.put((key, function, arguments, attempts))

    def next(self) -> tuple[Any, Any]:
        """Wait for a call to finish, and return its key and either its result or a :class:`WorkerError`."""
        return self._results.get()

    def close(self, grace_s: float = 0.0) -> None:
        """Terminate all processes, even if they are busy.

        Idle processes have ``grace_s`` seconds to run exit functions.
        """
        self._closed = True  # set first, so that calls interrupted now are not retried
        for worker in self._workers:
            self._calls.put(None)
            worker.close(grace_s)
        deadline = time.monotonic() + GRACE_S
        for worker, thread in zip(self._workers, self._threads, strict=True):
            while thread.is_alive() and time.monotonic() < deadline:
                thread.join(0.05)
                worker.close()  # a call that was about to start its process may do so after the first close
            worker.close()

    def _serve(self, worker: Worker) -> None:
        while (call := self._calls.get()) is not None and not self._closed:
            key, function, arguments, attempts = call
            self._results.put((key, self._call(worker, key, function, arguments, attempts)))

    def _call(self, worker: Worker, key: Any, function: str, arguments: tuple[Any, ...], attempts: int) -> Any:
        for attempt in range(attempts):
            try:
                return worker.call(function, *arguments, progress=lambda text: self._progress(key, text))
            except WorkerError as error:
                if attempt == attempts - 1 or self._closed:
                    return error
                worker.close()  # a fresh process has all of its memory; this one may be short of it
