"""Check joint positions against their asset, and pairs of objects without contact."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from simfoundry.spec.check.checker import Checker, Path_
from simfoundry.spec.models.base import PoseSpec
from simfoundry.spec.models.positions import Written, position
from simfoundry.spec.models.scene import Degrees

if TYPE_CHECKING:
    from simfoundry.spec.models.asset import AssetSpec, JointSpec


def check_joints(c: Checker, asset: AssetSpec, given: Mapping[str, Written], path: Path_, resting: bool = True) -> None:
    """Check the positions ``given`` below ``path``; with ``resting``, missing positions count as 0."""
    for name in given:
        c.name(name, asset.joints, (*path, name), "joint")
    for name, joint in asset.joints.items():
        if name not in given and not resting:
            continue
        place = (*path, name)
        if name in given and not _fits(c, name, joint, given[name], place):
            continue
        _within(c, name, joint, position(asset, name, given), place, "" if name in given else _remedy(joint))


def check_target(c: Checker, name: str, joint: JointSpec, target: float, path: Path_) -> None:
    """Check that the target of a drive [m or rad] lies within the limits of its joint."""
    _within(c, f"the target of `{name}`", joint, target, path, "", quoted=False)


def check_pair(c: Checker, pair: tuple[str, str], k: int, seen: set[frozenset[str]]) -> None:
    """Check that pair ``k`` of `no_contact` names two different objects and is unique; add it to ``seen``."""
    if pair[0] == pair[1]:
        c.add("SF212", ("no_contact", k), f"`{pair[0]}` is paired with itself", "name two objects")
    elif frozenset(pair) in seen:
        c.add("SF212", ("no_contact", k), f"the pair `{pair[0]}` and `{pair[1]}` is listed twice", "remove one of them")
    seen.add(frozenset(pair))


def _fits(c: Checker, name: str, joint: JointSpec, written: Written, place: Path_) -> bool:
    """Check that a position has the form that the joint type requires."""
    if joint.type == "fixed":
        c.add("SF205", place, f"`{name}` is fixed and has no position", "remove it")
    elif joint.mimic is not None:
        hint = "remove it, and give the position of the other"
        c.add("SF205", place, f"`{name}` follows `{joint.mimic.joint}`", hint)
    elif joint.type in ("ball", "free") and not isinstance(written, PoseSpec):
        hint = "give a rotation, as `{rpy_deg: [10, 0, 20]}`" if joint.type == "ball" else "give a pose"
        c.add("SF103", place, f"`{name}` is {joint.type}: its position cannot be one number", hint)
    elif joint.type not in ("ball", "free") and isinstance(written, PoseSpec):
        c.add("SF103", place, f"`{name}` is {joint.type}: its position is one number, not a pose")
    elif joint.type == "ball" and isinstance(written, PoseSpec) and any(written.xyz):
        c.add("SF205", place, f"`{name}` is a ball joint and cannot be moved by `xyz`", "give a rotation only")
    elif isinstance(written, Degrees) and joint.type == "prismatic":
        c.add("SF103", place, f"`{name}` is prismatic: its position is in meters, not degrees")
    else:
        return True
    return False


def _within(
    c: Checker, name: str, joint: JointSpec, value: float, place: Path_, hint: str, quoted: bool = True
) -> None:
    """Check that a position [m or rad] lies within the limits of a joint."""
    limits, unit = joint.limits, "m"
    if joint.limits_deg is not None:
        limits, unit, value = joint.limits_deg, "deg", math.degrees(value)
    if limits is not None and not limits[0] - 1e-9 <= value <= limits[1] + 1e-9:
        shown = f"`{name}`" if quoted else name
        message = f"{shown} at {value:g} {unit} is outside its limits, {limits[0]:g} to {limits[1]:g} {unit}"
        c.add("SF205", place, message, hint)


def _remedy(joint: JointSpec) -> str:
    if joint.mimic is not None:
        return f"it follows `{joint.mimic.joint}`: give another position of that in `joints`"
    return "give its position in `joints`"
