"""Conversion of objects to MJCF bodies with joints and geoms."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from simfoundry.backends.artifact import number, numbers
from simfoundry.backends.losses import Loss, drop
from simfoundry.backends.mjcf.attachments import add_site
from simfoundry.backends.mjcf.contacts import VISUAL, VISUAL_GROUP, MaterialClasses
from simfoundry.backends.stable_drives import stable_drives
from simfoundry.geometry.frames import IDENTITY, Array, Pose
from simfoundry.geometry.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Geometry, Mesh, Sphere, tessellate
from simfoundry.scene.kinematics import Tree, trees
from simfoundry.scene.meshfile import has_texture, obj_bytes
from simfoundry.scene.model import Background, Collider, Drive, Joint, JointType, Link, Scene, SceneObject, Visual

JOINT_TYPES = {
    JointType.REVOLUTE: "hinge",
    JointType.CONTINUOUS: "hinge",
    JointType.PRISMATIC: "slide",
    JointType.BALL: "ball",
}


def add_object(world: ET.Element, item: SceneObject, assets: Assets, materials: MaterialClasses) -> Iterator[float]:
    """Add an object's bodies to the world, and yield their initial ``qpos`` in MuJoCo's depth-first order.

    Each tree of links is a child of the world body, because MuJoCo allows free joints only there.
    """
    links = {link.name: link for link in item.links}

    def fill(body: ET.Element, tree: Tree, link: Link) -> Iterator[float]:
        _fill_body(body, item.qualified(link.name), link, assets, materials)
        for site in (site for site in item.sites if site.link == link.name):
            add_site(body, f"{item.name}.{site.name}", site, IDENTITY)
        for child in dict.fromkeys(joint.child for joint in tree.joints if joint.parent == link.name):
            below = ET.SubElement(body, "body", {"name": item.qualified(child)})
            for joint in item.joints_above[child]:
                below.attrib |= pose_attributes(joint.X_PC)  # the identity, except for the first joint
                _add_joint(below, item, joint)
                if joint.type is JointType.BALL:
                    yield from joint.motion.q
                elif joint.has_axis:
                    yield joint.position
            yield from fill(below, tree, links[child])

    for tree in trees(item):
        body = ET.SubElement(world, "body", {"name": tree.name} | pose_attributes(tree.X_WT))
        if not tree.fixed:
            ET.SubElement(body, "freejoint", name=free_joint_name(tree))
            yield from (*tree.X_WT.p, *tree.X_WT.q)
        yield from fill(body, tree, tree.root)


def add_background(world: ET.Element, background: Background, assets: Assets) -> None:
    """Add the background as visual geoms that do not collide."""
    for visual in background.visuals:
        posed = replace(visual, X_LG=background.X_WB @ visual.X_LG)
        _add_visual(world, f":background:{visual.name}", posed, assets)


def free_joint_name(tree: Tree) -> str:
    """Return the name of the free joint at the root of a tree, which is the object's name or ``object.joint``."""
    return tree.owner.name if tree.free_joint is None else f"{tree.owner.name}.{tree.free_joint.name}"


def _add_joint(body: ET.Element, item: SceneObject, joint: Joint) -> None:
    if joint.type is not JointType.FIXED:
        attributes = {"name": f"{item.name}.{joint.name}", "type": JOINT_TYPES[joint.type]}
        if joint.has_axis:
            attributes["axis"] = numbers(joint.axis)
        if joint.limits is not None and joint.type is not JointType.CONTINUOUS:
            attributes["range"] = numbers(joint.limits)
        for key, value in (("damping", joint.damping), ("frictionloss", joint.friction), ("armature", joint.armature)):
            if value:
                attributes[key] = number(value)
        if joint.effort is not None:
            attributes["actuatorfrcrange"] = numbers([-joint.effort, joint.effort])
        if joint.type is JointType.BALL and joint.friction:
            # MuJoCo averages the friction impedance over the three axes, but most objects rotate easily about one axis.
            attributes["solimpfriction"] = "0.9999 0.9999 0.001 0.5 2"
        ET.SubElement(body, "joint", attributes)


def joint_losses(scene: Scene) -> Iterator[Loss]:
    """Yield the losses of joints that have properties without an attribute in MJCF."""
    for item in scene.objects:
        for joint in item.joints:
            if joint.velocity is not None:
                reason = "MuJoCo does not limit the speed of joints."
                yield drop("joint_velocity", f"{item.name}.{joint.name}", reason)


