"""The SAPIEN session (PhysX on the CPU), which reads back a URDF build that its ``load_sapien.py`` loaded."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import sapien
from sapien import physx

from simfoundry.geometry.frames import Pose
from simfoundry.verify import readback as rb

_TYPES = {"prismatic": "prismatic", "revolute": "revolute", "revolute_unwrapped": "revolute"}
_ALONG_X = Pose.of(q=[0.5**0.5, 0.0, 0.5**0.5, 0.0])
"""Rotation from SimFoundry's shapes, which are aligned with z, to PhysX's shapes, which are aligned with x."""

_NO_LIMIT = 1e9

_SINGLE = 1e-6
"""Threshold below which single-precision values count as equal."""


def open_build(folder: Path, loader: ModuleType) -> rb.Session:
    """Return a session for the scene that the loader creates."""
    scene, world = loader.load()
    files = {name: folder / item["urdf"] for name, item in json.loads((folder / "poses.json").read_text()).items()}
    return SapienSession(scene, world, BuildNames(_collider_names(folder), _own_damping(files), loader.HOLD))


class BuildNames(NamedTuple):
    """Data in a build that SAPIEN does not report.

    ``colliders`` contains the shape names in file order, by object and link. ``damping`` contains the damping of the
    joints without their motors. ``holds`` is the damping of a drive that models Coulomb friction.
    """

    colliders: dict[tuple[str, str], list[str]]
    damping: dict[str, float]
    holds: float


def _own_damping(files: dict[str, Path]) -> dict[str, float]:
    """Return the damping of the joints in the files, keyed by ``object.joint``."""
    return {
        f"{name}.{joint.get('name')}": float(dynamics.get("damping", "0"))
        for name, path in files.items()
        for joint in ET.parse(path).getroot().findall("joint")
        if (dynamics := joint.find("dynamics")) is not None
    }


def _collider_names(folder: Path) -> dict[tuple[str, str], list[str]]:
    """Return the collision shape names by object and link, in file order, which is also PhysX's order."""
    return {
        (path.stem, link.get("name", "")): [c.get("name", "") for c in link.findall("collision")]
        for path in folder.glob("*.urdf")
        for link in ET.parse(path).getroot().findall("link")
    }


