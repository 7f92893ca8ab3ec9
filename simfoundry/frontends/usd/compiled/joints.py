"""Joint positions that a user changed, either at the joint or by moving its child."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from simfoundry.frontends.usd.compiled.stage import StageMember, Values, placed
from simfoundry.frontends.usd.compiled.values import StageNote
from simfoundry.geometry.frames import Pose
from simfoundry.scene.state import STILL

_OFF_M, _OFF_RAD = 1e-3, 1e-2
"""Tolerances [m, rad] within which a link counts as moved along its joint, because manual moves are inexact."""


def edited_joints(part: StageMember, data: dict[str, Any], handled: set[tuple[str, str]]) -> Iterator[StageNote]:
    """Write changed joint positions of ``part`` into ``data``; joint attributes take precedence over link poses."""
    joints = dict(data.get("joints", {}))
    for relative, values in part.built.items():
        found = next((name for name in values if name.startswith("state:") and name.endswith(":position")), "")
        kind = found.split(":")[1] if found else ""
        if kind not in ("linear", "angular") or relative not in part.now:
            continue
        handled |= {(relative, found), (relative, f"newton:{kind}:position")}
        unit = 1.0 if kind == "linear" else math.degrees(1.0)
        old = values[found] / unit
        positions = [part.now[relative].get(name) for name in (found, f"newton:{kind}:position")]
        stated = [v / unit for v in positions if v is not None and abs(v / unit - old) > STILL]
        child, moved, off = _moved(part, relative, kind)
        handled.add((child, "at"))
        new = stated[0] if stated else old + moved
        if not stated and off:
            yield StageNote(
                f"{part.path}/{child}", "it was moved off its joint; what of it goes along the joint is kept"
            )
        name = relative.rpartition("/")[2]
        if abs(new - old) > STILL:
            joints[name] = _written(new, isinstance(joints.get(name), dict))
    if joints != data.get("joints", {}):
        data["joints"] = joints


def _written(position: float, degrees: bool) -> Any:
    return {"deg": round(math.degrees(position), 2) + 0.0} if degrees else round(position, 4) + 0.0


def _moved(part: StageMember, relative: str, kind: str) -> tuple[str, float, bool]:
    """Return the child link of a joint, its motion along the joint [m or rad], and whether it left the joint."""
    prim = part.prim.GetPrimAtPath(relative)
    bodies = [_target(part, prim, name) for name in ("physics:body0", "physics:body1")]
    parent, child = bodies
    X_PC_old, X_PC_new = (_at(v, parent).inverse() @ _at(v, child) for v in (part.built, part.now))
    step = X_PC_old.inverse() @ X_PC_new  # the motion in the child's frame, where the axis stands still
    values = part.built[relative]
    axis = Pose.of(q=values.get("physics:localRot1", (1.0, 0.0, 0.0, 0.0))).apply(
        np.eye(3)["XYZ".index(values.get("physics:axis", "X"))]
    )
    angle = 2.0 * math.atan2(float(step.q[1:] @ axis), float(step.q[0]))
    along = float(step.p @ axis)
    if kind == "linear":
        off = np.linalg.norm(step.p - along * axis) > _OFF_M or step.angle_to(Pose.of()) > _OFF_RAD
        return child, along, bool(off)
    turn = Pose.of(q=np.concatenate([[math.cos(angle / 2)], math.sin(angle / 2) * axis]))
    return child, angle, bool(np.linalg.norm(step.p) > _OFF_M or turn.angle_to(step) > _OFF_RAD)


def _target(part: StageMember, joint: Any, name: str) -> str:
    targets = joint.GetRelationship(name).GetTargets()
    return str(targets[0].MakeRelativePath(part.prim.GetPath())) if targets else ""


def _at(values: Values, link: str) -> Pose:
    return placed(values.get(link, {}).get("at"))[0]
