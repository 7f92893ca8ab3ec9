"""Conversion of objects to URDF elements, with one file per freely moving part."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from simfoundry.backends.artifact import number, numbers
from simfoundry.backends.urdf.features import UNBOUNDED_M, UNLIMITED
from simfoundry.backends.xmltext import DECLARATION, xml_text
from simfoundry.geometry.frames import IDENTITY, Array, Pose, rpy_from_quat
from simfoundry.geometry.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Geometry, Mesh, Sphere, tessellate
from simfoundry.scene.kinematics import Tree, trees
from simfoundry.scene.meshfile import has_texture, obj_with_material, texture_name
from simfoundry.scene.model import Background, Joint, JointType, Link, Scene, SceneObject, Visual

# A function that splits a geometry into parts that a dialect supports, and yields a name suffix, the part and its pose
# ``X_GP`` for each of them.
Split = Callable[[Geometry], Iterator[tuple[str, Geometry, Pose]]]


@dataclass(frozen=True)
class Dialect:
    """The features that a URDF reader supports.

    Attributes:
        visual: A function that splits visual geometries.
        collision: A function that splits collision geometries.
        ball: The joint type for ball joints, or None to weld the child link in its initial pose.
    """

    visual: Split
    collision: Split
    ball: str | None = None


# Rows and columns of the inertia matrix, in the customary order of URDF's attributes.
_TENSOR = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def urdf_files(scene: Scene, dialect: Dialect) -> dict[str, bytes]:
    """Return the URDFs of all objects (one per freely moving part) and their shared assets, keyed by path."""
    files: dict[str, bytes] = {}
    for item in scene.objects:
        texts = _WRITTEN.get(item)
        if texts is None:
            texts = {f"{tree.name}.urdf": _tree_text(tree, dialect, files) for tree in trees(item)}
            if _is_plain(item):
                _WRITTEN[item] = texts
        files |= texts
    return files


# Texts that are identical in all dialects, cached for the lifetime of the object; most scenes use two dialects.
_WRITTEN: WeakKeyDictionary[SceneObject, dict[str, bytes]] = WeakKeyDictionary()


def _is_plain(item: SceneObject) -> bool:
    """Return true if the URDF of an object is the same in all dialects.

    This is the case if there is no geometry to split and there are no ball joints.
    """
    shapes = [v.geometry for k in item.links for v in k.visuals] + [c.geometry for k in item.links for c in k.colliders]
    joints = [joint for joint in item.joints if joint.type is JointType.BALL]
    return not joints and all(isinstance(shape, Box | Sphere | Cylinder) for shape in shapes)


def _tree_text(tree: Tree, dialect: Dialect, files: dict[str, bytes]) -> bytes:
    """Return the URDF of a single tree of links, and add its assets to ``files``."""
    root = ET.Element("robot", name=tree.name)
    for link in tree.links:
        _add_link(root, link, dialect, files)
    for joint in tree.joints:
        _add_joint(root, joint, dialect)
    return DECLARATION + xml_text(root)


def background_urdf(background: Background, known: Mapping[str, bytes]) -> dict[str, bytes]:
    """Return the files in ``known``, plus a URDF of the background and its assets.

    The URDF has a single link, which is in the world frame and contains only visuals.
    """
    files = dict(known)
    root = ET.Element("robot", name="background")
    element = ET.SubElement(root, "link", name="background")
    _add_mass(element, 0.0, np.zeros((3, 3)))  # otherwise readers assume a mass and print a warning
    for visual in background.visuals:
        shape = _add_shape(element, "visual", visual.name, visual.geometry, background.X_WB @ visual.X_LG, files)
        _add_material(shape, visual)
    files["_background.urdf"] = DECLARATION + xml_text(root)
    return files


def whole(geometry: Geometry) -> Iterator[tuple[str, Geometry, Pose]]:
    """Yield the geometry unchanged, for dialects that support capsules."""
    yield "", geometry, IDENTITY


def capsule_parts(geometry: Geometry) -> Iterator[tuple[str, Geometry, Pose]]:
    """Yield the geometry, replacing a capsule, which URDF does not support, by a cylinder and two spheres."""
    if not isinstance(geometry, Capsule):
        yield "", geometry, IDENTITY
        return
    yield "_tube", Cylinder(geometry.radius, geometry.height), IDENTITY
    yield "_top", Sphere(geometry.radius), Pose.of([0.0, 0.0, geometry.height / 2])
    yield "_bottom", Sphere(geometry.radius), Pose.of([0.0, 0.0, -geometry.height / 2])


def _add_link(root: ET.Element, link: Link, dialect: Dialect, files: dict[str, bytes]) -> None:
    element = ET.SubElement(root, "link", name=link.name)
    _add_mass(element, link.mass, link.inertia, Pose.of(link.com))
    for visual in link.visuals:
        for suffix, geometry, X_GP in dialect.visual(visual.geometry):
            shape = _add_shape(element, "visual", visual.name + suffix, geometry, visual.X_LG @ X_GP, files)
            _add_material(shape, visual)
    for collider in link.colliders:
        for suffix, geometry, X_GP in dialect.collision(collider.geometry):
            _add_shape(element, "collision", collider.name + suffix, geometry, collider.X_LG @ X_GP, files)


def _add_mass(link: ET.Element, mass: float, inertia: Array, X_LC: Pose = IDENTITY) -> None:
    inertial = ET.SubElement(link, "inertial")
    _add_origin(inertial, X_LC)
    ET.SubElement(inertial, "mass", value=number(mass))
    ET.SubElement(inertial, "inertia", {f"i{'xyz'[a]}{'xyz'[b]}": number(inertia[a, b]) for a, b in _TENSOR})


def _add_origin(parent: ET.Element, pose: Pose) -> None:
    if not pose.is_identity:
        ET.SubElement(parent, "origin", xyz=numbers(pose.p), rpy=numbers(rpy_from_quat(pose.q)))


def _add_shape(
    link: ET.Element, tag: str, name: str, geometry: Geometry, X_LG: Pose, files: dict[str, bytes]
) -> ET.Element:
    """Add a visual or collision element to a link, and add its mesh assets to ``files``."""
    shape = ET.SubElement(link, tag, name=name)
    _add_origin(shape, X_LG)
    element = ET.SubElement(shape, "geometry")
    match geometry:
        case Box(size=size):
            ET.SubElement(element, "box", size=numbers(size))
        case Sphere(radius=radius):
            ET.SubElement(element, "sphere", radius=number(radius))
        case Cylinder(radius=radius, height=height):
            ET.SubElement(element, "cylinder", radius=number(radius), length=number(height))
        case Capsule(radius=radius, height=height):
            ET.SubElement(element, "capsule", radius=number(radius), length=number(height))
        case Mesh() | Ellipsoid() | Cone():
            geometry = tessellate(geometry)
            path = f"assets/{geometry.digest}.obj"
            if path not in files:
                files.update({f"assets/{name}": data for name, data in obj_with_material(geometry).items()})
            ET.SubElement(element, "mesh", filename=path)
    return shape


def _add_material(parent: ET.Element, visual: Visual) -> None:
    """Add a color and an optional texture.

    The material name depends on the content, because readers share materials by name.
    """
    tint = numbers(visual.rgba)
    name = "rgba_" + tint.replace(" ", "_")
    mesh = visual.geometry
    png = mesh.texture if isinstance(mesh, Mesh) and has_texture(mesh) else None
    material = ET.SubElement(parent, "material", name=name if png is None else f"{texture_name(png)[:-4]}_{name}")
    ET.SubElement(material, "color", rgba=tint)
    if png is not None:
        ET.SubElement(material, "texture", filename=f"assets/{texture_name(png)}")


def _add_joint(root: ET.Element, joint: Joint, dialect: Dialect) -> None:
    welded = joint.type is JointType.BALL and dialect.ball is None
    element = ET.SubElement(root, "joint", name=joint.name, type=_joint_type(joint, dialect))
    _add_origin(element, joint.X_PC @ joint.motion if welded else joint.X_PC)
    ET.SubElement(element, "parent", link=joint.parent)
    ET.SubElement(element, "child", link=joint.child)
    if joint.type is JointType.FIXED or welded:
        return
    if joint.has_axis:
        ET.SubElement(element, "axis", xyz=numbers(joint.axis))
        ET.SubElement(element, "limit", _limit(joint))
    if joint.damping or joint.friction:
        ET.SubElement(element, "dynamics", damping=number(joint.damping), friction=number(joint.friction))
    if joint.mimic is not None:
        ratio = {"multiplier": number(joint.mimic.multiplier), "offset": number(joint.mimic.offset)}
        ET.SubElement(element, "mimic", {"joint": joint.mimic.joint} | ratio)


def _joint_type(joint: Joint, dialect: Dialect) -> str:
    if joint.type is JointType.BALL:
        return dialect.ball or JointType.FIXED.value
    unlimited = joint.type is JointType.REVOLUTE and joint.limits is None
    return JointType.CONTINUOUS.value if unlimited else joint.type.value


def _limit(joint: Joint) -> dict[str, str]:
    """Return the attributes of a ``limit`` element.

    Prismatic joints without limits get very large limits, because many readers would otherwise lock them at zero.
    """
    effort = joint.effort
    if effort is None and joint.drive is not None:
        effort = joint.drive.force_limit
    most = {"effort": effort, "velocity": joint.velocity}
    limit = {name: number(UNLIMITED if value is None else value) for name, value in most.items()}
    unbounded = (-UNBOUNDED_M, UNBOUNDED_M) if joint.type is JointType.PRISMATIC else None
    limits = joint.limits or unbounded
    if limits is None or joint.type is JointType.CONTINUOUS:
        return limit
    return {"lower": number(limits[0]), "upper": number(limits[1])} | limit
