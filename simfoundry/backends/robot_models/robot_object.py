"""A robot as an object of links and joints, for targets without a model in their own format.

The model that MuJoCo has read is expressed in the terms of a scene: a tree of links with masses, shapes and joints.
Closed loops are cut; the robot's ``follow`` describes their effect on the joints.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from simfoundry.backends.robot_models.mujoco_robot import MujocoRobot, RobotModelError
from simfoundry.geometry.frames import Array, Pose, frozen_array
from simfoundry.geometry.shapes import Box, Capsule, Cylinder, Geometry, Mesh, Sphere, hull_mesh
from simfoundry.scene.kinematics import joint_transform
from simfoundry.scene.model import Collider, Drive, Joint, JointType, Link, Mimic, SceneObject, Visual
from simfoundry.scene.robot import Robot

if TYPE_CHECKING:
    import mujoco

_LIGHTEST, _LEAST = 1e-6, 1e-9
"""Mass [kg] and moments of inertia [kg m^2] of a massless link; most engines reject zero."""


@dataclass(frozen=True, eq=False)
class RobotObject:
    """A robot as an ``item``. ``links`` and ``joints`` map the model's names to the item's names, which have no dots.

    ``loops`` is the number of closed loops that were cut.
    """

    item: SceneObject
    links: dict[str, str]
    joints: dict[str, str]
    loops: int


@lru_cache(maxsize=4)
def as_object(robot: Robot, read: MujocoRobot) -> RobotObject:
    """Return the robot at its pose and joint positions. Raises :class:`RobotModelError` if it is not a tree."""
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
        X_PC = Pose.of(-shift[parent]) @ _pose(model.body_pos[b], model.body_quat[b]) @ Pose.of(shift[b])
        joint = moving.get(b)
        name = joints_of[joint] if joint is not None else f"{link_of[b]}_mount"
        one = _joint(model, read.qpos, joint, name, (link_of[parent], link_of[b]), X_PC)
        mimic = mimics.get(name)
        rows.append(replace(one, mimic=mimic, drive=drives.get(name) if mimic is None else None))
    root = bodies[0]
    X_WO = robot.X_WB @ _pose(model.body_pos[root], model.body_quat[root]) if root else robot.X_WB
    apart = tuple(
        combinations([link.name for link in links], 2)
    )  # the convex hulls may overlap even if the meshes do not
    item = SceneObject(robot.name, "robot", True, X_WO, links, tuple(rows), apart)
    return RobotObject(item, names, joints, loops)


def joint_names(robot: Robot, read: MujocoRobot) -> dict[str, str]:
    """Return the item's joint names by the model's names. Raises :class:`RobotModelError` if it is not a tree."""
    model = read.model
    moving = (int(model.body_jntadr[b]) for b in _bodies(robot, model) if model.body_jntnum[b])
    return _names([model.joint(j).name.removeprefix(read.prefix) for j in moving])


def _bodies(robot: Robot, model: mujoco.MjModel) -> list[int]:
    """Return the bodies that become links, parents first; the world is omitted if it only supports the base."""
    for b in range(model.nbody):
        if model.body_jntnum[b] > 1 or (model.body_jntnum[b] and int(model.jnt_type[model.body_jntadr[b]]) < 2):
            name = model.body(b).name
            raise RobotModelError(f"robot `{robot.name}`: body `{name}` does not move by one hinge or slide")
    tops = [b for b in range(1, model.nbody) if model.body_parentid[b] == 0]
    alone = len(tops) == 1 and model.body_jntnum[tops[0]] == 0 and model.body_geomnum[0] == 0
    return list(range(1 if alone else 0, model.nbody))


def _names(given: list[str]) -> dict[str, str]:
    """Return unique names that are valid in a scene, by the model's names."""
    names: dict[str, str] = {}
    for k, text in enumerate(given):
        plain = re.sub(r"[^a-z0-9_]+", "_", text.lower()).strip("_") or f"part{k}"
        plain = plain if plain[0].isalpha() else f"part_{plain}"
        while plain in names.values():
            plain += "_"
        names[text or plain] = plain
    return names


def _pose(p: Array, q: Array) -> Pose:
    return Pose.of(p, q)


def _link(model: mujoco.MjModel, b: int, name: str, shift: Array) -> Link:
    """Return a body as a link whose frame is moved by ``shift`` [m] to its joint."""
    mass = max(float(model.body_mass[b]), _LIGHTEST)
    moments = np.maximum(model.body_inertia[b], _LEAST)
    axes = Pose.of(q=model.body_iquat[b]).rotation
    visuals, colliders = [], []
    for g in range(model.body_geomadr[b], model.body_geomadr[b] + model.body_geomnum[b]):
        X_LG = Pose.of(-shift) @ _pose(model.geom_pos[g], model.geom_quat[g])
        geometry = _geometry(model, g)
        if geometry is None:
            continue
        collides = bool(model.geom_contype[g] or model.geom_conaffinity[g])
        convex = hull_mesh(geometry.vertices) if collides and isinstance(geometry, Mesh) else geometry
        if collides and convex is not None:
            colliders.append(Collider(f"collider{g}", convex, float(model.geom_friction[g][0]), 0.0, X_LG))
        if not collides or model.geom_group[g] < 3:  # groups 0 to 2 are what a viewer shows
            visuals.append(Visual(f"visual{g}", geometry, frozen_array(_rgba(model, g)), X_LG))
    com = frozen_array(model.body_ipos[b] - shift)
    return Link(name, mass, com, frozen_array(axes @ np.diag(moments) @ axes.T), tuple(visuals), tuple(colliders))


def _rgba(model: mujoco.MjModel, g: int) -> Array:
    material = int(model.geom_matid[g])
    return np.asarray(model.geom_rgba[g] if material < 0 else model.mat_rgba[material], dtype=np.float64)


def _geometry(model: mujoco.MjModel, g: int) -> Geometry | None:
    """Return the shape of a geom; None for a plane, which is never part of a robot."""
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
    joint = Joint(
        name,
        kind,
        *ends,
        X_PC,
        frozen_array(model.jnt_axis[j]),
        limits=(float(model.jnt_range[j][0]), float(model.jnt_range[j][1])) if limited else None,
        damping=float(np.ravel(model.dof_damping[dof])[0]),
        friction=float(model.dof_frictionloss[dof]),
        armature=float(model.dof_armature[dof]),
        position=float(qpos[at]),
    )
    reference = float(model.qpos0[at])  # the model's poses are those at this position
    if reference == 0.0:
        return joint
    return replace(joint, X_PC=X_PC @ joint_transform(joint, -reference))


def _drives(read: MujocoRobot, joints: dict[int, str]) -> dict[str, Drive]:
    """Return the actuators that drive a single joint, and those of the gripper for each joint that leads others."""
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
    """Yield the gripper's joints that do not follow another joint."""
    gripper = read.native.gripper
    if gripper is not None:
        yield from (name for name in gripper.joints if name not in gripper.follow)


def _mimics(read: MujocoRobot, names: dict[str, str]) -> tuple[dict[str, Mimic], int]:
    """Return the mimic of each joint, from the description or the model's equations, and the number of loops cut."""
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
