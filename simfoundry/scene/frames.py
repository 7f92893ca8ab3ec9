"""Named reference frames, and the views that define left, right, front and behind."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from simfoundry.geometry.frames import IDENTITY, Array, Pose, look_at, quat_from_rpy
from simfoundry.scene.carriers import Carrier, PlaceError
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import SceneObject
from simfoundry.scene.object_shapes import link_bounds
from simfoundry.scene.state import pose
from simfoundry.spec.models.base import CameraPose
from simfoundry.spec.models.reuse import ReferenceFrame, frame_carrier, frame_chain
from simfoundry.spec.models.scene import SceneSpec

Placed = Mapping[str, SceneObject]

# Minimum distance [m] between a camera and its target, below which the viewing direction is rounding error.
CLOSEST = 1e-6

# No objects, for frames that do not move with one.
NOTHING: Placed = MappingProxyType({})


class FrameTree:
    """The frames to which poses and places in a scene can refer: named frames, objects and links."""

    def __init__(self, spec: SceneSpec | None = None) -> None:
        self._spec = spec
        self._frames: Mapping[str, ReferenceFrame] = spec.frames if spec is not None else {}

    def carrier(self, reference: str | None) -> str | None:
        """Return the object that a frame moves with, or None if the frame does not move."""
        if reference is None:
            return None
        carrier = frame_carrier(self._frames, reference)
        return carrier.partition(".")[0] if carrier is not None else None

    def pose(self, reference: str | None, placed: Placed = NOTHING) -> Pose:
        """Return the pose X_WF of a frame; None is the world frame.

        Args:
            reference: A named frame, an object, or a link such as `shelf.board`.
            placed: The objects that are already placed.

        Raises:
            PlaceError: If the frame moves with an object that is not placed yet, or depends on itself.
        """
        if reference is None:
            return IDENTITY
        chain = frame_chain(self._frames, reference)
        if not chain:
            return self._object_pose(reference, placed)
        X_WF, base = IDENTITY, self._frames[chain[-1]]
        if base.frame in chain:
            raise PlaceError(f"the frame `{reference}` depends on itself", "attach it to the world or to an object")
        if base.on is not None:
            X_WF = Carrier.of(base.on, placed).top()
        elif base.frame is not None:
            X_WF = self._object_pose(base.frame, placed)
        for name in reversed(chain):
            X_WF = X_WF @ pose(self._frames[name])
        return X_WF

    def viewer_needs(self, name: str | None) -> list[str]:
        """Return the objects whose poses must be known before the view of a camera, robot or frame is known."""
        if self._spec is None or name is None:
            return []
        seen = self._spec.cameras.get(name)
        if seen is None or seen.mount is not None:
            carrier = self.carrier(name) if name in self._frames else None
            return [carrier] if carrier is not None else []
        carrier = self.carrier(seen.pose.frame)
        found = [carrier] if carrier is not None else []
        target = seen.pose.look_at
        if isinstance(target, str) and target.partition(".")[0] in self._spec.objects:
            found.append(target.partition(".")[0])
        return found

    def viewer(self, name: str | None, placed: Placed = NOTHING) -> Pose | None:
        """Return the frame that defines left, right, front and behind, or None for the world frame.

        In this frame, x points away from the viewer, and y points to the viewer's left. If the viewer is a robot or a
        camera mounted on one, the viewer looks along the x axis of the robot's base.

        Args:
            name: A camera, a robot or a named frame.
            placed: The objects that are already placed, including :meth:`viewer_needs`.

        Raises:
            PlaceError: If a frame cannot be resolved.
        """
        spec = self._spec
        if spec is None or name is None:
            return None
        seen = spec.cameras.get(name)
        if seen is not None and seen.mount is None:
            return seen_by_camera(self.camera_pose(seen.pose, placed))
        robot = spec.robots.get(name if seen is None else (seen.mount or "").partition(".")[0])
        if robot is not None:
            return self.pose(robot.pose.frame) @ pose(robot.pose)
        return self.pose(name, placed) if name in self._frames else None

    def camera_pose(self, spec: CameraPose, placed: Placed = NOTHING, X_WM: Pose = IDENTITY) -> Pose:
        """Return the pose X_WC of a camera. For a mounted camera, return its pose X_MC in the frame of its mount.

        Args:
            spec: The pose in the document.
            placed: The objects that are already placed.
            X_WM: Pose of the mount, for a camera that is mounted.

        Raises:
            PlaceError: If the frame cannot be resolved, or if the camera is at the position of its target.
        """
        X_WF = self.pose(spec.frame, placed)
        aim = spec.look_at
        if isinstance(aim, str):
            point = (X_WM @ X_WF).inverse().apply(self.target(aim, placed))
            if np.linalg.norm(point - spec.xyz) < CLOSEST:
                message = f"the camera is at the center of `{aim}`, so it cannot look at it"
                raise PlaceError(message, "move the camera, or look at a point")
            return X_WF @ look_at(np.array(spec.xyz), point)
        if aim is not None:
            return X_WF @ look_at(np.array(spec.xyz), np.array(aim))
        return X_WF @ Pose.of(spec.xyz, spec.quat_wxyz or (1.0, 0.0, 0.0, 0.0))

    def target(self, name: str, placed: Placed) -> Array:
        """Return the point in the world that a camera with the target ``name`` looks at [m], shape (3,).

        For an object or one of its links, this is the center of its bounding box, which is aligned with the world axes.
        For a robot, this is the origin of its base.
        """
        owner, _, part = name.partition(".")
        item = placed.get(owner)
        if item is None:
            robot = self._spec.robots.get(owner) if self._spec is not None else None
            if robot is None:
                raise PlaceError(f"`{owner}` is not placed itself", "look at a point instead")
            return (self.pose(robot.pose.frame) @ pose(robot.pose)).p
        spans = link_bounds(item, part)
        if not spans:
            return item.X_WO.p
        low, high = np.min([low for low, _ in spans], axis=0), np.max([high for _, high in spans], axis=0)
        return np.asarray((low + high) / 2)

    def _object_pose(self, reference: str, placed: Placed) -> Pose:
        owner, _, link = reference.partition(".")
        if owner not in placed:
            raise PlaceError(f"`{owner}` is not placed itself", f"place `{owner}` without depending on this frame")
        item = placed[owner]
        poses = link_poses(item)
        if link and link not in poses:
            raise PlaceError(f"`{owner}` has no link `{link}`", f"available links: {', '.join(poses)}")
        return item.X_WO @ poses[link] if link else item.X_WO


def seen_by_camera(X_WC: Pose) -> Pose:
    """Return the frame of a viewer looking through a camera, with x pointing away from the viewer and y to the left.

    If the camera looks straight down, x is the up direction of the image.
    """
    forward, up = X_WC.rotation[:, 2], -X_WC.rotation[:, 1]
    x, y = forward[:2] if math.hypot(*forward[:2]) > 1e-6 else up[:2]
    return Pose.of(X_WC.p, quat_from_rpy(0.0, 0.0, math.atan2(y, x)))
