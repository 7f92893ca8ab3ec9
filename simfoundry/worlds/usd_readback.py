"""What a compiled stage says, read back in the scene's terms; nothing here shares code with the backend."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from simfoundry.scene.frames import Array, Pose, frozen_array
from simfoundry.scene.model import JointType
from simfoundry.scene.state import SceneState
from simfoundry.worlds.base import JointFacts, LinkFacts

if TYPE_CHECKING:
    from pxr import Gf, Usd, UsdGeom

_OBJECTS = "/World/Objects"


def read_back(stage: Usd.Stage) -> dict[str, LinkFacts]:
    """Every link by its qualified name: the object's for its root, which is the first, else ``object.link``."""
    from pxr import UsdGeom

    cache = UsdGeom.XformCache()
    return {name: _link_facts(prim, cache) for name, prim in _links(stage)}


def read_back_joints(stage: Usd.Stage) -> dict[str, JointFacts]:
    """Every joint that moves by ``object.joint``."""
    return {name: _joint_facts(prim) for name, prim in _joints(stage) if _moves(prim)}


def read_back_state(stage: Usd.Stage) -> SceneState:
    """Poses of the objects, and positions of the joints that move, as the stage states them."""
    from pxr import UsdGeom

    cache = UsdGeom.XformCache()
    poses = {prim.GetName(): _world_pose(prim, cache) for prim in _objects(stage)}
    return SceneState.of(poses, {name: _position(prim) for name, prim in _joints(stage) if _moves(prim)})


def poses_by_joints(stage: Usd.Stage) -> dict[str, Pose]:
    """Pose ``X_WL`` of every link that hangs on a joint, by qualified name, from the joint's frames and position.

    The frames are in single precision. A parent that hangs on no joint stands where the stage poses it.
    """
    from pxr import UsdGeom, UsdPhysics

    cache = UsdGeom.XformCache()
    names = {prim.GetPath(): name for name, prim in _links(stage)}
    poses: dict[str, Pose] = {}
    for _, prim in _joints(stage):
        joint = UsdPhysics.Joint(prim)
        body0, body1 = (rel.GetTargets()[0] for rel in (joint.GetBody0Rel(), joint.GetBody1Rel()))
        X_0J = Pose.of(joint.GetLocalPos0Attr().Get(), _wxyz(joint.GetLocalRot0Attr().Get()))
        X_1J = Pose.of(joint.GetLocalPos1Attr().Get(), _wxyz(joint.GetLocalRot1Attr().Get()))
        X_W0 = poses.get(names.get(body0, ""), _world_pose(stage.GetPrimAtPath(body0), cache))
        poses[names[body1]] = X_W0 @ X_0J @ _motion(prim) @ X_1J.inverse()
    return poses


def _objects(stage: Usd.Stage) -> list[Usd.Prim]:
    return list(stage.GetPrimAtPath(_OBJECTS).GetChildren())


def _links(stage: Usd.Stage) -> Iterator[tuple[str, Usd.Prim]]:
    for item in _objects(stage):
        links = [prim for prim in item.GetChildren() if prim.GetTypeName() == "Xform"]
        for k, prim in enumerate(links):
            yield (item.GetName() if k == 0 else f"{item.GetName()}.{prim.GetName()}"), prim


def _joints(stage: Usd.Stage) -> Iterator[tuple[str, Usd.Prim]]:
    for item in _objects(stage):
        scope = item.GetChild("Joints")
        for prim in scope.GetChildren() if scope else []:
            yield f"{item.GetName()}.{prim.GetName()}", prim


