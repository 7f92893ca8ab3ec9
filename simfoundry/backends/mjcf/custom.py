"""What MuJoCo has no place for, as custom texts and numbers: ``simfoundry import`` gives them back.

A name with a colon is ours: no name of a scene has one. ``cabinet:root`` names the root link, ``cabinet.grip:joint``
the fixed joint that carries a link, ``cabinet.lid:parent`` the link below which a free joint counts its motion and
``cabinet.lid:zero`` where it is zero (position [m], quaternion wxyz); ``cabinet.door:closed`` the limit, `lower` or
`upper`, at which a joint is closed; ``cup:restitution`` what is too
little for a contact to be damped to, for all colliders of a link or for each in turn; ``cup:surface`` friction,
restitution, and resistance against spinning and rolling [m], likewise, where geoms are written as the contact that they
decide on; ``sky:dome`` the colour of a dome light times its intensity; ``arm:robot`` the fields of a robot in JSON, and
``wrist:mount`` which of its frames a camera rides on, where that is a site ``arm.hand``.
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET

from simfoundry.backends.artifact import numbers
from simfoundry.backends.mjcf.contacts import Contacts
from simfoundry.backends.mjcf.restitution import CRITICAL_REBOUND
from simfoundry.backends.mjcf.surfaces import surface_of
from simfoundry.backends.robot_models.mujoco_robot import document_fields
from simfoundry.scene.model import JointType, LightType, Link, Scene, SceneObject
from simfoundry.scene.robot import mujoco_model

MARK = "simfoundry:scene"
"""The text that a file of ours starts with; its data is the version of what stands here."""


def add_texts(root: ET.Element, scene: Scene, contacts: Contacts) -> None:
    """Add ``<custom>``: categories, labels, the stated relations, and the names that MJCF has no elements for."""
    custom = ET.SubElement(root, "custom")
    _text(custom, MARK, "1")
    for item in scene.objects:
        if item.category:
            _text(custom, f"{item.name}.category", item.category)
        if item.labels:
            _text(custom, f"{item.name}.labels", " ".join(item.labels))
        _names(custom, item)
        for link in item.links:
            _surfaces(custom, item.qualified(link.name), link, contacts)
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
    known = {robot.name: words for robot in scene.robots if mujoco_model(robot) and (words := document_fields(robot))}
    for name, words in known.items():
        _text(custom, f"{name}:robot", json.dumps(words))
    for mounted in scene.mounted:
        if mounted.carrier in known and mounted.link:
            _text(custom, f"{mounted.camera.name}:mount", mounted.link)


def _surfaces(custom: ET.Element, name: str, link: Link, contacts: Contacts) -> None:
    """What the geoms of a link do not say of themselves."""
    own = [surface_of(collider) for collider in link.colliders]
    if any(contacts.changed(surface, name) for surface in own):
        rows = own[:1] if len(set(own)) == 1 else own
        _numeric(custom, f"{name}:surface", numbers([value for surface in rows for value in surface]))
    elif any(0 < surface.restitution <= CRITICAL_REBOUND for surface in own):
        values = [surface.restitution for surface in own]
        _numeric(custom, f"{name}:restitution", numbers(values[:1] if len(set(values)) == 1 else values))


def _text(custom: ET.Element, name: str, data: str) -> None:
    ET.SubElement(custom, "text", name=name, data=data)


def _numeric(custom: ET.Element, name: str, data: str) -> None:
    ET.SubElement(custom, "numeric", name=name, data=data)
