"""URDF: one file an object, and ``poses.json`` for what URDF has no place for: the poses and joint positions.

``physics.json`` holds what else simulators know and URDF does not; the loaders for Drake, Genesis and SAPIEN use it.

A free object is a robot whose root nothing holds; ``floating`` joints are never written, because PyBullet freezes
them and Drake loses their poses. An inertial frame has the axes of its link, and the file the products of inertia:
some readers ignore a rotation of that frame. Link, joint and collider names are the scene's own; the robot's name is
the object's.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

from simfoundry.backends.artifact import Artifact, Fidelity, Loss, json_text, number, numbers, rounded
from simfoundry.backends.features import Cell, approximated, dropped, exact
from simfoundry.backends.names import check_names
from simfoundry.backends.robot_models.robot_fields import robot_words
from simfoundry.backends.robot_models.robot_urdf import ROBOT, RobotUrdf, robot_urdf
from simfoundry.backends.surroundings import splat_losses, variant_losses
from simfoundry.backends.urdf.physics import physics_manifest
from simfoundry.backends.xmltext import DECLARATION, xml_text
from simfoundry.geometry.frames import IDENTITY, Pose, rpy_from_quat
from simfoundry.geometry.shapes import Box, Capsule, Cylinder, Geometry, Mesh, Sphere
from simfoundry.runtime.shipped import shipped
from simfoundry.scene.meshfile import has_texture, obj_with_material, texture_name
from simfoundry.scene.model import Background, Joint, JointType, Link, Scene, SceneObject, Visual
from simfoundry.scene.touching import touching_pairs
from simfoundry.scene.trees import Tree, trees

FEATURES: dict[str, Cell] = {
    "robots": approximated(ROBOT),
    "robot_motors": dropped("URDF has no motors"),
    "robot_contacts": dropped("URDF has no contact friction"),
    "mounted_cameras": dropped("URDF has none"),
    "gravity": dropped("URDF describes objects, not a world"),
    "relations": dropped("URDF describes objects, not a world"),
    "cameras": dropped("URDF has none"),
    "distant_lights": dropped("URDF has no lights"),
    "point_lights": dropped("URDF has no lights"),
    "dome_lights": dropped("URDF has no lights"),
    "background_mesh": dropped("URDF describes objects, not a world"),
    "background_splat": dropped("URDF describes objects, not a world"),
    **exact("pose", "fixed", "category", "labels", "visuals", "texture", "mass", "inertia"),
    "variants": dropped("a file holds one of them"),
    **exact("box", "sphere", "cylinder", "capsule", "convex_mesh"),
    "friction": dropped("URDF has no contact friction"),
    "restitution": dropped("URDF has no restitution"),
    "torsional_friction": dropped("URDF has no contact friction"),
    "rolling_friction": dropped("URDF has no contact friction"),
    "no_contact": dropped("URDF does not say what touches"),
    **exact("fixed_joint", "revolute", "continuous", "prismatic", "joint_position", "joint_limits", "joint_closed"),
    **exact("joint_damping", "joint_friction"),
    "armature": dropped("URDF has no rotor inertia"),
    "ball": dropped("URDF has none: the link is welded"),
    **exact("free", "mimic"),
    "drive": dropped("URDF has no motors"),
}
"""What URDF and the ``poses.json`` beside it keep of each feature."""

Parts = Callable[[Geometry], Iterator[tuple[str, Geometry, Pose]]]
"""Splits a geometry into those that a dialect can write: a suffix for the name, the part, its pose ``X_GP``."""


_LOADERS = {"load.py": "urdf"} | {f"load_{simulator}.py": simulator for simulator in ("drake", "genesis", "sapien")}
"""The loaders in a build, with the folders of ``targets/`` that they come from."""


@dataclass(frozen=True)
class Dialect:
    """How one reader of URDF wants geometries, those that are seen and those that are felt."""

    shown: Parts
    felt: Parts
    ball: str | None = None
    """What it calls a ball joint; None where it knows none, so that the link is welded where it is."""


_TENSOR = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Rows and columns of an inertia in the order in which URDF's attributes are usually written."""

_EFFORT, _VELOCITY = "1000", "100"
"""URDF demands limits of effort and velocity. The scene has none: these are out of reach [N or N m, m/s or rad/s]."""

_FAR = 1000.0
"""Where a sliding joint without limits ends [m]."""


