"""The MuJoCo session, which reads back an MJCF build that its own ``load.py`` loaded."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np

from simfoundry.geometry.frames import Pose
from simfoundry.runtime.plugins import import_file
from simfoundry.verify import readback as rb

_contacts = import_file(Path(__file__).with_name("contacts.py"))
Meetings, PROXY = _contacts.Meetings, _contacts.PROXY

_JOINT, _GEOM = mujoco.mjtJoint, mujoco.mjtGeom
_TYPES = {int(_JOINT.mjJNT_SLIDE): "prismatic", int(_JOINT.mjJNT_HINGE): "revolute", int(_JOINT.mjJNT_BALL): "ball"}
_KINDS = {int(_GEOM.mjGEOM_BOX): "box", int(_GEOM.mjGEOM_SPHERE): "sphere", int(_GEOM.mjGEOM_CYLINDER): "cylinder",
          int(_GEOM.mjGEOM_CAPSULE): "capsule", int(_GEOM.mjGEOM_MESH): "mesh",
          int(_GEOM.mjGEOM_ELLIPSOID): "ellipsoid"}  # fmt: skip


def open_build(folder: Path, loader: ModuleType) -> rb.Session:
    """Return a session for the build in ``folder``, which is opened by its loader."""
    return MujocoSession(*loader.load())


class MujocoSession(rb.Session):
    """A MuJoCo model and its data."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self.model, self.data, self.timestep = model, data, float(model.opt.timestep)
        names = {model.body(k).name: k for k in range(1, model.nbody)}
        # In USD, a body whose name is a path is the prim that contains the links of a fixed object.
        self._bodies = {name: k for name, k in names.items() if PROXY not in name and "/" not in name}
        self._meetings = Meetings(model)
        self._roots = {name: k for name, k in self._bodies.items() if "." not in name or self._held(k) == rb.FREE}
        joints = {model.joint(k).name: k for k in range(model.njnt)}
        self._joints = {n: k for n, k in joints.items() if model.jnt_type[k] != mujoco.mjtJoint.mjJNT_FREE}

    def step(self) -> None:
        """Advance the simulation by one step."""
        mujoco.mj_step(self.model, self.data)

    def moment(self, time: float) -> rb.Moment:
        """Return a sample after updating the kinematics, because body poses would otherwise lag by one step."""
        mujoco.mj_kinematics(self.model, self.data)
        poses = {name: self._pose(k) for name, k in self._roots.items()}
        return rb.Moment(time, poses, {name: self._position(k) for name, k in self._joints.items()})

    def read(self) -> rb.WorldReadback:
        """Return the bodies, the joints and the friction of each pair of surfaces."""
        mujoco.mj_forward(self.model, self.data)
        links, pairs = self._contacts({name: self._link(name, k) for name, k in self._bodies.items()})
        return rb.WorldReadback(
            links=links,
            joints={name: self._joint(k) for name, k in self._joints.items()},
            gravity=rb.numbers(self.model.opt.gravity),
            pairs=pairs,
            silent=self._silent(),
            actuators=tuple(self.model.actuator(k).name for k in range(self.model.nu)),
        )

    def _pose(self, body: int) -> tuple[float, ...]:
        return rb.pose_numbers(Pose.of(self.data.xpos[body], self.data.xquat[body]))

    def _position(self, joint: int) -> float:
        return float(self.data.qpos[self.model.jnt_qposadr[joint]])

    def _held(self, body: int) -> str:
        """Return the parent of a body. A child of the world is either welded to it or free."""
        parent, start = int(self.model.body_parentid[body]), int(self.model.body_jntadr[body])
        if self.model.body_jntnum[body] and self.model.jnt_type[start] == _JOINT.mjJNT_FREE:
            return rb.FREE
        name = self.model.body(parent).name
        return name if name in self._bodies else rb.WORLD

    def _link(self, name: str, body: int) -> rb.LinkReadback:
        model = self.model
        axes = Pose.of(q=model.body_iquat[body]).rotation
        felt = self._felt(body)
        own = [self._meetings.surface(geom) for geom in felt]
        return rb.LinkReadback(
            pose=self._pose(body),
            mass=float(model.body_mass[body]),
            com=rb.numbers(model.body_ipos[body]),
            inertia=rb.numbers(axes @ np.diag(model.body_inertia[body]) @ axes.T),
            held=self._held(body),
            colliders=tuple(self._collider(name, geom, row) for geom, row in zip(felt, own, strict=True)),
            gravity_compensation=float(model.body_gravcomp[body]),
        )

    def _collider(self, link: str, geom: int, surface: tuple[float, float, float]) -> rb.ColliderReadback:
        model = self.model
        kind = _KINDS.get(int(model.geom_type[geom]), "other")
        X_LG = Pose.of(model.geom_pos[geom], model.geom_quat[geom])
        x, y, z = (2 * float(v) for v in model.geom_size[geom])
        if kind == "mesh":  # MuJoCo moves the mesh to its inertial frame and the geom in the opposite direction
            mesh = model.geom_dataid[geom]
            start = model.mesh_vertadr[mesh]
            bounds = rb.mesh_bounds(model.mesh_vert[start : start + model.mesh_vertnum[mesh]], X_LG)
        else:
            size = {"box": (x, y, z), "ellipsoid": (x / 2, y / 2, z / 2), "sphere": (x / 2,)}.get(kind, (x / 2, y))
            bounds = rb.shape_bounds(kind, size, X_LG)
        name = model.geom(geom).name.removeprefix(f"{link}.")
        sliding, spinning, rolling = surface
        return rb.ColliderReadback(name, kind, bounds, friction=sliding, spinning=spinning, rolling=rolling)

    def _joint(self, joint: int) -> rb.JointReadback:
        model, dof = self.model, self.model.jnt_dofadr[joint]
        limited, ball = bool(model.jnt_limited[joint]), model.jnt_type[joint] == _JOINT.mjJNT_BALL
        at = int(model.jnt_qposadr[joint])
        follows, law = self._law(joint)
        drive, effort = self._drive(joint)
        return rb.JointReadback(
            type=_TYPES.get(int(model.jnt_type[joint]), "other"),
            axis=None if ball else rb.numbers(model.jnt_axis[joint]),
            limits=rb.numbers(model.jnt_range[joint]) if limited else (),
            damping=float(np.ravel(model.dof_damping[dof])[0]),
            friction=float(model.dof_frictionloss[dof]),
            armature=float(model.dof_armature[dof]),
            position=rb.numbers(self.data.qpos[at : at + 4]) if ball else self._position(joint),
            follows=follows,
            law=law,
            drive=drive,
            effort=effort,
            max_effort=rb.numbers(model.jnt_actfrcrange[joint][1:]) if model.jnt_actfrclimited[joint] else (),
            max_velocity=(),
        )

    def _law(self, joint: int) -> tuple[str, tuple[float, ...]]:
        """Return the leader in a joint's equality constraint, followed by the multiplier and the offset."""
        model = self.model
        for k in range(model.neq):
            if model.eq_type[k] == mujoco.mjtEq.mjEQ_JOINT and model.eq_obj1id[k] == joint and model.eq_obj2id[k] >= 0:
                offset, multiplier, *bent = (float(v) for v in model.eq_data[k][:5])
                return model.joint(int(model.eq_obj2id[k])).name, (multiplier, offset, *(v for v in bent if v))
        return "", ()

    def _drive(self, joint: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return the stiffness, damping and target of a joint's actuator, and its maximum force."""
        model = self.model
        for k in range(model.nu):
            if model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_JOINT and model.actuator_trnid[k][0] == joint:
                stiffness, damping = -float(model.actuator_biasprm[k][1]), -float(model.actuator_biasprm[k][2])
                limited = bool(model.actuator_forcelimited[k])
                effort = (float(model.actuator_forcerange[k][1]),) if limited else ()
                return (stiffness, damping, float(self.data.ctrl[k])), effort
        return (), ()

    def _silent(self) -> tuple[str, ...]:
        """Return the pairs of bodies that MuJoCo never tests for collisions or whose geoms can never collide."""
        bodies = [body for body in self._bodies.values() if self._meetings.colliders.get(body)]
        apart = [(a, b) for a, b in combinations(bodies, 2) if not self._meetings.touch(a, b)]
        return tuple(rb.pair_name(self.model.body(a).name, self.model.body(b).name) for a, b in apart)

    def _felt(self, body: int) -> list[int]:
        return [geoms[0] for geoms in self._meetings.colliders.get(body, {}).values()]

    def _contacts(self, links: Mapping[str, rb.LinkReadback]) -> tuple[dict[str, rb.LinkReadback], dict[str, float]]:
        """Return the links, and the friction of each colliding pair unless both colliders already have that value.

        A collider's spinning and rolling resistance is taken from its contacts instead of from its own values.
        """
        own = {f"{name}.{c.name}": c for name, link in links.items() for c in link.colliders or ()}
        pairs, odd = {}, dict[str, rb.ColliderReadback]()
        for a, b, met in self._meetings.contacts():
            if a not in own or b not in own:
                continue
            one, other = own[a], own[b]
            if one.friction != other.friction or met.friction != one.friction:
                pairs[rb.pair_name(a, b)] = met.friction
            for quantity in ("spinning", "rolling"):
                meant = max(getattr(one, quantity), getattr(other, quantity))
                if getattr(met, quantity) != meant:
                    name = a if getattr(one, quantity) == meant else b
                    odd[name] = replace(odd.get(name, own[name]), **{quantity: getattr(met, quantity)})
        return {name: _with(name, link, odd) for name, link in links.items()}, pairs


def _with(name: str, link: rb.LinkReadback, odd: Mapping[str, rb.ColliderReadback]) -> rb.LinkReadback:
    return replace(link, colliders=tuple(odd.get(f"{name}.{c.name}", c) for c in link.colliders or ())) if odd else link
