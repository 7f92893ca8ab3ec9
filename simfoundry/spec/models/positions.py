"""Joint positions as written in documents."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from simfoundry.spec.models.base import PoseSpec
from simfoundry.spec.models.scene import Degrees

if TYPE_CHECKING:
    from simfoundry.spec.models.asset import AssetSpec

Written = float | Degrees | PoseSpec
"""Position [m or rad], angle in degrees, or pose of a ball or free joint."""


def number(position: Written) -> float:
    """Convert a written position to a number [m or rad]; 0 for a joint with a pose."""
    if isinstance(position, Degrees):
        return math.radians(position.deg)
    return position if isinstance(position, float | int) else 0.0


def position(asset: AssetSpec, name: str, given: Mapping[str, Written]) -> float:
    """Return the position [m or rad] of a joint, 0 if not ``given``; a mimic joint follows its leader.

    If the leaders form a cycle or a leader does not exist, the position is 0.
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
