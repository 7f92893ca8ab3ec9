"""Observations of a remote policy: pictures and the robots' state, by the policy's own keys."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from simfoundry.evaluate.policies.base import Image, ImageSize, Observation, PolicyError, RobotReading
from simfoundry.geometry.frames import Array, Pose
from simfoundry.spec.models.policy import GripperConvention, PolicySpec


def cameras_of(spec: PolicySpec) -> dict[str, ImageSize]:
    """The cameras of the scene that a policy sees through, with the size in which each is rendered.

    Where two keys show one camera in two sizes, the larger is rendered.
    """
    found: dict[str, ImageSize] = {}
    for view in spec.cameras.values():
        size = ImageSize(*(view.render or view.size))
        known = found.get(view.camera)
        if known is None or known.width * known.height < size.width * size.height:
            found[view.camera] = size
    return found


def pictures(spec: PolicySpec, observation: Observation) -> dict[str, Image]:
    """Each picture by the policy's key; raises :class:`PolicyError` where one is missing, never takes another."""
    found: dict[str, Image] = {}
    for key, view in spec.cameras.items():
        image = observation.images.get(view.camera)
        if image is None:
            known = ", ".join(f"`{name}`" for name in observation.images) or "none"
            message = f"no picture of the camera `{view.camera}`, which {spec.name} takes as `{key}`"
            raise PolicyError(f"{message}; there are: {known}")
        found[key] = resize_with_pad(image, ImageSize(*view.size))
    return found


def reading(what: str, robots: Mapping[str, RobotReading], gripper: GripperConvention) -> Array:
    """One of the robots' senses as numbers, of all robots in order: see ``state`` of a policy document."""
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
    """The robots' senses by the policy's keys, float32 as DROID records them."""
    wanted = default if spec.state is None else spec.state
    return {key: reading(what, observation.robots, spec.gripper).astype(np.float32) for key, what in wanted.items()}


def roll_pitch_yaw(pose: Pose) -> Array:
    """The rotation as turns about fixed x, y, z [rad]: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    r = pose.rotation
    level = math.hypot(r[0, 0], r[1, 0])
    pitch = math.atan2(-r[2, 0], level)
    if level < 1e-9:  # looking straight up or down: the whole turn counts as roll
        return np.array([math.atan2(-r[1, 2], r[1, 1]), pitch, 0.0])
    return np.array([math.atan2(r[2, 1], r[2, 2]), pitch, math.atan2(r[1, 0], r[0, 0])])


DROID_CAMERAS = {"exterior": "exterior_left", "exterior_2": "exterior_right", "wrist": "wrist"}
"""The cameras of the DROID cell (``specs/scenes/droid.scene.yaml``), which the short form of a policy takes."""


def droid_cameras(
    keys: Mapping[str, str], size: tuple[int, int], render: tuple[int, int]
) -> dict[str, dict[str, object]]:
    """Return the pictures that the policies of DROID take; ``keys`` are the names that a protocol gives them."""
    return {key: {"camera": DROID_CAMERAS[role], "size": size, "render": render} for key, role in keys.items()}


def resize_with_pad(image: Image, size: ImageSize) -> Image:
    """A picture, shape (h, w, 3), fitted into ``size`` and centred in black, shape (size.height, size.width, 3).

    Bilinear with Pillow's filter, which averages where it shrinks; sides are rounded down. The same pixels as
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
