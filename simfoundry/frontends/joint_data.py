"""The data of joints in documents, from the drafts of an importer."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict

from simfoundry.frontends.document_data import Data, native_data, pose_data, without_empty
from simfoundry.frontends.draft import JointDraft
from simfoundry.frontends.names import NameTable
from simfoundry.spec.yaml.write import to_data


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
    out |= without_empty({"pose": pose_data(joint.X_PC)}) | native_data(joint.native)
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
