"""Custom texts and numbers for data that has no MJCF element; ``simfoundry import`` reads them back.

Names that contain a colon are ours, because names in a scene never do. ``cabinet:root`` names the root link,
``cabinet.grip:joint`` the fixed joint that holds a link, ``cabinet.lid:parent`` the link relative to which a free joint
measures its motion, and ``cabinet.lid:zero`` its zero pose (position [m], quaternion wxyz). ``cabinet.door:closed`` is
the limit, `lower` or `upper`, at which a joint is closed. ``sky:dome`` is the color of a dome light times its
intensity. ``arm:robot`` holds the fields of a robot in JSON, and ``wrist:mount`` the frame on which a camera is mounted
if that frame is a site such as ``arm.hand``. ``simfoundry:robots`` lists the bodies of all robots, whose contacts are
not changed.
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET

from simfoundry.backends.artifact import numbers
from simfoundry.backends.mjcf.contact_rules import ROBOTS
from simfoundry.backends.robot_models.mujoco_robot import document_fields
from simfoundry.scene.model import JointType, LightType, Scene, SceneObject
from simfoundry.scene.robot import mujoco_model

MARK = "simfoundry:scene"
"""The text that marks a file as written by this backend; its data is the version of this format."""


def add_texts(root: ET.Element, scene: Scene) -> None:
    """Add ``<custom>``: categories, labels, stated relations, and names for which MJCF has no element."""
    custom = ET.SubElement(root, "custom")
    _text(custom, MARK, "1")
    for item in scene.objects:
        if item.category:
            _text(custom, f"{item.name}.category", item.category)
        if item.labels:
            _text(custom, f"{item.name}.labels", " ".join(item.labels))
        _names(custom, item)
    if scene.relations:
        _text(custom, "relations", "; ".join(str(r) for r in scene.relations))
    _robots(custom, scene)
    for light in scene.lights:
        if light.type is LightType.DOME:
            _numeric(custom, f"{light.name}:dome", numbers(light.intensity * light.rgb))


def _names(custom: ET.Element, item: SceneObject) -> None:
    _text(custom, f"{item.name}:root", item.root.name)
    for joint in item.joints:
        child = item.qualified(joint.child)
        if joint.closed is not None:
            _text(custom, f"{item.name}.{joint.name}:closed", joint.closed)
        if joint.type is JointType.FIXED:
            _text(custom, f"{child}:joint", joint.name)
        elif joint.type is JointType.FREE:
            _text(custom, f"{child}:parent", joint.parent)
            _numeric(custom, f"{child}:zero", numbers([*joint.X_PC.p, *joint.X_PC.q]))


def _robots(custom: ET.Element, scene: Scene) -> None:
    written = [robot for robot in scene.robots if mujoco_model(robot)]
    if written:
        _text(custom, ROBOTS, " ".join(robot.name for robot in written))
    known = {robot.name: fields for robot in written if (fields := document_fields(robot))}
    for name, fields in known.items():
        _text(custom, f"{name}:robot", json.dumps(fields))
    for mounted in scene.mounted:
        if mounted.carrier in known and mounted.link:
            _text(custom, f"{mounted.camera.name}:mount", mounted.link)


def _text(custom: ET.Element, name: str, data: str) -> None:
    ET.SubElement(custom, "text", name=name, data=data)


def _numeric(custom: ET.Element, name: str, data: str) -> None:
    ET.SubElement(custom, "numeric", name=name, data=data)
