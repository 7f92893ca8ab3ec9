"""Conversion of a robot to an articulated object or a URDF, for targets whose format the robot has no model in.

The model read by MuJoCo is converted to the scene's representation, a tree of links with masses, shapes and joints.
Closed loops are cut, and the robot's ``follow`` field describes their effect on the joints.
"""

from __future__ import annotations

import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from simfoundry.backends.losses import Loss, approximate, drop
from simfoundry.backends.robot_models.mujoco_robot import MujocoRobot, RobotModelError, read_robot
from simfoundry.geometry.frames import Array, Pose, frozen_array
from simfoundry.geometry.shapes import Box, Capsule, Cylinder, Geometry, Mesh, Sphere, hull_mesh
from simfoundry.scene.kinematics import joint_transform
from simfoundry.scene.model import Collider, Drive, Joint, JointType, Link, Mimic, SceneObject, Visual
from simfoundry.scene.robot import LinkFrame, ModelFormat, NativeModel, Robot
from simfoundry.scene.robot_files import model_files, urdf_mesh, urdf_meshes

if TYPE_CHECKING:
    import mujoco


# Mass [kg] and moments of inertia [kg m^2] that replace those of a massless link, because most engines reject zero.
_LIGHTEST, _LEAST = 1e-6, 1e-9


@dataclass(frozen=True, eq=False)
class RobotObject:
    """A robot that was converted to an object.

    Attributes:
        item: The object.
        links: The names of the links in the object, which contain no dots, keyed by the names in the model.
        joints: The names of the joints in the object, keyed by the names in the model.
        loops: The number of closed loops that were cut.
    """

    item: SceneObject
    links: dict[str, str]
    joints: dict[str, str]
    loops: int


@lru_cache(maxsize=4)
def as_object(robot: Robot, read: MujocoRobot) -> RobotObject:
    """Return the robot as an object at its pose and joint positions.

    Raises:
        RobotModelError: If the model is not a tree of links connected by single-axis joints.
    """
    model = read.model
    bodies = _bodies(robot, model)
    names = _names([model.body(b).name.removeprefix(read.prefix) for b in bodies])
    moving = {b: int(model.body_jntadr[b]) for b in bodies if model.body_jntnum[b]}
    axes = list(moving.values())
    joints = joint_names(robot, read)
    joints_of = dict(zip(axes, joints.values(), strict=True))
    link_of = dict(zip(bodies, names.values(), strict=True))
    shift = {b: np.array(model.jnt_pos[moving[b]]) if b in moving else np.zeros(3) for b in bodies}
    links = tuple(_link(model, b, link_of[b], shift[b]) for b in bodies)
    drives, (mimics, loops) = _drives(read, joints_of), _mimics(read, joints)
    rows = []
    for b in bodies[1:]:
        parent = int(model.body_parentid[b])
        X_PC = Pose.of(-shift[parent]) @ Pose.of(model.body_pos[b], model.body_quat[b]) @ Pose.of(shift[b])
        joint = moving.get(b)
        name = joints_of[joint] if joint is not None else f"{link_of[b]}_mount"
        one = _joint(model, read.qpos, joint, name, (link_of[parent], link_of[b]), X_PC)
        mimic = mimics.get(name)
        rows.append(replace(one, mimic=mimic, drive=drives.get(name) if mimic is None else None))
    root = bodies[0]
    X_WO = robot.X_WB @ Pose.of(model.body_pos[root], model.body_quat[root]) if root else robot.X_WB
    # The convex hulls may overlap even if the meshes do not.
    apart = tuple(combinations([link.name for link in links], 2))
    item = SceneObject(robot.name, "robot", True, X_WO, links, tuple(rows), apart)
    return RobotObject(item, names, joints, loops)


def joint_names(robot: Robot, read: MujocoRobot) -> dict[str, str]:
    """Return a mapping from the joint names in the model to the joint names in the object.

    Raises:
        RobotModelError: If the model is not a tree of links connected by single-axis joints.
    """
    model = read.model
    moving = (int(model.body_jntadr[b]) for b in _bodies(robot, model) if model.body_jntnum[b])
    return _names([model.joint(j).name.removeprefix(read.prefix) for j in moving])


def _bodies(robot: Robot, model: mujoco.MjModel) -> list[int]:
    """Return the bodies that become links, with parents first.

    The world is omitted if its only purpose is to support the base.
    """
    for b in range(model.nbody):
        if model.body_jntnum[b] > 1 or (model.body_jntnum[b] and int(model.jnt_type[model.body_jntadr[b]]) < 2):
            name = model.body(b).name
            raise RobotModelError(f"robot `{robot.name}`: body `{name}` has joints other than one hinge or slide")
    tops = [b for b in range(1, model.nbody) if model.body_parentid[b] == 0]
    alone = len(tops) == 1 and model.body_jntnum[tops[0]] == 0 and model.body_geomnum[0] == 0
    return list(range(1 if alone else 0, model.nbody))