def _add_visual(body: ET.Element, name: str, visual: Visual, assets: Assets) -> None:
    attributes = {"class": VISUAL, "name": name} | pose_attributes(visual.X_LG)
    attributes |= _shape(visual.geometry, assets, name)
    if isinstance(visual.geometry, Mesh) and visual.geometry.texture is not None and has_texture(visual.geometry):
        attributes["material"] = assets.material(visual.geometry.texture, visual.rgba, name)
    else:
        attributes["rgba"] = numbers(visual.rgba)
    ET.SubElement(body, "geom", attributes)


# Relative margin of the triangle inequality of moments of inertia, above the rounding of numbers to twelve digits.
MARGIN = 1e-11


def _below_sum(moments: Array) -> Array:
    """Return moments of inertia of which none exceeds the sum of the others, even after rounding.

    The largest moment of a thin plate equals the sum of the others, and MuJoCo rejects a moment above it. In a long
    rod, the two largest moments are almost equal, so the larger one becomes the other.
    """
    largest, middle = int(moments.argmax()), float(np.sort(moments)[1])
    limit = max(middle, (1 - MARGIN) * float(moments.sum() - moments[largest]))
    return moments if moments[largest] <= limit else np.where(np.arange(3) == largest, limit, moments)


def _fill_body(body: ET.Element, name: str, link: Link, assets: Assets, materials: MaterialClasses) -> None:
    """Add the mass properties and geoms of a link to its body.

    A primitive that is both visual and collider becomes one geom in the visual group.
    """
    if link.gravity_compensation:
        body.set("gravcomp", number(link.gravity_compensation))
    moments, q = link.principal
    inertial = {"pos": numbers(link.com), "mass": number(link.mass), "diaginertia": numbers(_below_sum(moments))}
    ET.SubElement(body, "inertial", inertial | _turn(q))
    both: dict[str, Visual] = {v.name: v for v in link.visuals if not isinstance(v.geometry, Mesh)}
    shapes = {c.name: _placed_shape(c, assets, f"{name}_collision") for c in link.colliders}
    both = {n: v for n, v in both.items() if n in shapes and shapes[n] == _placed_shape(v, assets, name)}
    for visual in link.visuals:
        if visual.name not in both:
            _add_visual(body, f"{name}:{visual.name}", visual, assets)
    for collider in link.colliders:
        attributes = materials.attributes(collider) | {"name": f"{name}.{collider.name}"} | shapes[collider.name]
        if collider.name in both:
            attributes |= {"group": VISUAL_GROUP, "rgba": numbers(both[collider.name].rgba)}
        ET.SubElement(body, "geom", attributes)


def _placed_shape(part: Visual | Collider, assets: Assets, name: str) -> dict[str, str]:
    return pose_attributes(part.X_LG) | _shape(part.geometry, assets, name, isinstance(part, Collider))


def _shape(geometry: Geometry, assets: Assets, name: str, collides: bool = False) -> dict[str, str]:
    """Return the type and size attributes of a geom.

    If the geom needs a new mesh asset, the asset is named after ``name``.
    """
    match geometry:
        case Box(size=size):
            return {"type": "box", "size": numbers(size / 2)}
        case Sphere(radius=radius):
            return {"type": "sphere", "size": number(radius)}
        case Ellipsoid(radii=radii):
            return {"type": "ellipsoid", "size": numbers(radii)}
        case Cylinder(radius=radius, height=height):
            return {"type": "cylinder", "size": numbers([radius, height / 2])}
        case Capsule(radius=radius, height=height):
            return {"type": "capsule", "size": numbers([radius, height / 2])}
        case Mesh() | Cone():  # a cone is only shown; see :mod:`simfoundry.backends.convex_hulls`
            return {"type": "mesh", "mesh": assets.mesh(tessellate(geometry), name, collides)}


def pose_attributes(pose: Pose) -> dict[str, str]:
    """Return a pose as ``pos`` and ``quat`` (wxyz) attributes, omitting identity values."""
    if pose is IDENTITY:
        return {}
    p = pose.p.tolist()
    return ({"pos": numbers(p)} if any(p) else {}) | _turn(pose.q)


def _turn(q: Array) -> dict[str, str]:
    values = q.tolist()
    return {"quat": numbers(values)} if any(values[1:]) else {}


