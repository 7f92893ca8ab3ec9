"""Robots as URDF: their own URDF copied with its meshes, or a conversion from their MJCF."""

from __future__ import annotations

import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from simfoundry.backends.losses import Loss, approximate, drop
from simfoundry.backends.robot_models.mujoco_robot import RobotModelError, read_robot
from simfoundry.backends.robot_models.robot_object import as_object
from simfoundry.geometry.frames import Pose
from simfoundry.scene.model import Mimic, SceneObject
from simfoundry.scene.robot import LinkFrame, ModelFormat, NativeModel, Robot
from simfoundry.scene.robot_files import model_files, urdf_mesh, urdf_meshes

Write = Callable[[SceneObject], Mapping[str, bytes]]
"""Function that writes an object as ``<name>.urdf`` and returns it with its assets."""

CONVERTED = "A robot's own model in this format is used unchanged; any other is converted, with hulls and cut loops."
"""Reason shown in the feature tables of every format except MuJoCo's."""

_MOVING = ("revolute", "continuous", "prismatic")
_STRONG = 100.0
"""Maximum force [N m or N] of a joint whose URDF does not state one."""


@dataclass(frozen=True, eq=False)
class RobotUrdf:
    """A robot's URDF at ``path`` among its ``files``, with its root link at ``X_WB``.

    ``positions`` [rad or m], ``efforts`` [N m or N] and ``follow`` are keyed by the URDF's joints. So are the
    ``servos`` whose gains are known: stiffness [N m/rad or N/m], and damping including that of the joint itself.
    ``joints`` maps the scene's joint names to the URDF's, ``frames`` maps the scene's frames to its links. ``item`` is
    the object from which the URDF was converted, if any.
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


def robot_urdf(robot: Robot, write: Write) -> RobotUrdf | None:
    """Return the robot as URDF; None if it has neither URDF nor MJCF. Raises :class:`RobotModelError`."""
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
            there = ", ".join(names)
            raise RobotModelError(f"robot `{robot.name}`: {native.file.name} has no joint `{name}`; there are: {there}")
    follow = dict(_mimics(moving)) | (dict(native.gripper.follow) if native.gripper is not None else {})
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
    )


def _mimics(joints: list[ET.Element]) -> Iterator[tuple[str, Mimic]]:
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
    """Copy a URDF and its meshes below ``robots/``, preserving their relative layout; also return the URDF's path.

    Mesh paths in the URDF become relative to it; the rest of the text is unchanged.
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
    moving = {joint.name: joint.position for joint in made.item.joints if joint.name in made.joints.values()}
    arm = native.joints or {name: name for name in made.joints}
    return RobotUrdf(
        path=f"{robot.name}.urdf",
        files=write(made.item),
        X_WB=made.item.X_WO,
        positions=moving,
        efforts={j.name: j.drive.force_limit or _STRONG for j in made.item.joints if j.drive is not None},
        joints={name: made.joints[joint] for name, joint in arm.items()},
        gripper={made.joints[name]: pair for name, pair in gripper.items()},
        follow={j.name: j.mimic for j in made.item.joints if j.mimic is not None},
        servos={
            j.name: (j.drive.stiffness, j.drive.damping + j.damping)
            for j in made.item.joints
            if j.drive is not None and j.drive.stiffness > 0
        },
        frames=frames,
        item=made.item,
        losses=tuple(conversion_losses(robot, native, made.loops)),
    )


def conversion_losses(robot: Robot, source: NativeModel, loops: int) -> Iterator[Loss]:
    """Yield the losses of a robot that is converted from its MJCF or URDF."""
    kind = source.format.value.upper()
    reason = f"It has no model in this format; it is converted from its {kind}, with convex hulls as colliders."
    yield approximate("robots", robot.name, reason)
    if loops:
        words = f"{loops} closed loops are" if loops > 1 else "1 closed loop is"
        reason = f"{words} cut; mimic joints with fixed ratios replace them."
        yield approximate("robots", robot.name, reason, loops, "loops")


def without_model(name: str) -> Loss:
    """Return the loss of a robot that has neither an MJCF nor a URDF."""
    return drop("robots", name, "It has no model in MJCF or URDF, and its USD cannot be converted.")
