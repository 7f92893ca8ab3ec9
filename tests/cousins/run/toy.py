"""A recipe without a simulator, for tests of runs: what becomes of a candidate is a function of its index alone."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial

from simfoundry.cousins.recipe.candidate import Candidate, Reason
from simfoundry.cousins.run.worker_pools import Work

FUNCTION = "tests.cousins.run.toy:sampler"


def sampler(rate: float) -> Callable[[int], Candidate]:
    return partial(candidate, rate)


@dataclass
class Here:
    """This process, one candidate after the other."""

    work: Work
    size: int = 1
    _asked: list[int] = field(default_factory=list)

    def submit(self, index: int) -> None:
        self._asked.append(index)

    def next(self) -> Candidate:
        return self.work.sampler()(self._asked.pop(0))

    def close(self) -> None:
        pass


def candidate(rate: float, index: int) -> Candidate:
    """Accepted at a rate that is even over the indices; every one takes a time of its own."""
    time.sleep((index * 7919 % 5) * 3e-4)
    share = index * 0.6180339887498949 % 1.0
    if share >= rate:
        code = "narrow" if index % 2 else "wide"
        return Candidate(index, reasons=(Reason(code, f"{share:.3f} is too {code}", {"share": share}),))
    return Candidate(index, {"scene": f"simfoundry: scene/1\nname: toy_{index}\n"}, (f"LeftOf(a{index}, b)",))


def fragile_sampler(mark: str) -> Callable[[int], Candidate]:
    return partial(fragile, mark)


def fragile(mark: str, index: int) -> Candidate:
    """Candidate 3 kills its process the first time, candidate 5 every time, candidate 7 breaks."""
    if index == 5:
        os.kill(os.getpid(), signal.SIGKILL)
    if index == 3:
        with suppress(FileExistsError):
            os.close(os.open(mark, os.O_CREAT | os.O_EXCL))
            os.kill(os.getpid(), signal.SIGKILL)
    if index == 7:
        raise RuntimeError("seven")
    return candidate(1.0, index)
