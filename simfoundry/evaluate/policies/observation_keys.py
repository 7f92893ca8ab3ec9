"""Observations of a remote policy: images and the robots' state under the policy's own keys."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from simfoundry.evaluate.policies.base import Image, ImageSize, Observation, PolicyError, RobotReading
from simfoundry.geometry.frames import Array, Pose
from simfoundry.spec.models.policy import GripperConvention, PolicySpec


def cameras_of(spec: PolicySpec) -> dict[str, ImageSize]:
    """Return the scene's cameras that a policy uses, with the size at which each is rendered.

    If two keys show one camera in two sizes, the larger is rendered.
    """
    found: dict[str, ImageSize] = {}
    for view in spec.cameras.values():
        size = ImageSize(*(view.render or view.size))
        known = found.get(view.camera)
        if known is None or known.width * known.height < size.width * size.height:
            found[view.camera] = size
    return found


def pictures(spec: PolicySpec, observation: Observation) -> dict[str, Image]:
    """Return each image under the policy's key; raises :class:`PolicyError` if a camera's image is missing."""
    found: dict[str, Image] = {}
    for key, view in spec.cameras.items():
        image = observation.images.get(view.camera)
        if image is None:
            known = ", ".join(f"`{name}`" for name in observation.images) or "none"
            message = f"there is no image of the camera `{view.camera}`, which {spec.name} needs as `{key}`"
            raise PolicyError(f"{message}; there are: {known}")
        found[key] = resize_with_pad(image, ImageSize(*view.size))
    return found


def reading(what: str, robots: Mapping[str, RobotReading], gripper: GripperConvention) -> Array:
    """Return one sensor quantity of all robots in order as an array; see ``state`` of a policy document."""
    rows = []
    for robot in robots.values():
        closed = gripper.open + (gripper.closed - gripper.open) * robot.gripper
        match what:
            case "joints":
                rows.append(np.asarray(robot.joints, dtype=np.float64))
            case "gripper":
                rows.append(np.array([closed]))
            case "joints_gripper":
                rows.append(np.append(robot.joints, closed))
            case "hand":
                rows.append(np.concatenate([robot.X_BH.p, roll_pitch_yaw(robot.X_BH)]))
            case _:
                raise KeyError(what)
    return np.concatenate(rows) if rows else np.zeros(0)


def state(spec: PolicySpec, default: Mapping[str, str], observation: Observation) -> dict[str, Any]:
    """Return the robots' state under the policy's keys, float32 as in DROID's recordings."""
    wanted = default if spec.state is None else spec.state
    return {key: reading(what, observation.robots, spec.gripper).astype(np.float32) for key, what in wanted.items()}


def roll_pitch_yaw(pose: Pose) -> Array:
    """Rotation as angles about the fixed axes x, y, z [rad]: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    r = pose.rotation
    level = math.hypot(r[0, 0], r[1, 0])
    pitch = math.atan2(-r[2, 0], level)
    if level < 1e-9:  # gimbal lock: the whole rotation counts as roll
        return np.array([math.atan2(-r[1, 2], r[1, 1]), pitch, 0.0])
    return np.array([math.atan2(r[2, 1], r[2, 2]), pitch, math.atan2(r[1, 0], r[0, 0])])


DROID_CAMERAS = {"exterior": "exterior_left", "exterior_2": "exterior_right", "wrist": "wrist"}
"""Cameras of the DROID cell (``specs/scenes/droid.scene.yaml``), used by the short form of a policy."""


def droid_cameras(
    keys: Mapping[str, str], size: tuple[int, int], render: tuple[int, int]
) -> dict[str, dict[str, object]]:
    """Return the camera views used by DROID's policies; ``keys`` are their names in a protocol."""
    return {key: {"camera": DROID_CAMERAS[role], "size": size, "render": render} for key, role in keys.items()}


def resize_with_pad(image: Image, size: ImageSize) -> Image:
    """Fit an image, shape (h, w, 3), into ``size``, centered on black, shape (size.height, size.width, 3).

    Bilinear with Pillow's filter, which averages when it shrinks; sides are rounded down. Gives the same pixels as
    ``openpi_client.image_tools.resize_with_pad``, on which the policies were trained.
    """
    height, width = image.shape[:2]
    if (height, width) == (size.height, size.width):
        return image
    from PIL import Image as Pictures

    ratio = max(width / size.width, height / size.height)
    inner = max(1, int(width / ratio)), max(1, int(height / ratio))
    small = np.asarray(Pictures.fromarray(np.ascontiguousarray(image)).resize(inner, Pictures.Resampling.BILINEAR))
    top, left = (size.height - inner[1]) // 2, (size.width - inner[0]) // 2
    out = np.zeros((size.height, size.width, 3), dtype=np.uint8)
    out[top : top + inner[1], left : left + inner[0]] = small
    return out