def _names(given: list[str]) -> dict[str, str]:
    """Return a mapping from the model's names to unique names that are valid in a scene."""
    names: dict[str, str] = {}
    for k, text in enumerate(given):
        plain = re.sub(r"[^a-z0-9_]+", "_", text.lower()).strip("_") or f"part{k}"
        plain = plain if plain[0].isalpha() else f"part_{plain}"
        while plain in names.values():
            plain += "_"
        names[text or plain] = plain
    return names


def _link(model: mujoco.MjModel, b: int, name: str, shift: Array) -> Link:
    """Return a body as a link whose frame is shifted by ``shift`` [m] to the link's joint."""
    mass = max(float(model.body_mass[b]), _LIGHTEST)
    moments = np.maximum(model.body_inertia[b], _LEAST)
    axes = Pose.of(q=model.body_iquat[b]).rotation
    visuals, colliders = [], []
    for g in range(model.body_geomadr[b], model.body_geomadr[b] + model.body_geomnum[b]):
        X_LG = Pose.of(-shift) @ Pose.of(model.geom_pos[g], model.geom_quat[g])
        geometry = _geometry(model, g)
        if geometry is None:
            continue
        collides = bool(model.geom_contype[g] or model.geom_conaffinity[g])
        convex = hull_mesh(geometry.vertices) if collides and isinstance(geometry, Mesh) else geometry
        if collides and convex is not None:
            colliders.append(Collider(f"collider{g}", convex, float(model.geom_friction[g][0]), 0.0, X_LG))
        if not collides or model.geom_group[g] < 3:  # viewers show groups 0 to 2
            visuals.append(Visual(f"visual{g}", geometry, frozen_array(_rgba(model, g)), X_LG))
    com = frozen_array(model.body_ipos[b] - shift)
    return Link(name, mass, com, frozen_array(axes @ np.diag(moments) @ axes.T), tuple(visuals), tuple(colliders))


def _rgba(model: mujoco.MjModel, g: int) -> Array:
    material = int(model.geom_matid[g])
    return np.asarray(model.geom_rgba[g] if material < 0 else model.mat_rgba[material], dtype=np.float64)


def _geometry(model: mujoco.MjModel, g: int) -> Geometry | None:
    """Return the shape of a geom, or None if the geom is a plane, because planes are never part of a robot."""
    import mujoco

    size, kinds = model.geom_size[g], mujoco.mjtGeom
    match kinds(int(model.geom_type[g])):
        case kinds.mjGEOM_BOX:
            return Box(frozen_array(2 * size))
        case kinds.mjGEOM_SPHERE:
            return Sphere(float(size[0]))
        case kinds.mjGEOM_CYLINDER:
            return Cylinder(float(size[0]), 2 * float(size[1]))
        case kinds.mjGEOM_CAPSULE:
            return Capsule(float(size[0]), 2 * float(size[1]))
        case kinds.mjGEOM_MESH:
            m = int(model.geom_dataid[g])
            rows = slice(model.mesh_vertadr[m], model.mesh_vertadr[m] + model.mesh_vertnum[m])
            faces = model.mesh_face[model.mesh_faceadr[m] : model.mesh_faceadr[m] + model.mesh_facenum[m]]
            return Mesh(frozen_array(model.mesh_vert[rows]), np.array(faces, dtype=np.int32))
        case _:
            return None


def _joint(model: mujoco.MjModel, qpos: Array, j: int | None, name: str, ends: tuple[str, str], X_PC: Pose) -> Joint:
    import mujoco

    if j is None:
        return Joint(name, JointType.FIXED, *ends, X_PC, frozen_array([0.0, 0.0, 1.0]))
    slides = int(model.jnt_type[j]) == int(mujoco.mjtJoint.mjJNT_SLIDE)
    limited = bool(model.jnt_limited[j])
    kind = JointType.PRISMATIC if slides else JointType.REVOLUTE if limited else JointType.CONTINUOUS
    dof, at = int(model.jnt_dofadr[j]), int(model.jnt_qposadr[j])
    low, high = model.jnt_range[j].tolist()
    limits = (low, high) if limited else None
    damping, friction = float(np.ravel(model.dof_damping[dof])[0]), float(model.dof_frictionloss[dof])
    passive = (damping, friction, float(model.dof_armature[dof]))
    joint = Joint(name, kind, *ends, X_PC, frozen_array(model.jnt_axis[j]), limits, *passive, float(qpos[at]))
    reference = float(model.qpos0[at])  # the joint position at which the model's poses are defined
    return joint if reference == 0.0 else replace(joint, X_PC=X_PC @ joint_transform(joint, -reference))


