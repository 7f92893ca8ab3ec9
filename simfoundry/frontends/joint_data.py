"""The data of joints in documents, from the drafts of an importer."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from simfoundry.frontends.draft import JointDraft
from simfoundry.frontends.names import NameTable
from simfoundry.geometry.frames import Pose, rpy_from_quat
from simfoundry.spec.yaml.write import to_data

Data = dict[str, Any]

# Positions [m] and quaternion components below these values are rounding noise in double precision.
NO_LENGTH_M, NO_TURN = 1e-12, 1e-10


def pose_data(X_AB: Pose) -> dict[str, Any]:
    """Return a pose as document data, with its rotation in the simplest possible representation."""
    out: dict[str, Any] = {}
    if np.abs(X_AB.p).max() > NO_LENGTH_M:
        out["xyz"] = tuple(X_AB.p.tolist())
    if abs(abs(X_AB.q[0]) - 1) < 1e-15 or np.abs(X_AB.q[1:]).max() < NO_TURN:
        return out
    rpy = tuple(math.degrees(v) for v in rpy_from_quat(X_AB.q))
    if np.abs(X_AB.q[1:3]).max() < NO_TURN:
        out["yaw_deg"] = rpy[2]
    elif all(abs(v - round(v, 3)) < 1e-7 for v in rpy):
        out["rpy_deg"] = rpy
    else:
        out["quat_wxyz"] = tuple(X_AB.q.tolist())
    return out


def joint_entry(
    group: list[JointDraft], links: Mapping[str, str], joints: Mapping[str, str], names: NameTable
) -> tuple[str, Data]:
    """Return the name and the data of a joint, given its axes. A joint with several axes is named after its child."""
    first, *others = (_joint_data(joint, links, joints) for joint in group)
    if not others:
        return joints[group[0].name], first
    ends = {key: first.pop(key) for key in ("parent", "child", "pose") if key in first}
    axes = {joints[group[0].name]: first}
    for joint, data in zip(group[1:], others, strict=True):
        axes[joints[joint.name]] = {key: value for key, value in data.items() if key not in ends}
    return names.name(group[0].child), ends | {"axes": axes}


def _joint_data(joint: JointDraft, links: Mapping[str, str], joints: Mapping[str, str]) -> Data:
    out: Data = {"type": joint.type, "parent": links[joint.parent], "child": links[joint.child]}
    if pose := pose_data(joint.X_PC):
        out["pose"] = pose
    if joint.type in ("fixed", "free"):
        return out
    if joint.type != "ball":
        out["axis"] = tuple(joint.axis.tolist())
    if joint.limits is not None and joint.type == "prismatic":
        out["limits"] = tuple(map(float, joint.limits))
    elif joint.limits is not None and joint.type == "revolute":
        out["limits_deg"] = tuple(map(math.degrees, joint.limits))
    if joint.closed is not None and joint.type in ("revolute", "prismatic"):
        out["closed"] = joint.closed
    out |= {key: float(getattr(joint, key)) for key in ("damping", "friction", "armature") if getattr(joint, key)}
    if joint.effort is not None and joint.type != "ball":
        out["effort"] = float(joint.effort)
    if joint.velocity is not None and joint.type == "prismatic":
        out["velocity"] = float(joint.velocity)
    elif joint.velocity is not None and joint.type != "ball":
        out["velocity_deg"] = math.degrees(joint.velocity)
    if joint.mimic is not None:
        out["mimic"] = asdict(joint.mimic) | {"joint": joints[joint.mimic.joint]}
    if joint.drive is not None:
        out["drive"] = to_data(joint.drive)
    return out
