"""Lower the cameras of a scene, including those that look at an object, a link or a robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from simfoundry.geometry.frames import Array, Pose, look_at
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Camera, LeftOut, MountedCamera, Scene, SceneObject
from simfoundry.scene.object_shapes import link_bounds
from simfoundry.scene.place import seen_by_camera
from simfoundry.scene.state import pose
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.models.scene import CameraSpec, SceneSpec

if TYPE_CHECKING:
    from simfoundry.scene.lower import Lowering

# Minimum distance [m] between a camera and its target, below which the viewing direction is rounding error.
CLOSEST = 1e-6


def lower_cameras(lowering: Lowering, scene: Scene) -> Scene:
    """Lower the cameras, leaving out cameras mounted on a link that does not exist in the selected variant.

    Raises:
        SpecError: If a camera looks at its own position.
    """
    fixed, mounted, lost, findings = [], [], [], []
    robots = {robot.name for robot in scene.robots}
    for name, spec in lowering.spec.cameras.items():
        point = _aim(spec, lowering.spec, scene.by_name)
        if point is not None and np.linalg.norm(point - spec.pose.xyz) < CLOSEST:
            message = f"the camera is at the center of `{spec.pose.look_at}`, so it cannot look at it"
            where = ("cameras", name, "pose", "look_at")
            findings.append(lowering.loaded.finding("SF104", where, message, "move the camera, or look at a point"))
            continue
        if spec.mount is None:
            fixed.append(camera(name, spec, point))
            continue
        carrier, _, link = spec.mount.partition(".")
        item = scene.by_name.get(carrier)
        if item is not None and link and link not in {each.name for each in item.links}:
            reason = f"the variant `{item.variant}` of `{carrier}` has no link `{link}`"
            lost.append(LeftOut(f"cameras.{name}", reason))
        elif item is not None or carrier in robots:
            mounted.append(MountedCamera(carrier, link, camera(name, spec, point)))
    if findings:
        raise SpecError(findings)
    return replace(scene, cameras=tuple(fixed), mounted=tuple(mounted), left_out=(*scene.left_out, *lost))


def camera(name: str, spec: CameraSpec, point: Array | None = None) -> Camera:
    """Return a camera whose intrinsics and pose are resolved.

    ``point`` [m], shape (3,), is the position of the target if the camera looks at a name.
    """
    width, height = spec.size
    cx = (width - 1) / 2 if spec.cx is None else spec.cx
    cy = (height - 1) / 2 if spec.cy is None else spec.cy
    aim = np.array(spec.pose.look_at) if isinstance(spec.pose.look_at, tuple) else point
    if aim is not None:
        X_WC = look_at(np.array(spec.pose.xyz), aim)
    else:
        X_WC = Pose.of(spec.pose.xyz, spec.pose.quat_wxyz or (1.0, 0.0, 0.0, 0.0))
    return Camera(name, width, height, *spec.focal_lengths, cx, cy, X_WC)


def _aim(spec: CameraSpec, scene: SceneSpec, objects: Mapping[str, SceneObject]) -> Array | None:
    """Return the point [m] that a camera looks at by name, in the frame of the camera's pose, or None."""
    name = spec.pose.look_at
    if not isinstance(name, str):
        return None
    point = target_point(name, scene, objects)
    if spec.mount is None:
        return point
    carrier, _, link = spec.mount.partition(".")
    item = objects.get(carrier)
    poses = {} if item is None else link_poses(item)
    if item is None or (link and link not in poses):  # a camera without its mount is left out
        return point
    X_WM = item.X_WO @ poses[link or item.root.name]
    return X_WM.inverse().apply(point)


def target_point(name: str, scene: SceneSpec, objects: Mapping[str, SceneObject]) -> Array:
    """Return the point [m] in the world that a camera with the target ``name`` looks at.

    For an object or one of its links, this is the center of its bounding box, which is aligned with the world axes.
    For a robot, this is the origin of its base.
    """
    owner, _, part = name.partition(".")
    item = objects.get(owner)
    if item is None:
        return pose(scene.robots[owner].pose).p
    spans = link_bounds(item, part)
    if not spans:
        return item.X_WO.p
    low, high = np.min([low for low, _ in spans], axis=0), np.max([high for _, high in spans], axis=0)
    return np.asarray((low + high) / 2)


def viewer_target(spec: SceneSpec) -> str | None:
    """Return the name of the object or link that the viewpoint looks at, whose position is unknown before placement."""
    seen = spec.cameras.get(spec.viewpoint or "")
    name = seen.pose.look_at if seen is not None and seen.mount is None else None
    return name if isinstance(name, str) and name.partition(".")[0] in spec.objects else None


def viewer(spec: SceneSpec, placed: Mapping[str, SceneObject] | None = None) -> Pose | None:
    """Return the frame that defines left, right, front and behind, or None for the world frame.

    In this frame, x points away from the viewer, and y points to the viewer's left. If the viewer is a robot or a
    camera mounted on one, the viewer looks along the x axis of the robot's base. If the viewer is a camera that looks
    at an object, the frame is None until the object is in ``placed``.
    """
    seen = spec.cameras.get(spec.viewpoint or "")
    if seen is not None and seen.mount is None:
        if placed is None and viewer_target(spec) is not None:
            return None
        return seen_by_camera(camera("", seen, _aim(seen, spec, placed or {})).X_WC)
    robot = spec.robots.get(spec.viewpoint or "" if seen is None else (seen.mount or "").partition(".")[0])
    return None if robot is None else pose(robot.pose)
