"""Where the joints of an asset are, as a document writes it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from simfoundry.spec.models.base import PoseSpec
from simfoundry.spec.models.scene import Degrees

if TYPE_CHECKING:
    from simfoundry.spec.models.asset import AssetSpec

Written = float | Degrees | PoseSpec
"""A position [m or rad], an angle in degrees, or the pose that a ball or free joint has moved to."""


def number(position: Written) -> float:
    """A written position as a number [m or rad]; that of a joint with a pose is 0."""
    if isinstance(position, Degrees):
        return math.radians(position.deg)
    return position if isinstance(position, float | int) else 0.0


def position(asset: AssetSpec, name: str, given: Mapping[str, Written]) -> float:
    """Position [m or rad] of a joint, 0 where none is ``given``; one that follows others is where they lead it.

    Where they lead in a ring, or to no joint, it is 0.
    """
    seen: set[str] = set()
    scale, offset = 1.0, 0.0
    while (joint := asset.joints.get(name)) is not None and joint.mimic is not None:
        if name in seen:
            return 0.0
        seen.add(name)
        scale, offset = scale * joint.mimic.multiplier, offset + scale * joint.mimic.offset
        name = joint.mimic.joint
    return scale * number(given.get(name, 0.0)) + offset if joint is not None else 0.0
