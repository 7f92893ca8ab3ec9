"""Joint positions that a document asks for, held against the asset that has the joints."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from simfoundry.spec.checks.checker import Checker, Path_
from simfoundry.spec.scene import Degrees

if TYPE_CHECKING:
    from simfoundry.spec.asset import AssetSpec


def check_joints(
    c: Checker, asset: AssetSpec, given: Mapping[str, float | Degrees], path: Path_, resting: bool = True
) -> None:
    """Findings of positions ``given`` below ``path``; with ``resting``, those not given are held to be 0."""
    for name in given:
        c.name(name, asset.joints, (*path, name), "joint")
    for name, joint in asset.joints.items():
        if name not in given and not resting:
            continue
        place, position = (*path, name), given.get(name, 0.0)
        if joint.type == "fixed" and name in given:
            c.add("SF205", place, f"`{name}` is fixed and has no position", "remove it")
            continue
        if isinstance(position, Degrees) and joint.type == "prismatic":
            c.add("SF103", place, f"`{name}` is prismatic: its position is in metres, not degrees")
            continue
        limits, unit = joint.limits, "m"
        value = position.deg if isinstance(position, Degrees) else position
        if joint.limits_deg is not None:
            limits, unit = joint.limits_deg, "deg"
            value = position.deg if isinstance(position, Degrees) else math.degrees(position)
        if limits is not None and not limits[0] - 1e-9 <= value <= limits[1] + 1e-9:
            message = f"`{name}` at {value:g} {unit} is outside its limits, {limits[0]:g} to {limits[1]:g} {unit}"
            c.add("SF205", place, message, "" if name in given else "give its position in `joints`")
