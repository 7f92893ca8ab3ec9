"""Mimic joints as equality constraints, and drives as actuators."""

from __future__ import annotations

import xml.etree.ElementTree as ET

from simfoundry.backends.artifact import number, numbers
from simfoundry.backends.stable_drives import stable_drives
from simfoundry.scene.model import Drive, Joint, Scene

_RIGID = {"solref": "0.004 1", "solimp": "0.99 0.999 0.001"}
"""The stiffness of a mimic joint; the time constant is two time steps, the smallest stable value."""


def add_mimics(root: ET.Element, scene: Scene) -> None:
    """Add ``<equality>`` with one entry, named ``object.joint``, for each mimic joint.

    MuJoCo's polynomial applies to deviations from the model's initial configuration, in which all joints are at 0.
    """
    followers = [(o.name, j, j.mimic) for o in scene.objects for j in o.joints if j.mimic is not None]
    if not followers:
        return
    equality = ET.SubElement(root, "equality")
    for owner, joint, mimic in followers:
        names = {"name": f"{owner}.{joint.name}", "joint1": f"{owner}.{joint.name}", "joint2": f"{owner}.{mimic.joint}"}
        ET.SubElement(
            equality, "joint", names | {"polycoef": numbers([mimic.offset, mimic.multiplier, 0, 0, 0])} | _RIGID
        )


def add_drives(root: ET.Element, scene: Scene, timestep: float) -> list[float]:
    """Add ``<actuator>`` with one entry, named ``object.joint``, for each drive; return the initial ``ctrl``.

    The control is the target of the drive, within the limits of the joint. ``timestep`` [s] bounds the stiffness.
    """
    driven: list[tuple[str, Joint, Drive]] = []
    for item in scene.objects:
        stable = stable_drives(item, timestep, implicit_damping=True)
        driven += [(item.name, joint, stable[joint.name]) for joint in item.joints if joint.name in stable]
    if not driven:
        return []
    actuator = ET.SubElement(root, "actuator")
    for owner, joint, drive in driven:
        name = f"{owner}.{joint.name}"
        ET.SubElement(actuator, "general", {"name": name, "joint": name} | _spring(joint, drive))
    return [drive.target if drive.stiffness else 0.0 for _, _, drive in driven]


def _spring(joint: Joint, drive: Drive) -> dict[str, str]:
    """Return MuJoCo's gain and bias of a spring and damper: ``stiffness * (ctrl - q) - damping * v``."""
    attributes = {
        "biastype": "affine",
        "gainprm": number(drive.stiffness),
        "biasprm": numbers([0.0, -drive.stiffness, -drive.damping]),
    }
    if drive.stiffness and joint.limits is not None:
        attributes["ctrlrange"] = numbers(joint.limits)
    if drive.force_limit is not None:
        attributes["forcerange"] = numbers([-drive.force_limit, drive.force_limit])
    return attributes
