"""Objects as MJCF bodies: links, joints, geoms."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np

from simfoundry.backends.artifact import number, numbers
from simfoundry.backends.mjcf.contacts import solref
from simfoundry.backends.mjcf.meshes import Assets
from simfoundry.scene.frames import Pose
from simfoundry.scene.meshfile import has_texture
from simfoundry.scene.model import (
    Background,
    Box,
    Capsule,
    Collider,
    Cylinder,
    Geometry,
    Joint,
    JointType,
    Link,
    Mesh,
    SceneObject,
    Sphere,
    Visual,
    principal_inertia,
)


def add_object(world: ET.Element, item: SceneObject, assets: Assets) -> list[float]:
    """Add an object's bodies to the world; returns its initial ``qpos`` in MuJoCo's depth-first order."""
    body = ET.SubElement(world, "body", {"name": item.name} | pose_attributes(item.X_WO))
    qpos: list[float] = []
    if not item.fixed:
        ET.SubElement(body, "freejoint", name=item.name)
        qpos = [*item.X_WO.p, *item.X_WO.q]
    _fill_body(body, item, item.root, assets)
    links = {link.name: link for link in item.links}
    joints_by_parent: dict[str, list[Joint]] = {}
    for joint in item.joints:
        joints_by_parent.setdefault(joint.parent, []).append(joint)
    pending = [(body, joint) for joint in reversed(joints_by_parent.get(item.root.name, []))]
    while pending:  # depth first, children in the order of the joints
        parent, joint = pending.pop()
        child = _add_child(parent, item, joint, links[joint.child], assets)
        if joint.type is not JointType.FIXED:
            qpos.append(joint.position)
        pending.extend((child, below) for below in reversed(joints_by_parent.get(joint.child, [])))
    return qpos


def add_background(world: ET.Element, background: Background, assets: Assets) -> None:
    """Add what is seen around the scene; its geoms touch nothing."""
    for visual in background.visuals:
        posed = replace(visual, X_LG=background.X_WB @ visual.X_LG)
        _add_visual(world, f":background:{visual.name}", posed, assets)


def _add_child(parent: ET.Element, item: SceneObject, joint: Joint, link: Link, assets: Assets) -> ET.Element:
    body = ET.SubElement(parent, "body", {"name": item.qualified(link.name)} | pose_attributes(joint.X_PC))
    if joint.type is not JointType.FIXED:
        attributes = {
            "name": f"{item.name}.{joint.name}",
            "type": "slide" if joint.type is JointType.PRISMATIC else "hinge",
            "axis": numbers(joint.axis),
        }
        if joint.limits is not None and joint.type is not JointType.CONTINUOUS:
            attributes["range"] = numbers(joint.limits)
        for key, value in (("damping", joint.damping), ("frictionloss", joint.friction), ("armature", joint.armature)):
            if value:
                attributes[key] = number(value)
        ET.SubElement(body, "joint", attributes)
    _fill_body(body, item, link, assets)
    return body


def _fill_body(body: ET.Element, item: SceneObject, link: Link, assets: Assets) -> None:
    """The mass properties and geoms of a link."""
    moments, q = principal_inertia(link.inertia)
    inertial = {"pos": numbers(link.com), "mass": number(link.mass), "diaginertia": numbers(moments)}
    ET.SubElement(body, "inertial", inertial | _turn(q))
    name = item.qualified(link.name)
    for visual in link.visuals:
        _add_visual(body, f"{name}:{visual.name}", visual, assets)
    for collider in link.colliders:
        _add_collider(body, f"{name}.{collider.name}", collider, assets)


def _add_visual(body: ET.Element, name: str, visual: Visual, assets: Assets) -> None:
    attributes = {"class": "visual", "name": name} | pose_attributes(visual.X_LG)
    attributes |= _shape(visual.geometry, assets, collides=False)
    if isinstance(visual.geometry, Mesh) and visual.geometry.texture is not None and has_texture(visual.geometry):
        attributes["material"] = assets.material(visual.geometry.texture, visual.rgba)
    else:
        attributes["rgba"] = numbers(visual.rgba)
    ET.SubElement(body, "geom", attributes)


def _add_collider(body: ET.Element, name: str, collider: Collider, assets: Assets) -> None:
    attributes = {"class": "collider", "name": name} | pose_attributes(collider.X_LG)
    attributes |= _shape(collider.geometry, assets, collides=True)
    attributes["friction"] = f"{number(collider.friction)} 0.005 0.0001"
    if collider.restitution > 0:
        attributes["solref"] = numbers(solref(collider.restitution))
    ET.SubElement(body, "geom", attributes)


def _shape(geometry: Geometry, assets: Assets, collides: bool) -> dict[str, str]:
    """Type and size of a geom; MuJoCo takes half extents and half heights."""
    match geometry:
        case Box(size=size):
            return {"type": "box", "size": numbers(np.asarray(size) / 2)}
        case Sphere(radius=radius):
            return {"type": "sphere", "size": number(radius)}
        case Cylinder(radius=radius, height=height):
            return {"type": "cylinder", "size": numbers([radius, height / 2])}
        case Capsule(radius=radius, height=height):
            return {"type": "capsule", "size": numbers([radius, height / 2])}
        case Mesh():
            return {"type": "mesh", "mesh": assets.mesh(geometry, collides)}


def pose_attributes(pose: Pose) -> dict[str, str]:
    """``pos`` and ``quat`` (wxyz) of a pose, without what is zero."""
    return ({"pos": numbers(pose.p)} if pose.p.any() else {}) | _turn(pose.q)


def _turn(q: np.ndarray) -> dict[str, str]:
    return {"quat": numbers(q)} if q[1:].any() else {}