def compile_urdf(scene: Scene) -> Artifact:
    """Compile a scene to URDFs. Raises :class:`InvalidSceneError` for unusable names."""
    check_names(scene)
    dialect = Dialect(shown=capsule_parts, felt=capsule_parts)
    files = urdf_files(scene, dialect)
    poses: dict[str, dict[str, object]] = {tree.name: _manifest(tree) for item in scene.objects for tree in trees(item)}
    lost: list[Loss] = []
    robots: dict[str, RobotUrdf] = {}
    for robot in scene.robots:
        found = robot_urdf(robot, lambda item: urdf_files(replace(scene, objects=(item,)), dialect))
        if found is None:
            lost.append(Loss(robot.name, Fidelity.DROPPED, "it has no model in URDF or MJCF, and USD is not converted"))
            continue
        files |= found.files
        lost.extend(found.losses)
        reason = "URDF has no motors: nothing holds its joints until the simulator drives them"
        lost.append(Loss(f"{robot.name}.actuators", Fidelity.DROPPED, reason))
        reason = "URDF has no contact friction: the simulator's default applies"
        lost.append(Loss(f"{robot.name}.friction", Fidelity.DROPPED, reason))
        robots[robot.name] = found
        poses[robot.name] = {"urdf": found.path, "category": "robot"} | _robot_placement(found)
        words = robot_words(robot)
        if words is not None:
            poses[robot.name]["robot"] = words
    files["poses.json"] = json_text(poses)
    files["physics.json"] = physics_manifest(scene, capsule_parts, robots.items())
    files |= {name: (shipped("targets") / folder / "load.py").read_bytes() for name, folder in _LOADERS.items()}
    return Artifact("urdf", "poses.json", files, (*_losses(scene), *lost))


def _robot_placement(robot: RobotUrdf) -> dict[str, object]:
    return {
        "fixed": True,
        "p": [rounded(v) for v in robot.X_WB.p],
        "q_wxyz": [rounded(v) for v in robot.X_WB.q],
        "joints": {name: rounded(position) for name, position in robot.positions.items()},
    }


def urdf_files(scene: Scene, dialect: Dialect) -> dict[str, bytes]:
    """The URDF of every object, one for each part that moves freely, and the assets that they share, by path."""
    files: dict[str, bytes] = {}
    for item in scene.objects:
        written = _WRITTEN.get(item)
        if written is not None:
            files |= written
            continue
        texts = {f"{tree.name}.urdf": _tree_text(tree, dialect, files) for tree in trees(item)}
        if _is_plain(item):
            _WRITTEN[item] = texts
        files |= texts
    return files


_WRITTEN: WeakKeyDictionary[SceneObject, dict[str, bytes]] = WeakKeyDictionary()
"""What all dialects write alike, as long as the object lives: most scenes are compiled for two of them."""


def _is_plain(item: SceneObject) -> bool:
    """Whether all dialects write an object alike: it has no geometries to split, and no joints to name."""
    shapes = [v.geometry for k in item.links for v in k.visuals] + [c.geometry for k in item.links for c in k.colliders]
    joints = [joint for joint in item.joints if joint.type is JointType.BALL]
    return not joints and all(isinstance(shape, Box | Sphere | Cylinder) for shape in shapes)


def _tree_text(tree: Tree, dialect: Dialect, files: dict[str, bytes]) -> bytes:
    """The URDF of what hangs together; its assets are added to ``files``."""
    root = ET.Element("robot", name=tree.name)
    for link in tree.links:
        _add_link(root, link, dialect, files)
    for joint in tree.joints:
        _add_joint(root, joint, dialect)
    return DECLARATION + xml_text(root)


def background_urdf(background: Background, known: Mapping[str, bytes]) -> dict[str, bytes]:
    """A URDF of one link, in the frame of the world, that is seen and touches nothing; and assets not ``known`` yet."""
    files = dict(known)
    root = ET.Element("robot", name="background")
    element = ET.SubElement(root, "link", name="background")
    inertial = ET.SubElement(element, "inertial")  # without one readers invent a mass, and say so on every load
    ET.SubElement(inertial, "mass", value="0")
    ET.SubElement(inertial, "inertia", dict.fromkeys(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), "0"))
    for visual in background.visuals:
        shown = ET.SubElement(element, "visual", name=visual.name)
        _add_origin(shown, background.X_WB @ visual.X_LG)
        _add_geometry(shown, visual.geometry, files)
        _add_material(shown, visual)
    files["_background.urdf"] = DECLARATION + xml_text(root)
    return files