class Assets:
    """The ``<asset>`` element under construction, along with the files that it refers to, keyed by file name."""

    def __init__(self, element: ET.Element) -> None:
        self.files: dict[str, bytes] = {}
        self.element = element
        self._counts: dict[str, int] = {}
        self._names: dict[object, str] = {}
        self._files: dict[str, str] = {}
        self._taken: set[str] = set()

    def mesh(self, mesh: Mesh, wish: str, collides: bool, inertia: str = "") -> str:
        """Return the name of the asset for ``mesh``. A new asset is named after ``wish``.

        MuJoCo moves a mesh to its inertial frame, which it computes by the ``inertia`` mode or by a suitable default.
        """
        key = (mesh.digest, collides, inertia)
        if key not in self._names:
            name = self._names[key] = self._new_name(wish, numbered=collides)
            file = self._files.setdefault(mesh.digest, name)
            # Visual meshes may be open or flat, which MuJoCo accepts only as shells. The computed mass is not used.
            inertia = inertia or ("convex" if collides else "shell")
            ET.SubElement(self.element, "mesh", name=name, file=f"{file}.obj", inertia=inertia)
            self.files.setdefault(f"{file}.obj", obj_bytes(mesh))
        return self._names[key]

    def material(self, png: bytes, rgba: Array, wish: str) -> str:
        """Return the name of a material that multiplies a texture by a color."""
        tint = numbers(rgba)
        if (png, tint) not in self._names:
            if png not in self._names:
                texture = self._names[png] = self._new_name(f"{wish}_texture")
                ET.SubElement(self.element, "texture", name=texture, type="2d", file=f"{texture}.png")
                self.files[f"{texture}.png"] = png
            name = self._names[png, tint] = self._new_name(f"{wish}_material")
            ET.SubElement(self.element, "material", name=name, texture=self._names[png], rgba=tint)
        return self._names[png, tint]

    def _new_name(self, wish: str, numbered: bool = False) -> str:
        """Return ``wish`` as a file name, with a number appended if it is taken or if ``numbered`` is set."""
        plain = wish.replace(".", "_").replace(":", "_").strip("_")
        while True:
            k = self._counts[plain] = self._counts.get(plain, -1) + 1
            name = f"{plain}_{k}" if k or numbered else plain
            if name not in self._taken:
                self._taken.add(name)
                return name


# Constraint parameters of a mimic joint; the time constant is two time steps, which is the smallest stable value.
_RIGID = {"solref": "0.004 1", "solimp": "0.99 0.999 0.001"}


def add_mimics(root: ET.Element, scene: Scene) -> None:
    """Add an ``<equality>`` element with one entry named ``object.joint`` per mimic joint.

    MuJoCo applies the polynomial to deviations from the model's reference configuration, in which all joints are at
    zero.
    """
    followers = [(o.name, j, j.mimic) for o in scene.objects for j in o.joints if j.mimic is not None]
    if not followers:
        return
    equality = ET.SubElement(root, "equality")
    for owner, joint, mimic in followers:
        names = {"name": f"{owner}.{joint.name}", "joint1": f"{owner}.{joint.name}", "joint2": f"{owner}.{mimic.joint}"}
        ratio = {"polycoef": numbers([mimic.offset, mimic.multiplier, 0, 0, 0])}
        ET.SubElement(equality, "joint", names | ratio | _RIGID)


def add_drives(root: ET.Element, scene: Scene, timestep: float) -> list[float]:
    """Add an ``<actuator>`` element with one entry named ``object.joint`` per drive, and return the initial ``ctrl``.

    The control is the drive target, clipped to the joint limits. The stiffness is limited to values that are stable at
    a time step of ``timestep`` [s].
    """
    actuator, ctrl = ET.Element("actuator"), []
    for item in scene.objects:
        drives = stable_drives(item, timestep, implicit_damping=True)
        for joint in (joint for joint in item.joints if joint.name in drives):
            name, drive = f"{item.name}.{joint.name}", drives[joint.name]
            if drive.actuator:  # written as that actuator
                continue
            ET.SubElement(actuator, "general", {"name": name, "joint": name} | _spring(joint, drive))
            ctrl.append(drive.target)
    if ctrl:
        root.append(actuator)
    return ctrl


def _spring(joint: Joint, drive: Drive) -> dict[str, str]:
    """Return MuJoCo's gain and bias parameters for the force ``stiffness * (ctrl - q) - damping * v``."""
    attributes = {"biastype": "affine", "gainprm": number(drive.stiffness)}
    attributes["biasprm"] = numbers([0.0, -drive.stiffness, -drive.damping])
    if drive.stiffness and joint.limits is not None:
        attributes["ctrlrange"] = numbers(joint.limits)
    if drive.force_limit is not None:
        attributes["forcerange"] = numbers([-drive.force_limit, drive.force_limit])
    return attributes