class SapienSession(rb.Session):
    """A SAPIEN scene with its articulations and single bodies."""

    def __init__(self, scene: sapien.Scene, world: dict[str, Any], told: BuildNames) -> None:
        self.scene, self.world, self.told = scene, world, told
        scene.timestep = self.timestep
        self._links: dict[str, physx.PhysxRigidBaseComponent] = {}
        self._joints: dict[str, physx.PhysxArticulationJoint] = {}
        for name, item in world.items():
            if isinstance(item, physx.PhysxArticulation):
                for k, link in enumerate(item.links):
                    self._links[name if k == 0 else f"{name}.{link.name}"] = link
                self._joints |= {f"{name}.{joint.name}": joint for joint in item.active_joints}
            else:
                parts = (c for c in item.components if isinstance(c, physx.PhysxRigidBaseComponent))
                self._links[name] = next(parts)

    def step(self) -> None:
        """Advance the simulation by one step."""
        self.scene.step()

    def moment(self, time: float) -> rb.Moment:
        """Return the poses of the root links and the positions of the joints."""
        return rb.Moment(time, {name: rb.pose_numbers(_pose(self._links[name].entity_pose)) for name in self.world},
                      self._positions())  # fmt: skip

    def read(self) -> rb.WorldReadback:
        """Return the links, the joints and the gravity in the scene."""
        positions = self._positions()
        joints = {name: self._joint(name, joint, positions[name]) for name, joint in self._joints.items()}
        return rb.WorldReadback(
            links={name: self._link(name, link) for name, link in self._links.items()},
            joints=joints,
            gravity=rb.numbers(self.scene.physx_system.config.gravity),
            actuators=rb.driven(joints),
        )

    def _positions(self) -> dict[str, float]:
        return {
            f"{name}.{joint.name}": float(position)
            for name, item in self.world.items()
            if isinstance(item, physx.PhysxArticulation)
            for joint, position in zip(item.active_joints, item.qpos, strict=True)
        }

    def _link(self, name: str, link: physx.PhysxRigidBaseComponent) -> rb.LinkReadback:
        """Return the values of a link. The mass of a static body is omitted, because PhysX does not store it."""
        item = name.partition(".")[0]
        names = self.told.colliders.get((item, link.name), self.told.colliders.get((name, link.name)))
        shapes = link.collision_shapes
        told = names if names is not None else [None] * len(shapes)  # a robot's own file may split its meshes
        colliders = tuple(_collider(n, s) for n, s in zip(told, shapes, strict=True))
        pose = rb.pose_numbers(_pose(link.entity_pose))
        if not hasattr(link, "mass"):
            return rb.LinkReadback(pose=pose, held=self._held(name, link), colliders=colliders)
        X_LI = _pose(link.cmass_local_pose)
        inertia = X_LI.rotation @ np.diag(np.asarray(link.inertia, dtype=np.float64)) @ X_LI.rotation.T
        return rb.LinkReadback(
            pose, float(link.mass), rb.numbers(X_LI.p), rb.numbers(inertia), self._held(name, link), colliders
        )

    def _held(self, name: str, link: physx.PhysxRigidBaseComponent) -> str | None:
        """Return the parent of a link, or None for the root of an articulation, whose parent SAPIEN does not report."""
        if isinstance(link, physx.PhysxArticulationLinkComponent):
            return None if link.parent is None else next(n for n, k in self._links.items() if k == link.parent)
        return rb.FREE if hasattr(link, "mass") else rb.WORLD

    def _joint(self, name: str, joint: physx.PhysxArticulationJoint, position: float) -> rb.JointReadback:
        """Return the values of a joint. The gains of its drive determine if it models a motor, damping or friction."""
        low, high = (float(v) for v in np.asarray(joint.limits).ravel())
        stiffness, damping = float(joint.stiffness), float(joint.damping)
        holds = stiffness == 0 and damping == self.told.holds
        own = self.told.damping.get(name, 0.0)
        drive = stiffness > 0 or (not holds and damping > own * (1 + _SINGLE) + _SINGLE)
        limit = float(joint.force_limit)
        return rb.JointReadback(
            type=_TYPES.get(joint.type, "other"),
            axis=rb.numbers(_pose(joint.pose_in_child).rotation[:, 0]),
            limits=(low, high) if max(abs(low), abs(high)) < _NO_LIMIT else (),
            damping=own if drive else 0.0 if holds else damping,
            friction=limit if holds else 0.0,
            armature=float(np.ravel(joint.armature)[0]),
            position=position,
            drive=(stiffness, damping - own, float(np.ravel(joint.drive_target)[0])) if drive else (),
            effort=(limit,) if drive and limit < _NO_LIMIT else (),
        )


def _collider(name: str | None, shape: physx.PhysxCollisionShape) -> rb.ColliderReadback:
    kind, bounds = _shape(shape)
    material = shape.physical_material
    return rb.ColliderReadback(name, kind, bounds, float(material.dynamic_friction), float(material.restitution))


def _shape(shape: physx.PhysxCollisionShape) -> tuple[str, rb.Numbers | None]:
    X_LG = _pose(shape.local_pose)
    match shape:
        case physx.PhysxCollisionShapeBox():
            return "box", rb.shape_bounds("box", 2 * np.asarray(shape.half_size), X_LG)
        case physx.PhysxCollisionShapeSphere():
            return "sphere", rb.shape_bounds("sphere", [shape.radius], X_LG)
        case physx.PhysxCollisionShapeCylinder() | physx.PhysxCollisionShapeCapsule():
            kind = "cylinder" if isinstance(shape, physx.PhysxCollisionShapeCylinder) else "capsule"
            return kind, rb.shape_bounds(kind, [shape.radius, 2 * shape.half_length], X_LG @ _ALONG_X.inverse())
        case physx.PhysxCollisionShapeConvexMesh():
            return "mesh", rb.mesh_bounds(np.asarray(shape.vertices) * np.asarray(shape.scale), X_LG)
    return "other", None


def _pose(pose: sapien.Pose) -> Pose:
    return Pose.of(pose.p, pose.q)
