"""Mounted cameras and robots on a stage. Robots are referenced from their own USD or converted from MJCF or URDF."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from simfoundry.backends.losses import Loss, approximate, drop
from simfoundry.backends.robot_models.mujoco_robot import RobotModelError, read_robot
from simfoundry.backends.usd.bodies import Scopes, content_prim, define_object
from simfoundry.backends.usd.prims import Prim
from simfoundry.backends.usd.surroundings import define_camera
from simfoundry.geometry.frames import Pose
from simfoundry.scene.model import MountedCamera, Scene, SceneObject
from simfoundry.scene.robot import LinkFrame, ModelFormat, NativeModel, Robot, mujoco_model
from simfoundry.scene.robot_files import model_files

if TYPE_CHECKING:
    from pxr import Usd

# Rotation from a y-up stage to a z-up stage.
_UPRIGHT = Pose.of(q=(math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0))

_LAYER = re.compile(r"layer @([^@]+)@")


@dataclass
class RobotsInUsd:
    """The robots on a stage.

    ``items`` are the converted robots, ``files`` maps paths to contents, and ``losses`` lists the losses. ``frames``
    maps the name of a robot and the name of a frame to the prim of the link and the pose of the frame in it.
    """

    items: list[SceneObject] = field(default_factory=list)
    files: dict[str, bytes] = field(default_factory=dict)
    losses: list[Loss] = field(default_factory=list)
    frames: dict[tuple[str, str], tuple[Prim, Pose]] = field(default_factory=dict)


def define_robots(world: Prim, scopes: Scopes, scene: Scene) -> RobotsInUsd:
    """Define all robots below ``/World/Robots``. This prim is omitted if the scene has no robots."""
    found = RobotsInUsd()
    if not scene.robots:
        return found
    parent = world.define("Robots", "Xform")
    parent.kind = "group"
    for robot in scene.robots:
        wanted = [m.link for m in scene.mounted if m.carrier == robot.name]
        native = robot.best(ModelFormat.USD)
        if native is not None:
            _refer(parent, robot, native, wanted, found)
        elif (source := mujoco_model(robot)) is not None:
            _convert(replace(scopes, objects=parent), robot, source, wanted, found)
        reason = "Readers combine the friction in the robot's file with the scene's friction by their own rules."
        found.losses.append(approximate("robot_contacts", robot.name, reason))
    return found


def _convert(scopes: Scopes, robot: Robot, source: NativeModel, wanted: list[str], found: RobotsInUsd) -> None:
    from simfoundry.backends.robot_models.robot_object import as_object, conversion_losses

    made = as_object(robot, read_robot(robot, source, f"{robot.name}."))
    define_object(scopes, made.item)
    found.items.append(made.item)
    found.losses.extend(conversion_losses(robot, source, made.loops))
    prim = scopes.objects.children[robot.name]
    for name in wanted:
        frame = source.frame(name) if name else LinkFrame(next(iter(made.links)))
        if frame.link not in made.links:
            raise RobotModelError.missing(f"robot `{robot.name}`", "link", frame.link, made.links)
        found.frames[robot.name, name] = prim.children[made.links[frame.link]], frame.X_LF


def _refer(parent: Prim, robot: Robot, native: NativeModel, wanted: list[str], found: RobotsInUsd) -> None:
    """Reference the robot's own USD, copy all files in its folder, and set the joint positions of the scene."""
    from pxr import UsdGeom

    stage, by_name = open_model(robot, native)
    default = stage.GetDefaultPrim()
    found.losses.extend(_missing(robot, stage))
    folder = f"robots/{native.file.stem}_{native.digest[:8]}"
    top = native.file.parent
    found.files |= {f"{folder}/{f.relative_to(top).as_posix()}": f.read_bytes() for f in model_files(native.file)}
    prim = parent.define(robot.name, "Xform")
    prim.kind = "component"
    prim.place(robot.X_WB)
    model = prim.define("Model", "Xform")
    model.references.append(f"@./{folder}/{native.file.name}@")
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    turned = UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y
    model.place(_UPRIGHT if turned else Pose.of(), None if unit == 1.0 else (unit, unit, unit))
    for name, position in robot.start(native).items():
        _set_joint(_over(model, default, by_name[name]), by_name[name], position)
    for name in native.joints.values() if robot.has_own_gains else ():
        _scale_drive(_over(model, default, by_name[name]), by_name[name], robot)
    _hold(prim, model, default)
    for name in wanted:
        frame = native.frame(name) if name else LinkFrame(default.GetName())
        if frame.link not in by_name:
            raise RobotModelError(f"robot `{robot.name}`: {native.file.name} has no link `{frame.link}`")
        found.frames[robot.name, name] = _over(model, default, by_name[frame.link]), frame.X_LF


def open_model(robot: Robot, native: NativeModel) -> tuple[Usd.Stage, dict[str, Usd.Prim]]:
    """Open a robot's own USD, and return its stage and the prims below its default prim by name.

    Raises:
        RobotModelError: If the file cannot be read, has no default prim, or lacks a joint of the robot.
    """
    from pxr import Tf, Usd

    try:
        stage = Usd.Stage.Open(str(native.file))
    except Tf.ErrorException as error:
        reason = " ".join(str(error).split())[:120]
        raise RobotModelError(f"robot `{robot.name}`: {native.file} could not be read as USD: {reason}") from None
    default = stage.GetDefaultPrim()
    if not default:
        raise RobotModelError(f"robot `{robot.name}`: {native.file} has no default prim to reference")
    by_name: dict[str, Usd.Prim] = {}
    for one in Usd.PrimRange(default):
        by_name.setdefault(one.GetName(), one)
    for name in robot.start(native):
        if name not in by_name:
            raise RobotModelError(f"robot `{robot.name}`: {native.file.name} has no joint `{name}`")
    return stage, by_name