def _drives(read: MujocoRobot, joints: dict[int, str]) -> dict[str, Drive]:
    """Return the drives of joints that have an actuator and of gripper joints that do not follow another joint."""
    import mujoco

    model, drives = read.model, {}
    for k in range(model.nu):
        spring, damping = -float(model.actuator_biasprm[k][1]), -float(model.actuator_biasprm[k][2])
        limit = float(model.actuator_forcerange[k][1]) if model.actuator_forcelimited[k] else None
        if int(model.actuator_trntype[k]) == int(mujoco.mjtTrn.mjTRN_JOINT):
            driven = [int(model.actuator_trnid[k][0])]
        else:
            driven = [model.joint(read.prefix + name).id for name in _leaders(read)]
        for joint in driven:
            target = float(read.qpos[model.jnt_qposadr[joint]])
            drives[joints[joint]] = Drive(max(spring, 0.0), max(damping, 0.0), target, limit)
    return drives


def _leaders(read: MujocoRobot) -> Iterator[str]:
    """Yield the gripper joints that do not follow another joint."""
    gripper = read.native.gripper
    if gripper is not None:
        yield from (name for name in gripper.joints if name not in gripper.follow)


def _mimics(read: MujocoRobot, names: dict[str, str]) -> tuple[dict[str, Mimic], int]:
    """Return the mimics, keyed by joint, and the number of loops that were cut.

    The mimics come from the description and from the model's equations.
    """
    import mujoco

    model, gripper = read.model, read.native.gripper
    given = gripper.follow if gripper is not None else {}
    mimics = {names[n]: Mimic(names[f.joint], f.multiplier, f.offset) for n, f in given.items()}
    kinds = [int(kind) for kind in model.eq_type]
    for k in (k for k, kind in enumerate(kinds) if kind == int(mujoco.mjtEq.mjEQ_JOINT) and model.eq_obj2id[k] >= 0):
        ends = (int(model.eq_obj1id[k]), int(model.eq_obj2id[k]))
        one, other = (names[model.joint(i).name.removeprefix(read.prefix)] for i in ends)
        offset, multiplier = (float(v) for v in model.eq_data[k][:2])
        if one not in mimics and one not in {m.joint for m in mimics.values()}:
            mimics[one] = Mimic(other, multiplier, offset)
    loops = sum(kind in (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD)) for kind in kinds)
    return mimics, loops


# A function that writes an object as ``<name>.urdf`` and returns this file with its assets.
Write = Callable[[SceneObject], Mapping[str, bytes]]

_MOVING = ("revolute", "continuous", "prismatic")
# Maximum force [N m or N] of a joint for which the URDF does not specify one.
_STRONG = 100.0


@dataclass(frozen=True, eq=False)
class RobotUrdf:
    """A robot as URDF, with the file at ``path`` in ``files`` and the root link at ``X_WB``.

    ``positions`` [rad or m], ``efforts`` [N m or N], ``follow`` and ``servos`` are keyed by the joint names in the
    URDF. ``servos`` contains the servos with known gains: the stiffness [N m/rad or N/m], and the damping, which
    includes the damping of the joint itself. ``quickness`` is the factor of the ratio of stiffness and damping of the
    servos of the arm without known gains. ``joints`` maps joint names in the scene to joint names in the URDF, and
    ``frames`` maps frames in the scene to links. ``item`` is the object from which the URDF was converted, if any.
    """

    path: str
    files: Mapping[str, bytes]
    X_WB: Pose
    positions: Mapping[str, float]
    efforts: Mapping[str, float]
    joints: Mapping[str, str]
    gripper: Mapping[str, tuple[float, float]]
    follow: Mapping[str, Mimic]
    servos: Mapping[str, tuple[float, float]]
    frames: Mapping[str, LinkFrame]
    item: SceneObject | None
    losses: tuple[Loss, ...]
    quickness: float = 1.0


def robot_urdf(robot: Robot, write: Write) -> RobotUrdf | None:
    """Return the robot as URDF, or None if it has neither a URDF nor an MJCF model.

    Raises:
        RobotModelError: If the model cannot be read or converted.
    """
    native = robot.best(ModelFormat.URDF)
    if native is not None:
        return _native(robot, native)
    native = robot.best(ModelFormat.MJCF)
    return _converted(robot, native, write) if native is not None else None


