"""The ranges of whole-number options, which the Python functions and the command line share."""

from __future__ import annotations

from collections.abc import Iterable
from numbers import Integral
from typing import Final

from simfoundry.errors import SimfoundryError
from simfoundry.runtime.executors import JOBS

# Seeds are those that every generator accepts. Counts exceed what anybody runs, so that a wrong number is refused at
# once instead of after days. A loss curve needs 20 steps.
RANGES: Final = {
    "count": (1, 1_000_000),
    "rollouts": (1, 10_000),
    "seed": (0, 2**31),
    "steps": (20, 10_000_000),
    "jobs": JOBS,
}


def check_ranges(options: Iterable[tuple[str, object]]) -> None:
    """Check options that are named in :data:`RANGES`. None means that an option is not set.

    Raises:
        SimfoundryError: If an option is not a whole number, or is outside its range.
    """
    for name, value in options:
        low, high = RANGES[name]
        if value is None:
            continue
        if isinstance(value, bool) or not isinstance(value, Integral):
            raise SimfoundryError(f"`{name}` must be a whole number, not {value!r}")
        if not low <= int(value) <= high:
            raise SimfoundryError(f"`{name}` must be between {low} and {high}, not {value}")