def _missing(robot: Robot, stage: Usd.Stage) -> Iterator[Loss]:
    """Yield a loss if the robot file refers to missing layers."""
    absent = sorted({name.group(1) for e in stage.GetCompositionErrors() if (name := _LAYER.search(str(e)))})
    if absent:
        count = f"{len(absent)} layers that do" if len(absent) > 1 else "1 layer that does"
        reason = f"The robot's file refers to {count} not exist, such as {absent[0].rpartition('/')[2]}."
        yield drop("robots", robot.name, reason)


def _over(model: Prim, default: Usd.Prim, prim: Usd.Prim) -> Prim:
    """Return the spec that overrides a prim of the referenced stage in our own layer."""
    spec = model
    for name in str(prim.GetPath().MakeRelativePath(default.GetPath())).split("/"):
        if name != ".":
            below = spec.children.get(name)
            spec = below if below is not None else spec.define(name, "", specifier="over")
    return spec


def _set_joint(spec: Prim, joint: Usd.Prim, position: float) -> None:
    """Set the initial position of a joint and the target of its drive, if it has one."""
    from pxr import UsdPhysics

    kind = "linear" if joint.IsA(UsdPhysics.PrismaticJoint) else "angular"
    value = position * (1.0 if kind == "linear" else math.degrees(1.0))
    spec.schemas += [f"PhysicsJointStateAPI:{kind}"]
    spec.floats(value, f"state:{kind}:physics:position")
    spec.floats(0.0, f"state:{kind}:physics:velocity")
    if UsdPhysics.DriveAPI.Get(joint, kind):
        spec.floats(value, f"drive:{kind}:physics:targetPosition")


def _scale_drive(spec: Prim, joint: Usd.Prim, robot: Robot) -> None:
    """Set the gains of a joint's drive, if it has one, to those in the robot's file times the scene's factors."""
    from pxr import UsdPhysics

    kind = "linear" if joint.IsA(UsdPhysics.PrismaticJoint) else "angular"
    drive = UsdPhysics.DriveAPI.Get(joint, kind)
    if drive:
        spec.floats(drive.GetStiffnessAttr().Get() * robot.stiffness, f"drive:{kind}:physics:stiffness")
        spec.floats(drive.GetDampingAttr().Get() * robot.damping, f"drive:{kind}:physics:damping")


def _hold(prim: Prim, model: Prim, default: Usd.Prim) -> None:
    """Weld the first body to the world, unless the robot's own file already does so."""
    from pxr import Usd, UsdPhysics

    bodies = [p for p in Usd.PrimRange(default) if p.HasAPI(UsdPhysics.RigidBodyAPI)]
    stage = default.GetStage()
    for joint in (UsdPhysics.Joint(p) for p in Usd.PrimRange(default) if p.IsA(UsdPhysics.Joint)):
        ends = [map(stage.GetPrimAtPath, end.GetTargets()) for end in (joint.GetBody0Rel(), joint.GetBody1Rel())]
        if sum(any(p and p.HasAPI(UsdPhysics.RigidBodyAPI) for p in end) for end in ends) == 1:
            return
    if bodies:
        anchor = prim.define("Anchor", "PhysicsFixedJoint")
        anchor.relate("physics:body1", [_over(model, default, bodies[0])])


def define_mounted(scopes: Scopes, scene: Scene, robots: RobotsInUsd) -> Iterator[Loss]:
    """Define each mounted camera below its link, and yield a loss for each camera whose link is missing."""
    for mounted in scene.mounted:
        found = list(_carriers(scopes, scene, robots, mounted))
        if not found:
            reason = f"The camera is mounted on `{mounted.carrier}`, which is not written."
            yield drop("mounted_cameras", mounted.camera.name, reason)
        for prim, X_LF in found:
            define_camera(prim, replace(mounted.camera, X_WC=X_LF @ mounted.camera.X_WC))
        item = scene.by_name.get(mounted.carrier)
        for one in (item, *item.variants) if item is not None and mounted.link else ():
            if one.variant and mounted.link not in {link.name for link in one.links}:
                variant = f"Variant `{one.variant}` of `{mounted.carrier}`"
                reason = f"{variant} has no link `{mounted.link}` on which to mount the camera."
                yield approximate("mounted_cameras", mounted.camera.name, reason)


def _carriers(scopes: Scopes, scene: Scene, robots: RobotsInUsd, mounted: MountedCamera) -> Iterator[tuple[Prim, Pose]]:
    """Yield the prim and the frame pose of the link that carries a mounted camera.

    If the carrier has variants, this is done once for each variant that has this link.
    """
    if any(robot.name == mounted.carrier for robot in scene.robots):
        if (mounted.carrier, mounted.link) in robots.frames:
            yield robots.frames[mounted.carrier, mounted.link]
        return
    item = scene.object(mounted.carrier)
    for one in (item, *item.variants):
        links = content_prim(scopes, one).children
        name = mounted.link or one.root.name
        if name in links:
            yield links[name], Pose.of()