def _native(robot: Robot, native: NativeModel) -> RobotUrdf:
    files, path = copied(native)
    try:
        root = ET.fromstring(files[path])
    except ET.ParseError as error:
        raise RobotModelError(f"robot `{robot.name}`: {native.file} is not a URDF: {error}") from None
    moving = [j for j in root.findall("joint") if j.get("type") in _MOVING]
    names = [str(joint.get("name")) for joint in moving]
    start = robot.start(native)
    for name in start:
        if name not in names:
            raise RobotModelError.missing(f"robot `{robot.name}`: {native.file.name}", "joint", name, names)
    follow = dict(_stated_mimics(moving)) | (dict(native.gripper.follow) if native.gripper is not None else {})
    efforts = {name: native.effort.get(name, _effort(joint)) for name, joint in zip(names, moving, strict=True)}
    return RobotUrdf(
        path=path,
        files=files,
        X_WB=robot.X_WB,
        positions={name: start.get(name, 0.0) for name in names},
        efforts=efforts,
        joints=native.joints or {name: name for name in names},
        gripper=native.gripper.joints if native.gripper is not None else {},
        follow=follow,
        servos={},
        frames=native.links,
        item=None,
        losses=(),
        quickness=robot.stiffness / robot.damping,
    )


def _stated_mimics(joints: list[ET.Element]) -> Iterator[tuple[str, Mimic]]:
    for joint in joints:
        mimic = joint.find("mimic")
        if mimic is not None:
            numbers = (float(mimic.get("multiplier", "1")), float(mimic.get("offset", "0")))
            yield str(joint.get("name")), Mimic(str(mimic.get("joint")), *numbers)


def _effort(joint: ET.Element) -> float:
    limit = joint.find("limit")
    effort = float(limit.get("effort", "0")) if limit is not None else 0.0
    return effort if effort > 0 else _STRONG


def copied(native: NativeModel) -> tuple[dict[str, bytes], str]:
    """Copy a URDF and its meshes to ``robots/`` with the same relative layout.

    Mesh paths are made relative to the URDF, and the rest of the text is unchanged. Also returns the new path of the
    URDF.
    """
    needed = model_files(native.file)
    top = Path(os.path.commonpath([file.parent for file in needed]))
    folder = f"robots/{native.file.stem}_{native.digest[:8]}"
    text = native.file.read_text(encoding="utf-8")
    for name in urdf_meshes(text):
        near = os.path.relpath(urdf_mesh(native.file, name), native.file.parent).replace(os.sep, "/")
        text = re.sub(rf"""(\bfilename\s*=\s*)["']{re.escape(name)}["']""", lambda m, n=near: f'{m[1]}"{n}"', text)  # type: ignore[misc]
    files = {f"{folder}/{file.relative_to(top).as_posix()}": file.read_bytes() for file in needed}
    path = f"{folder}/{native.file.relative_to(top).as_posix()}"
    files[path] = text.encode()
    return files, path


def _converted(robot: Robot, native: NativeModel, write: Write) -> RobotUrdf:
    read = read_robot(robot, native, f"{robot.name}.")
    made = as_object(robot, read)
    gripper = native.gripper.joints if native.gripper is not None else {}
    frames = {n: LinkFrame(made.links[f.link], f.X_LF) for n, f in native.links.items() if f.link in made.links}
    joints = {joint.name: joint for joint in made.item.joints}
    drives = {name: joint.drive for name, joint in joints.items() if joint.drive is not None}
    arm = native.joints or {name: name for name in made.joints}
    return RobotUrdf(
        path=f"{robot.name}.urdf",
        files=write(made.item),
        X_WB=made.item.X_WO,
        positions={name: joint.position for name, joint in joints.items() if name in made.joints.values()},
        efforts={name: drive.force_limit or _STRONG for name, drive in drives.items()},
        joints={name: made.joints[joint] for name, joint in arm.items()},
        gripper={made.joints[name]: pair for name, pair in gripper.items()},
        follow={n: j.mimic for n, j in joints.items() if j.mimic is not None},
        servos={n: (d.stiffness, d.damping + joints[n].damping) for n, d in drives.items() if d.stiffness > 0},
        frames=frames,
        item=made.item,
        losses=tuple(conversion_losses(robot, native, made.loops)),
    )


def conversion_losses(robot: Robot, source: NativeModel, loops: int) -> Iterator[Loss]:
    """Yield the losses from converting a robot's MJCF or URDF."""
    kind = source.format.value.upper()
    reason = f"The robot has no model in this format, so its {kind} is converted, with convex hulls as colliders."
    yield approximate("robots", robot.name, reason)
    if loops:
        words = f"{loops} closed loops are" if loops > 1 else "1 closed loop is"
        reason = f"{words} cut and replaced by mimic joints with fixed ratios."
        yield approximate("robots", robot.name, reason, loops, "loops")


def without_model(name: str) -> Loss:
    """Return the loss for a robot that has neither an MJCF nor a URDF."""
    return drop("robots", name, "The robot has no MJCF or URDF model, and its USD cannot be converted.")
