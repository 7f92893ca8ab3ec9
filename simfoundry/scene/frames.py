"""Named reference frames, and the views that define left, right, front and behind."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from simfoundry.geometry.frames import IDENTITY, Pose, look_at, quat_from_rpy
from simfoundry.scene.carriers import Carrier, PlaceError
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import SceneObject
from simfoundry.scene.state import pose
from simfoundry.spec.models.base import CameraPose
from simfoundry.spec.models.reuse import ReferenceFrame, frame_carrier, frame_chain
from simfoundry.spec.models.scene import SceneSpec

Placed = Mapping[str, SceneObject]

# No objects, for frames that do not move with one.
NOTHING: Placed = MappingProxyType({})


class FrameTree:
    """The frames to which poses and places in a scene can refer: named frames, objects and links."""

    def __init__(self, spec: SceneSpec | None = None) -> None:
        self._spec = spec
        self._frames: Mapping[str, ReferenceFrame] = spec.frames if spec is not None else {}

    def carrier(self, reference: str | None) -> str | None:
        """Return the object that a frame moves with, or None if the frame does not move."""
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
        chain = frame_chain(self._frames, reference)
        if not chain:
            return IDENTITY if reference is None else self._object_pose(reference, placed)
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

    def viewer(self, name: str | None, placed: Placed = NOTHING) -> Pose | None:
        """Return the frame that defines left, right, front and behind, or None for the world frame.

        In this frame, x points away from the viewer, and y points to the viewer's left. If the viewer is a robot or a
        camera mounted on one, the viewer looks along the x axis of the robot's base.

        Args:
            name: A camera, a robot or a named frame.
            placed: The objects that are already placed.
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

    def camera_pose(self, spec: CameraPose, placed: Placed = NOTHING) -> Pose:
        """Return the pose X_WC of a camera, or its pose in the frame that it is mounted on."""
        if spec.look_at is not None:
            X_FC = look_at(np.array(spec.xyz), np.array(spec.look_at))
        else:
            X_FC = Pose.of(spec.xyz, spec.quat_wxyz or (1.0, 0.0, 0.0, 0.0))
        return self.pose(spec.frame, placed) @ X_FC

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