def whole(geometry: Geometry) -> Iterator[tuple[str, Geometry, Pose]]:
    """The geometry as it is, for dialects that know capsules."""
    yield "", geometry, IDENTITY


def capsule_parts(geometry: Geometry) -> Iterator[tuple[str, Geometry, Pose]]:
    """The geometry as it is, but a capsule, which URDF lacks, as a cylinder and two spheres: the same solid."""
    if not isinstance(geometry, Capsule):
        yield "", geometry, IDENTITY
        return
    yield "_tube", Cylinder(geometry.radius, geometry.height), IDENTITY
    yield "_top", Sphere(geometry.radius), Pose.of([0.0, 0.0, geometry.height / 2])
    yield "_bottom", Sphere(geometry.radius), Pose.of([0.0, 0.0, -geometry.height / 2])


def _add_link(root: ET.Element, link: Link, dialect: Dialect, files: dict[str, bytes]) -> None:
    element = ET.SubElement(root, "link", name=link.name)
    inertial = ET.SubElement(element, "inertial")
    _add_origin(inertial, Pose.of(link.com))
    ET.SubElement(inertial, "mass", value=number(link.mass))
    tensor = {f"i{'xyz'[a]}{'xyz'[b]}": number(link.inertia[a, b]) for a, b in _TENSOR}
    ET.SubElement(inertial, "inertia", tensor)
    for visual in link.visuals:
        for suffix, geometry, X_GP in dialect.shown(visual.geometry):
            shown = ET.SubElement(element, "visual", name=visual.name + suffix)
            _add_origin(shown, visual.X_LG @ X_GP)
            _add_geometry(shown, geometry, files)
            _add_material(shown, visual)
    for collider in link.colliders:
        for suffix, geometry, X_GP in dialect.felt(collider.geometry):
            felt = ET.SubElement(element, "collision", name=collider.name + suffix)
            _add_origin(felt, collider.X_LG @ X_GP)
            _add_geometry(felt, geometry, files)


def _add_origin(parent: ET.Element, pose: Pose) -> None:
    if not pose.is_identity:
        ET.SubElement(parent, "origin", xyz=numbers(pose.p), rpy=numbers(rpy_from_quat(pose.q)))


def _add_geometry(parent: ET.Element, geometry: Geometry, files: dict[str, bytes]) -> None:
    element = ET.SubElement(parent, "geometry")
    match geometry:
        case Box(size=size):
            ET.SubElement(element, "box", size=numbers(size))
        case Sphere(radius=radius):
            ET.SubElement(element, "sphere", radius=number(radius))
        case Cylinder(radius=radius, height=height):
            ET.SubElement(element, "cylinder", radius=number(radius), length=number(height))
        case Capsule(radius=radius, height=height):
            ET.SubElement(element, "capsule", radius=number(radius), length=number(height))
        case Mesh():
            path = f"assets/{geometry.digest}.obj"
            if path not in files:
                files.update({f"assets/{name}": data for name, data in obj_with_material(geometry).items()})
            ET.SubElement(element, "mesh", filename=path)


def _add_material(parent: ET.Element, visual: Visual) -> None:
    """A colour and perhaps a texture. Readers share materials by name in a file: the name follows the content."""
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
        law = {"multiplier": number(joint.mimic.multiplier), "offset": number(joint.mimic.offset)}
        ET.SubElement(element, "mimic", {"joint": joint.mimic.joint} | law)


def _joint_type(joint: Joint, dialect: Dialect) -> str:
    if joint.type is JointType.BALL:
        return dialect.ball or JointType.FIXED.value
    unlimited = joint.type is JointType.REVOLUTE and joint.limits is None
    return JointType.CONTINUOUS.value if unlimited else joint.type.value


def _limit(joint: Joint) -> dict[str, str]:
    strength = joint.drive.force_limit if joint.drive is not None else None
    limit = {"effort": _EFFORT if strength is None else number(strength), "velocity": _VELOCITY}
    if limits := _urdf_limits(joint):
        limit = {"lower": number(limits[0]), "upper": number(limits[1])} | limit
    return limit


def _urdf_limits(joint: Joint) -> tuple[float, float] | None:
    """The limits to write; a sliding joint needs some, and without them many readers lock it at zero."""
    if joint.type is JointType.CONTINUOUS:
        return None
    if joint.type is JointType.PRISMATIC and joint.limits is None:
        return -_FAR, _FAR
    return joint.limits


