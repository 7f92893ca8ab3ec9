"""A second process beside this one, so that work in Python uses two cores."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from types import TracebackType
from typing import Self, TypeVar

from simfoundry.runtime.parallel import SILENCE_S, usable_cores
from simfoundry.runtime.workers import Limits, Worker, WorkerError

R = TypeVar("R")

# The two processes, in the order in which they are chosen if both are free: this one may have other threads.
_BESIDE, _HERE = 0, 1


class ProcessPair:
    """This process and one beside it, each of which runs one call at a time.

    A call returns the same in both. Until :meth:`start`, and on a machine with a single core, calls run at once in this
    process.
    """

    def __init__(self) -> None:
        self._free, self._waiting = {_HERE}, 0
        self._change = threading.Condition()
        self._worker = Worker(Limits.shared(SILENCE_S, 2))
        self._starting: threading.Thread | None = None
        self.size = 1

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._worker.close()
        while self._starting is not None and self._starting.is_alive():
            self._starting.join(0.05)
            self._worker.close()  # the process may have been started after it was closed

    def start(self, modules: Sequence[str]) -> None:
        """Start the other process, which first imports ``modules``. It takes calls once this is done."""
        if self.size < min(2, usable_cores()):
            self.size = 2
            self._starting = threading.Thread(target=self._start, args=(tuple(modules),), daemon=True)
            self._starting.start()

    def run(self, call: Callable[[], R], beside: bool = False) -> R:
        """Return the result of a call in the process that is free first.

        A failure in the other process, such as too little memory, leads to the same call in this one.

        Args:
            call: A partial of a module-level function, which does not use the pair itself.
            beside: True if the result is not needed soon. If there is another process, it then runs the call when no
                other call waits.
        """
        process = self._take(beside)
        if process is None:
            return call()
        try:
            if process == _BESIDE:
                with suppress(WorkerError):
                    result: R = self._worker.call(f"{__name__}:evaluate", call)
                    return result
            return call()
        finally:
            self._release(process)

    def _take(self, beside: bool) -> int | None:
        """Wait for a free process and return it, or return None if there is only this one, where calls run at once."""
        with self._change:
            self._waiting += not beside
            try:
                self._change.wait_for(lambda: self.size == 1 or self._free_for(beside))
            finally:
                self._waiting -= not beside
                self._change.notify_all()
            if self.size == 1:
                return None
            process = min(self._free_for(beside))
            self._free.remove(process)
            return process

    def _free_for(self, beside: bool) -> set[int]:
        """Return the free processes that a call may take, if it is not the turn of others."""
        if beside:
            return set() if self._waiting else self._free & {_BESIDE}
        return self._free

    def _release(self, process: int) -> None:
        with self._change:
            self._free.add(process)
            self._change.notify_all()

    def _start(self, modules: tuple[str, ...]) -> None:
        try:
            self._worker.call(f"{__name__}:import_modules", modules)
            self._release(_BESIDE)
        except WorkerError:
            with self._change:
                self.size = 1
                self._change.notify_all()


def evaluate(call: Callable[[], R]) -> R:
    """Return the result of a call, in the other process."""
    return call()


def import_modules(names: Sequence[str]) -> None:
    """Import modules, so that the first call does not need to."""
    for name in names:
        import_module(name)
