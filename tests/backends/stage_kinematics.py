"""The state and the joint frames of a compiled stage; nothing here shares code with the backend."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from simfoundry.geometry.frames import Array, Pose, frozen_array
from simfoundry.scene.state import SceneState

if TYPE_CHECKING:
    from pxr import Gf, Usd, UsdGeom

_OBJECTS = "/World/Objects"
_BALL = "PhysicsSphericalJoint"


def read_back_state(stage: Usd.Stage) -> SceneState:
    """Poses of the objects, and positions of the joints that move, as the stage states them."""
    from pxr import UsdGeom

    cache = UsdGeom.XformCache()
    poses = {prim.GetName(): _world_pose(prim, cache) for prim in _objects(stage)}
    joints = {name: _position(prim) for name, prim in _joints(stage) if _has_axis(prim)}
    return SceneState.of(poses, joints, _motions(stage, cache))


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
        motion = _motion(prim)
        if motion is None:  # a ball joint's state is nowhere but in the poses of its bodies
            motion = _relative(prim, cache)
        poses[names[body1]] = X_W0 @ X_0J @ motion @ X_1J.inverse()
    return poses


def _relative(joint: Usd.Prim, cache: UsdGeom.XformCache) -> Pose:
    """Pose of a joint's second frame in its first, from where its bodies stand."""
    from pxr import UsdPhysics

    api = UsdPhysics.Joint(joint)
    stage = joint.GetStage()
    X_W0, X_W1 = (
        _world_pose(stage.GetPrimAtPath(r.GetTargets()[0]), cache) for r in (api.GetBody0Rel(), api.GetBody1Rel())
    )
    X_0J = Pose.of(api.GetLocalPos0Attr().Get(), _wxyz(api.GetLocalRot0Attr().Get()))
    X_1J = Pose.of(api.GetLocalPos1Attr().Get(), _wxyz(api.GetLocalRot1Attr().Get()))
    return (X_W0 @ X_0J).inverse() @ X_W1 @ X_1J


def _motions(stage: Usd.Stage, cache: UsdGeom.XformCache) -> dict[str, Pose]:
    """Motions of ball joints, and of free ones: a free link states the frame in which it is at rest at zero."""
    found = {name: _relative(prim, cache) for name, prim in _joints(stage) if prim.GetTypeName() == _BALL}
    for name, prim in _free_links(stage):
        target = prim.GetRelationship("simfoundry:freeParent").GetTargets()[0]
        X_PC = Pose.from_matrix(np.array(prim.GetAttribute("simfoundry:freePose").Get()).T)
        X_WZ = _world_pose(stage.GetPrimAtPath(target), cache) @ X_PC
        found[name] = X_WZ.inverse() @ _world_pose(prim, cache)
    return found


def _free_links(stage: Usd.Stage) -> Iterator[tuple[str, Usd.Prim]]:
    """Links that hang on a free joint, by ``object.joint``."""
    for item in _objects(stage):
        for prim in item.GetChildren():
            joint = prim.GetAttribute("simfoundry:freeJoint").Get()
            if joint:
                yield f"{item.GetName()}.{joint}", prim


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


def _motion(prim: Usd.Prim) -> Pose | None:
    """Pose of the joint's second frame in its first, at the position that the stage states; None for a ball joint."""
    if prim.GetTypeName() == _BALL:
        return None
    if not _moves(prim):
        return Pose.of()
    position, axis = _position(prim), _axis(prim)
    if _kind(prim)[0] == "linear":
        return Pose.of(position * axis)
    return Pose.of(q=np.concatenate([[math.cos(position / 2)], math.sin(position / 2) * axis]))


def _moves(prim: Usd.Prim) -> bool:
    return bool(prim.GetTypeName() != "PhysicsFixedJoint")


def _has_axis(prim: Usd.Prim) -> bool:
    return _moves(prim) and bool(prim.GetTypeName() != _BALL)


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
