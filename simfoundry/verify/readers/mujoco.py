"""MuJoCo, from the mjcf build through its own ``load.py``."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from simfoundry.scene.frames import Pose
from simfoundry.verify.facts import (
    ColliderFacts,
    Facts,
    JointFacts,
    LinkFacts,
    Moment,
    mesh_bounds,
    numbers,
    pose_numbers,
    shape_bounds,
)
from simfoundry.verify.readers import Session, load_module

_JOINT, _GEOM = mujoco.mjtJoint, mujoco.mjtGeom
_TYPES = {int(_JOINT.mjJNT_SLIDE): "prismatic", int(_JOINT.mjJNT_HINGE): "revolute", int(_JOINT.mjJNT_BALL): "ball"}
_KINDS = {int(_GEOM.mjGEOM_BOX): "box", int(_GEOM.mjGEOM_SPHERE): "sphere", int(_GEOM.mjGEOM_CYLINDER): "cylinder",
          int(_GEOM.mjGEOM_CAPSULE): "capsule", int(_GEOM.mjGEOM_MESH): "mesh"}  # fmt: skip


def open_build(folder: Path) -> Session:
    """The build in ``folder`` as its loader gives it."""
    return MujocoSession(*load_module(folder / "load.py").load())


class MujocoSession:
    """A model and its data."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self.model, self.data = model, data
        self._bodies = {model.body(k).name: k for k in range(1, model.nbody)}
        self._roots = {name: k for name, k in self._bodies.items() if model.body_parentid[k] == 0}
        joints = {model.joint(k).name: k for k in range(model.njnt)}
        self._joints = {n: k for n, k in joints.items() if model.jnt_type[k] != mujoco.mjtJoint.mjJNT_FREE}

    @property
    def timestep(self) -> float:
        """As the file says."""
        return float(self.model.opt.timestep)

    def step(self) -> None:
        """One step."""
        mujoco.mj_step(self.model, self.data)

    def moment(self, time: float) -> Moment:
        """From kinematics: after a step MuJoCo's body poses are still those before it."""
        mujoco.mj_kinematics(self.model, self.data)
        poses = {name: self._pose(k) for name, k in self._roots.items()}
        return Moment(time, poses, {name: self._position(k) for name, k in self._joints.items()})

    def facts(self) -> Facts:
        """Bodies, joints, pairs."""
        mujoco.mj_forward(self.model, self.data)
        return Facts(
            links={name: self._link(name, k) for name, k in self._bodies.items()},
            joints={name: self._joint(k) for name, k in self._joints.items()},
            gravity=numbers(self.model.opt.gravity),
            pairs=self._pairs(),
        )

    def close(self) -> None:
        """MuJoCo frees its memory with the objects."""

    def _pose(self, body: int) -> tuple[float, ...]:
        return pose_numbers(Pose.of(self.data.xpos[body], self.data.xquat[body]))

    def _position(self, joint: int) -> float:
        return float(self.data.qpos[self.model.jnt_qposadr[joint]])

    def _link(self, name: str, body: int) -> LinkFacts:
        model = self.model
        axes = Pose.of(q=model.body_iquat[body]).rotation
        start, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
        felt = [g for g in range(start, start + count) if model.geom_contype[g] or model.geom_conaffinity[g]]
        return LinkFacts(
            pose=self._pose(body),
            mass=float(model.body_mass[body]),
            com=numbers(model.body_ipos[body]),
            inertia=numbers(axes @ np.diag(model.body_inertia[body]) @ axes.T),
            colliders=tuple(self._collider(name, geom) for geom in felt),
        )

    def _collider(self, link: str, geom: int) -> ColliderFacts:
        model = self.model
        kind = _KINDS.get(int(model.geom_type[geom]), "other")
        X_LG = Pose.of(model.geom_pos[geom], model.geom_quat[geom])
        x, y, z = (2 * float(v) for v in model.geom_size[geom])
        if kind == "mesh":  # MuJoCo moves a mesh into its inertial frame, and the geom the other way
            mesh = model.geom_dataid[geom]
            start = model.mesh_vertadr[mesh]
            bounds = mesh_bounds(model.mesh_vert[start : start + model.mesh_vertnum[mesh]], X_LG)
        else:
            size = {"box": (x, y, z), "sphere": (x / 2,)}.get(kind, (x / 2, y))
            bounds = shape_bounds(kind, size, X_LG)
        name = model.geom(geom).name.removeprefix(f"{link}.")
        return ColliderFacts(name, kind, bounds, friction=float(model.geom_friction[geom][0]))

    def _joint(self, joint: int) -> JointFacts:
        model, dof = self.model, self.model.jnt_dofadr[joint]
        limited = bool(model.jnt_limited[joint])
        return JointFacts(
            type=_TYPES.get(int(model.jnt_type[joint]), "other"),
            axis=numbers(model.jnt_axis[joint]),
            limits=numbers(model.jnt_range[joint]) if limited else (),
            damping=float(np.ravel(model.dof_damping[dof])[0]),
            friction=float(model.dof_frictionloss[dof]),
            armature=float(model.dof_armature[dof]),
            position=self._position(joint),
        )

    def _pairs(self) -> dict[str, float]:
        model = self.model
        found = {}
        for k in range(model.npair):
            names = sorted(model.geom(int(g[k])).name for g in (model.pair_geom1, model.pair_geom2))
            found["|".join(names)] = float(model.pair_friction[k][0])
        return found