def _link_facts(prim: Usd.Prim, cache: UsdGeom.XformCache) -> LinkFacts:
    from pxr import UsdPhysics

    mass = UsdPhysics.MassAPI(prim)
    axes = Pose.of(q=_wxyz(mass.GetPrincipalAxesAttr().Get())).rotation
    moments = np.array(mass.GetDiagonalInertiaAttr().Get(), dtype=np.float64)
    colliders = prim.GetChild("Colliders")
    return LinkFacts(
        mass=float(mass.GetMassAttr().Get()),
        com=frozen_array(mass.GetCenterOfMassAttr().Get()),
        inertia=frozen_array(axes @ np.diag(moments) @ axes.T),
        X_WL=_world_pose(prim, cache),
        friction=tuple(_friction(child) for child in (colliders.GetChildren() if colliders else [])),
    )


def _friction(collider: Usd.Prim) -> float:
    """Coefficient of a collider's surface against its like, as the combine mode of its material makes it."""
    from pxr import UsdPhysics, UsdShade

    material, _ = UsdShade.MaterialBindingAPI(collider).ComputeBoundMaterial("physics")
    value = float(UsdPhysics.MaterialAPI(material).GetDynamicFrictionAttr().Get())
    mode = material.GetPrim().GetAttribute("physxMaterial:frictionCombineMode").Get()
    return value * value if mode == "multiply" else value


def _joint_facts(prim: Usd.Prim) -> JointFacts:
    from pxr import UsdPhysics

    kind, unit = _kind(prim)
    typed = UsdPhysics.PrismaticJoint(prim) if kind == "linear" else UsdPhysics.RevoluteJoint(prim)
    lower, upper = (float(attr.Get()) * unit for attr in (typed.GetLowerLimitAttr(), typed.GetUpperLimitAttr()))
    limits = (lower, upper) if math.isfinite(lower) and math.isfinite(upper) else None
    turns = JointType.CONTINUOUS if limits is None else JointType.REVOLUTE
    drive = UsdPhysics.DriveAPI.Get(prim, kind)
    return JointFacts(
        type=JointType.PRISMATIC if kind == "linear" else turns,
        axis=frozen_array(Pose.of(q=_wxyz(typed.GetLocalRot1Attr().Get())).apply(_axis(prim))),
        limits=limits,
        damping=float(drive.GetDampingAttr().Get()) / unit if drive else 0.0,
        friction=_number(prim, f"physxJointAxis:{kind}:dynamicFrictionEffort"),
        armature=_number(prim, f"physxJointAxis:{kind}:armature"),
    )


def _motion(prim: Usd.Prim) -> Pose:
    """Pose of the joint's second frame in its first, at the position that the stage states."""
    if not _moves(prim):
        return Pose.of()
    position, axis = _position(prim), _axis(prim)
    if _kind(prim)[0] == "linear":
        return Pose.of(position * axis)
    return Pose.of(q=np.concatenate([[math.cos(position / 2)], math.sin(position / 2) * axis]))


def _moves(prim: Usd.Prim) -> bool:
    return bool(prim.GetTypeName() != "PhysicsFixedJoint")


def _kind(prim: Usd.Prim) -> tuple[str, float]:
    """The instance name of a joint's drive and state, and how many of our units one of USD's is."""
    return ("linear", 1.0) if prim.GetTypeName() == "PhysicsPrismaticJoint" else ("angular", math.radians(1.0))


def _axis(prim: Usd.Prim) -> Array:
    token: str = prim.GetAttribute("physics:axis").Get()
    return frozen_array(np.eye(3)["XYZ".index(token)])


def _position(prim: Usd.Prim) -> float:
    kind, unit = _kind(prim)
    return _number(prim, f"state:{kind}:physics:position") * unit


def _number(prim: Usd.Prim, name: str) -> float:
    value = prim.GetAttribute(name).Get()
    return 0.0 if value is None else float(value)


def _world_pose(prim: Usd.Prim, cache: UsdGeom.XformCache) -> Pose:
    matrix: Gf.Matrix4d = cache.GetLocalToWorldTransform(prim)
    return Pose.from_matrix(np.array(matrix).T)  # USD multiplies row vectors


def _wxyz(q: Gf.Quatf) -> list[float]:
    return [q.GetReal(), *q.GetImaginary()]