def placement(tree: Tree) -> dict[str, object]:
    """What URDF does not hold of a part of an object: whether it is fixed, its pose in the world, and of its joints.

    Their positions, and of those that say so the limit at which they are closed.
    """
    closed = {j.name: j.closed for j in tree.joints if j.closed is not None}
    return {
        "fixed": tree.fixed,
        "p": [rounded(v) for v in tree.X_WT.p.tolist()],
        "q_wxyz": [rounded(v) for v in tree.X_WT.q.tolist()],
        "joints": {j.name: rounded(j.position) for j in tree.joints if j.has_axis},
    } | ({"closed": closed} if closed else {})


def _manifest(tree: Tree) -> dict[str, object]:
    return {"urdf": f"{tree.name}.urdf"} | meaning(tree.owner) | placement(tree) | _loose(tree)


def _loose(tree: Tree) -> dict[str, object]:
    """Of a part that lies loose: its object, and the free joint from the link on which it lies (p, q_wxyz)."""
    joint = tree.free_joint
    if joint is None:
        return {}
    zero, motion = ([rounded(v) for v in (*X.p, *X.q)] for X in (joint.X_PC, joint.motion))
    said = {"object": tree.owner.name, "joint": joint.name, "parent": joint.parent, "zero": zero, "motion": motion}
    return {"free": said}


def meaning(item: SceneObject) -> dict[str, object]:
    """What an object is: its category, and its labels where it has some."""
    return {"category": item.category} | ({"labels": list(item.labels)} if item.labels else {})


def _losses(scene: Scene) -> Iterator[Loss]:
    def lost(path: str, reason: str) -> Loss:
        return Loss(path, Fidelity.DROPPED, reason)

    yield lost("gravity", "URDF describes objects, not a world: the simulator sets gravity")
    for item in scene.objects:
        colliders = [collider for link in item.links for collider in link.colliders]
        if colliders:
            yield lost(f"{item.name}.friction", "URDF has no contact friction: the simulator's default applies")
        if any(collider.restitution > 0 for collider in colliders):
            yield lost(f"{item.name}.restitution", "URDF has no restitution: the simulator's default applies")
        for field in ("torsional_friction", "rolling_friction"):
            if any(getattr(collider, field) > 0 for collider in colliders):
                yield lost(f"{item.name}.{field}", "URDF has no contact friction: the simulator's default applies")
        yield from joint_losses(item)
        for joint in item.joints:
            path = f"{item.name}.{joint.name}"
            if joint.type is JointType.BALL:
                yield lost(path, "URDF has no ball joints: the link is welded where the scene has it")
            if joint.drive is not None:
                yield lost(f"{path}.drive", "URDF has no motors; its force limit stands as the joint's effort")
        if touching_pairs(item) or item.no_contact:
            reason = "URDF does not say which links touch: the simulator decides whether those of one object do"
            yield lost(f"{item.name}.no_contact", reason)
    if scene.no_contact:
        yield lost("no_contact", "URDF does not say which objects pass through each other")
    for camera in scene.cameras:
        yield lost(camera.name, "URDF has no cameras")
    for mounted in scene.mounted:
        yield lost(mounted.camera.name, "URDF has no cameras")
    for light in scene.lights:
        yield lost(light.name, "URDF has no lights")
    if scene.background is not None and scene.background.visuals:
        reason = "URDF describes objects, not what is around them"
        yield Loss("background", Fidelity.DROPPED, reason, "background_mesh")
    yield from splat_losses(scene, "URDF")
    yield from variant_losses(scene, "URDF")
    if scene.relations:
        yield lost("relations", "URDF describes objects, not what holds among them")


def joint_losses(item: SceneObject) -> Iterator[Loss]:
    """What the joints of an object lose in any URDF: armature, and sliding without limits."""
    for joint in item.joints:
        if joint.type is JointType.PRISMATIC and joint.limits is None:
            reason = f"URDF demands limits of a sliding joint: {number(_FAR)} m either way stand for none"
            yield Loss(f"{item.name}.{joint.name}.limits", Fidelity.APPROXIMATED, reason)
        if joint.armature > 0:
            reason = "URDF has no rotor inertia: the joint accelerates as if it were zero"
            yield Loss(f"{item.name}.{joint.name}.armature", Fidelity.DROPPED, reason)
