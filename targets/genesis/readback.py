"""The Genesis session, which reads back a URDF build that its ``load_genesis.py`` loaded."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import genesis as gs
import numpy as np

from simfoundry.geometry.frames import Pose
from simfoundry.verify import readback as rb

_NO_LIMIT = 1e8
_TYPES = {gs.JOINT_TYPE.REVOLUTE: "revolute", gs.JOINT_TYPE.PRISMATIC: "prismatic"}


def open_build(folder: Path, loader: ModuleType) -> rb.Session:
    """Return a session for the scene that the loader creates."""
    scene, entities = loader.load(time_step=rb.TIMESTEP)
    return GenesisSession(scene, entities)


class GenesisSession(rb.Session):
    """A Genesis scene on the CPU, along with its entities."""

    def __init__(self, scene: Any, entities: dict[str, Any]) -> None:
        self.scene, self.entities = scene, entities
        self._joints = {
            f"{name.partition('.')[0]}.{joint.name}": (entity, joint)
            for name, entity in entities.items()
            for joint in entity.joints
            if joint.type in _TYPES
        }

    def step(self) -> None:
        """Advance the simulation by one step."""
        self.scene.step()

    def moment(self, time: float) -> rb.Moment:
        """Return the poses of the root links and the positions of the joints."""
        poses = {name: rb.pose_numbers(_poses(entity)[0]) for name, entity in self.entities.items()}
        return rb.Moment(time, poses, {name: _position(*at) for name, at in self._joints.items()})

    def read(self) -> rb.WorldReadback:
        """Return the links, the joints and the gravity in the scene."""
        links: dict[str, rb.LinkReadback] = {}
        for name, entity in self.entities.items():
            called = {
                link.idx: name if k == 0 else f"{name.partition('.')[0]}.{link.name}"
                for k, link in enumerate(entity.links)
            }
            masses = _array(entity.get_links_mass())
            for k, (link, X_WL) in enumerate(zip(entity.links, _poses(entity), strict=True)):
                com, inertia = _array(entity.get_links_COM([k]))[0], _array(entity.get_links_inertia([k]))[0]
                held = called.get(link.parent_idx) or (rb.WORLD if link.is_fixed else rb.FREE)
                turn = Pose.of(q=_array(link.desc.inertial_quat)).rotation
                links[called[link.idx]] = rb.LinkReadback(
                    rb.pose_numbers(X_WL), float(masses[k]), rb.numbers(com), rb.numbers(turn @ inertia @ turn.T), held,
                    tuple(_collider(geom) for geom in link.geoms),
                )  # fmt: skip
        joints = {name: _joint(*at) for name, at in self._joints.items()}
        gravity = rb.numbers(_array(self.scene.sim.rigid_solver.get_gravity()).reshape(-1)[:3])
        return rb.WorldReadback(links, joints, gravity, actuators=rb.driven(joints))

    def close(self) -> None:
        """Release the scene."""
        self.scene.destroy()


def _array(values: Any) -> np.ndarray:
    """Convert a tensor or an array to double precision."""
    return np.asarray(values.cpu() if hasattr(values, "cpu") else values, dtype=np.float64)


def _poses(entity: Any) -> list[Pose]:
    rows = zip(_array(entity.get_links_pos()), _array(entity.get_links_quat()), strict=True)
    return [Pose.of(p, q) for p, q in rows]


def _position(entity: Any, joint: Any) -> float:
    return float(_array(entity.get_dofs_position(joint.dofs_idx_local))[0])


def _joint(entity: Any, joint: Any) -> rb.JointReadback:
    """Return the values of a joint. All joints have gains, so a motor is reported only if it has a position target."""
    dofs = joint.dofs_idx_local
    low, high = (float(_array(bound)[0]) for bound in entity.get_dofs_limit(dofs))
    one = {
        what: float(_array(getattr(entity, f"get_dofs_{what}")(dofs))[0])
        for what in ("damping", "frictionloss", "armature", "kp", "kv")
    }
    solver, index = entity.solver, joint.dof_start
    driven = int(_array(solver.dyn_state.dofs.ctrl_mode.to_numpy())[index, 0]) == int(gs.CTRL_MODE.POSITION)
    target = float(_array(solver.dyn_state.dofs.ctrl_pos.to_numpy())[index, 0])
    limit = float(_array(entity.get_dofs_force_range(dofs)[1])[0])
    known = solver.dyn_info.dofs
    motion = known.motion_vel if joint.type == gs.JOINT_TYPE.PRISMATIC else known.motion_ang
    return rb.JointReadback(
        type=_TYPES[joint.type],
        axis=rb.numbers(_array(motion.to_numpy())[index].ravel()),
        limits=(low, high) if max(abs(low), abs(high)) < _NO_LIMIT else (),
        damping=one["damping"],
        friction=one["frictionloss"],
        armature=one["armature"],
        position=_position(entity, joint),
        drive=(one["kp"], one["kv"], target) if driven else (),
        effort=(limit,) if driven and limit < _NO_LIMIT else (),
    )


def _collider(geom: Any) -> rb.ColliderReadback:
    """Return a collision shape. Genesis does not store names, and it converts unsupported shapes to meshes."""
    kind, bounds = _shape(geom)
    return rb.ColliderReadback(None, kind, bounds, float(_array(geom.get_friction()).ravel()[0]))


def _shape(geom: Any) -> tuple[str, rb.Numbers | None]:
    X_LG = Pose.of(_array(geom.init_pos), _array(geom.init_quat))
    data = _array(geom.data)
    match geom.type:
        case gs.GEOM_TYPE.BOX:
            return "box", rb.shape_bounds("box", data[:3], X_LG)
        case gs.GEOM_TYPE.SPHERE:
            return "sphere", rb.shape_bounds("sphere", data[:1], X_LG)
        case gs.GEOM_TYPE.CYLINDER:
            return "cylinder", rb.shape_bounds("cylinder", data[:2], X_LG)
        case gs.GEOM_TYPE.CAPSULE:
            return "capsule", rb.shape_bounds("capsule", data[:2], X_LG)
        case gs.GEOM_TYPE.MESH:
            return "mesh", rb.mesh_bounds(_array(geom.init_verts), X_LG)
    return "other", None
