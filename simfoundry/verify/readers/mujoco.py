"""MuJoCo, from the mjcf build through its own ``load.py``."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import mujoco
import numpy as np

from simfoundry.scene.frames import Pose
from simfoundry.verify.facts import (
    FREE,
    WORLD,
    ColliderFacts,
    Facts,
    JointFacts,
    LinkFacts,
    Moment,
    mesh_bounds,
    numbers,
    pair_name,
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
            silent=self._silent(),
            actuators=tuple(self.model.actuator(k).name for k in range(self.model.nu)),
        )

    def close(self) -> None:
        """MuJoCo frees its memory with the objects."""

    def _pose(self, body: int) -> tuple[float, ...]:
        return pose_numbers(Pose.of(self.data.xpos[body], self.data.xquat[body]))

    def _position(self, joint: int) -> float:
        return float(self.data.qpos[self.model.jnt_qposadr[joint]])

    def _held(self, body: int) -> str:
        """A body in the world is welded to it or free; any other is held by the one above."""
        parent, start = int(self.model.body_parentid[body]), int(self.model.body_jntadr[body])
        if self.model.body_jntnum[body] and self.model.jnt_type[start] == _JOINT.mjJNT_FREE:
            return FREE
        return self.model.body(parent).name if parent else WORLD

    def _link(self, name: str, body: int) -> LinkFacts:
        model = self.model
        axes = Pose.of(q=model.body_iquat[body]).rotation
        felt = self._felt(body)
        return LinkFacts(
            pose=self._pose(body),
            mass=float(model.body_mass[body]),
            com=numbers(model.body_ipos[body]),
            inertia=numbers(axes @ np.diag(model.body_inertia[body]) @ axes.T),
            held=self._held(body),
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
        # What a geom says of spinning and rolling counts in contacts of as many dimensions.
        friction, dimensions = model.geom_friction[geom], int(model.geom_condim[geom])
        spinning, rolling = float(friction[1]) * (dimensions > 3), float(friction[2]) * (dimensions > 4)
        return ColliderFacts(name, kind, bounds, friction=float(friction[0]), spinning=spinning, rolling=rolling)

    def _joint(self, joint: int) -> JointFacts:
        model, dof = self.model, self.model.jnt_dofadr[joint]
        limited, ball = bool(model.jnt_limited[joint]), model.jnt_type[joint] == _JOINT.mjJNT_BALL
        at = int(model.jnt_qposadr[joint])
        follows, law = self._law(joint)
        drive, effort = self._drive(joint)
        return JointFacts(
            type=_TYPES.get(int(model.jnt_type[joint]), "other"),
            axis=None if ball else numbers(model.jnt_axis[joint]),
            limits=numbers(model.jnt_range[joint]) if limited else (),
            damping=float(np.ravel(model.dof_damping[dof])[0]),
            friction=float(model.dof_frictionloss[dof]),
            armature=float(model.dof_armature[dof]),
            position=numbers(self.data.qpos[at : at + 4]) if ball else self._position(joint),
            follows=follows,
            law=law,
            drive=drive,
            effort=effort,
        )

    def _law(self, joint: int) -> tuple[str, tuple[float, ...]]:
        """The joint that an equality makes it follow, with multiplier and offset."""
        model = self.model
        for k in range(model.neq):
            if model.eq_type[k] == mujoco.mjtEq.mjEQ_JOINT and model.eq_obj1id[k] == joint and model.eq_obj2id[k] >= 0:
                offset, multiplier, *bent = (float(v) for v in model.eq_data[k][:5])
                return model.joint(int(model.eq_obj2id[k])).name, (multiplier, offset, *(v for v in bent if v))
        return "", ()

    def _drive(self, joint: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Stiffness, damping and target of the actuator in a joint, and its greatest force."""
        model = self.model
        for k in range(model.nu):
            if model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_JOINT and model.actuator_trnid[k][0] == joint:
                stiffness, damping = -float(model.actuator_biasprm[k][1]), -float(model.actuator_biasprm[k][2])
                limited = bool(model.actuator_forcelimited[k])
                effort = (float(model.actuator_forcerange[k][1]),) if limited else ()
                return (stiffness, damping, float(self.data.ctrl[k])), effort
        return (), ()

    def _silent(self) -> tuple[str, ...]:
        """Pairs of bodies that MuJoCo never tests, or whose geoms it never lets touch, by its own rules."""
        model = self.model
        excluded = {int(k) for k in model.exclude_signature}
        explicit = {
            frozenset((int(model.geom_bodyid[a]), int(model.geom_bodyid[b])))
            for a, b in zip(model.pair_geom1, model.pair_geom2, strict=True)
        }
        felt = {
            body: [(int(model.geom_contype[g]), int(model.geom_conaffinity[g])) for g in self._felt(body)]
            for body in self._bodies.values()
        }
        weld = [int(k) for k in model.body_weldid]
        above = [weld[int(model.body_parentid[w])] for w in weld]
        found = []
        for a, b in combinations([body for body, masks in felt.items() if masks], 2):
            if frozenset((a, b)) in explicit:
                continue
            joined = weld[a] == weld[b] or (weld[b] and weld[a] == above[b]) or (weld[a] and weld[b] == above[a])
            parents = joined and not (weld[a] == 0 or weld[b] == 0)  # what is welded to the world is no parent
            meet = any((t & d) or (u & c) for t, c in felt[a] for u, d in felt[b])
            if (a << 16) + b in excluded or weld[a] == weld[b] or parents or not meet:
                found.append(pair_name(model.body(a).name, model.body(b).name))
        return tuple(found)

    def _felt(self, body: int) -> list[int]:
        model = self.model
        start, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
        return [g for g in range(start, start + count) if model.geom_contype[g] or model.geom_conaffinity[g]]

    def _pairs(self) -> dict[str, float]:
        model = self.model
        found = {}
        for k in range(model.npair):
            names = sorted(model.geom(int(g[k])).name for g in (model.pair_geom1, model.pair_geom2))
            found["|".join(names)] = float(model.pair_friction[k][0])
        return found
