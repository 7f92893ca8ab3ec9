"""What MuJoCo has no place for, as custom texts and numbers: ``simfoundry import`` gives them back.

A name with a colon is ours: no name of a scene has one. ``cabinet:root`` names the root link, ``cabinet.grip:joint``
the fixed joint that carries a link, ``cabinet.lid:parent`` the link below which a free joint counts its motion and
``cabinet.lid:zero`` where it is zero (position [m], quaternion wxyz); ``cup:restitution`` what is too
little for a contact to be damped to, for all colliders of a link or for each in turn; ``sky:dome`` the colour of a dome
light times its intensity.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

from simfoundry.backends.artifact import numbers
from simfoundry.backends.mjcf.contacts import CRITICAL_REBOUND
from simfoundry.scene.model import JointType, LightType, Scene, SceneObject

MARK = "simfoundry:scene"
"""The text that a file of ours starts with; its data is the version of what stands here."""


def add_texts(root: ET.Element, scene: Scene) -> None:
    """Add ``<custom>``: categories, labels, the stated relations, and the names that MJCF has no elements for."""
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
    for light in scene.lights:
        if light.type is LightType.DOME:
            _numeric(custom, f"{light.name}:dome", numbers(light.intensity * light.rgb))


def _names(custom: ET.Element, item: SceneObject) -> None:
    _text(custom, f"{item.name}:root", item.root.name)
    for link in item.links:
        values = [c.restitution for c in link.colliders]
        if any(0 < e <= CRITICAL_REBOUND for e in values):
            alike = len(set(values)) == 1
            _numeric(custom, f"{item.qualified(link.name)}:restitution", numbers(values[:1] if alike else values))
    for joint in item.joints:
        child = item.qualified(joint.child)
        if joint.type is JointType.FIXED:
            _text(custom, f"{child}:joint", joint.name)
        elif joint.type is JointType.FREE:
            _text(custom, f"{child}:parent", joint.parent)
            _numeric(custom, f"{child}:zero", numbers([*joint.X_PC.p, *joint.X_PC.q]))


def _text(custom: ET.Element, name: str, data: str) -> None:
    ET.SubElement(custom, "text", name=name, data=data)


def _numeric(custom: ET.Element, name: str, data: str) -> None:
    ET.SubElement(custom, "numeric", name=name, data=data)
