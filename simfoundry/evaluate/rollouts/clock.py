"""The time that a rollout spends on each of its parts."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass(frozen=True)
class Timings:
    """The time spent on each part of a rollout [s]."""

    total: float
    physics: float
    render: float
    policy: float
    judge: float


class RolloutClock:
    """A timer that accumulates the time spent on each part of a rollout."""

    def __init__(self) -> None:
        self.spent = dict.fromkeys(("physics", "render", "policy", "judge"), 0.0)
        self.begun = time.perf_counter()

    @contextmanager
    def __call__(self, part: str) -> Iterator[None]:
        """Add the time spent in the block to a part."""
        begun = time.perf_counter()
        try:
            yield
        finally:
            self.spent[part] += time.perf_counter() - begun

    def timings(self) -> Timings:
        """Return the time spent so far."""
        return Timings(total=time.perf_counter() - self.begun, **self.spent)
