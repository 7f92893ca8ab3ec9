"""The options of an augmentation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from simfoundry.evaluate.policies.base import PolicyError
from simfoundry.spec.diagnostics import nearest

# Largest standard deviation of noise that is added to joint targets [rad or m]; arms shake visibly at half of it.
MOST_NOISE = 0.1


class Selection(StrEnum):
    """The order in which the demonstrations are tried as the source of a segment."""

    OBJECT = "object"
    """The one in which the reference stood closest to its present pose comes first."""
    HAND = "hand"
    """The one whose transformed segment starts closest to the hand comes first."""
    RANDOM = "random"
    """In random order."""


class Bridge(StrEnum):
    """The motion of a hand from its present pose to the start of a segment."""

    PLANNED = "planned"
    """A path around obstacles, which the planner of the scripted expert finds."""
    WARPED = "warped"
    """The recorded motion, bent so that it starts and ends at the required poses, without regard to obstacles."""


@dataclass(frozen=True)
class AugmentOptions:
    """The options of an augmentation.

    Attributes:
        select: The order in which the demonstrations are tried as sources.
        bridge: The motion between segments.
        noise: The standard deviation of the noise that is added to joint targets [rad or m].
        use: The number of demonstrations to use, the first ones, or 0 for all.
    """

    select: Selection = Selection.OBJECT
    bridge: Bridge = Bridge.PLANNED
    noise: float = 0.0
    use: int = 0

    @classmethod
    def parse(cls, given: Mapping[str, str | int | float]) -> AugmentOptions:
        """Return the options that are given by name; the others have their defaults.

        Raises:
            PolicyError: If an option is unknown or invalid.
        """
        names = tuple(cls.__dataclass_fields__)
        for name in given:
            if name not in names:
                raise PolicyError(f"`augment` has no option `{name}`; {nearest(name, names)}")
        noise = given.get("noise", 0.0)
        if isinstance(noise, str) or not math.isfinite(noise) or not 0 <= noise <= MOST_NOISE:
            raise PolicyError(f"`noise` of `augment` must be between 0 and {MOST_NOISE:g} rad, not {noise}")
        use = given.get("use", 0)
        if not isinstance(use, int) or use < 0:
            raise PolicyError(f"`use` of `augment` must be a number of demonstrations, or 0 for all, not {use}")
        select = _word(Selection, "select", given.get("select", Selection.OBJECT))
        bridge = _word(Bridge, "bridge", given.get("bridge", Bridge.PLANNED))
        return cls(Selection(select), Bridge(bridge), float(noise), use)

    @property
    def query(self) -> str:
        """The options as the query of a policy, such as ``select=random&bridge=planned&noise=0.01&use=10``."""
        return f"select={self.select}&bridge={self.bridge}&noise={self.noise:g}&use={self.use}"


def _word(kind: type[StrEnum], name: str, value: object) -> str:
    words = [str(one) for one in kind]
    if str(value) not in words:
        raise PolicyError(f"`{name}` of `augment` must be {' or '.join(words)}, not {value}")
    return str(value)
