"""Noise of actions and observations, which depends only on the seed of the rollout.

The noise of an observation also depends on its time and on the name of its entry. Another number of observations, other
cameras, or another entry with noise therefore change no noise, and a recording replays to the last bit.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.evaluate.actions import rotation_quat
from simfoundry.evaluate.policies.base import Image, RobotReading
from simfoundry.geometry.frames import Array, Pose, frozen_array
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.disturbances import ActionDisturbances, ObservationDisturbances
from simfoundry.spec.models.signals import RotationForm

# Seed of the noise in a rollout: the seed of the initial states, and the index of the initial state.
NoiseSeed = tuple[int, int]


def random_stream(seed: NoiseSeed, *parts: object) -> np.random.Generator:
    """Return the generator that belongs to a seed and a name."""
    text = "/".join(map(str, (*seed, *parts)))
    return np.random.default_rng(int.from_bytes(hashlib.sha256(text.encode()).digest()[:16], "big"))


class ActionNoise:
    """The errors of joint and gripper targets, which are drawn for each action in the order of execution."""

    def __init__(self, disturbances: ActionDisturbances, seed: NoiseSeed) -> None:
        self._about, self._random = disturbances, random_stream(seed, "action")

    def draw(self, joints: Mapping[str, int]) -> dict[str, tuple[Array, float]]:
        """Draw the errors of an action.

        Args:
            joints: The number of arm joints of each robot.

        Returns:
            For each robot, the errors of its joint targets [rad or m], shape (joints,), and of its gripper's target.
        """
        found = {}
        for name, count in joints.items():
            errors = self._random.standard_normal(count + 1)  # always all, so that noises do not affect each other
            found[name] = errors[:count] * self._about.joint_noise, float(errors[count]) * self._about.gripper_noise
        return found


@dataclass(frozen=True)
class SensorNoise:
    """The noise of observations in a rollout."""

    about: ObservationDisturbances
    seed: NoiseSeed

    def _random(self, step: int, *name: str) -> np.random.Generator:
        """Return the generator for an entry that is observed at a physics step."""
        return random_stream(self.seed, "observation", *name, step)

    def readings(
        self, robots: Mapping[str, RobotReading], bases: Mapping[str, Pose], step: int
    ) -> dict[str, RobotReading]:
        """Return the readings of robots whose bases have the poses X_WB."""
        about, found = self.about, {}
        for name, reading in robots.items():
            joints, gripper, X_WH, X_BH = reading.joints, reading.gripper, reading.X_WH, reading.X_BH
            if about.joint_noise:
                errors = self._random(step, "joints", name).standard_normal(len(joints))
                joints = frozen_array(joints + about.joint_noise * errors)
            if about.gripper_noise:
                error = about.gripper_noise * float(self._random(step, "gripper", name).standard_normal())
                gripper = min(max(gripper + error, 0.0), 1.0)
            if about.hand_noise or about.hand_noise_deg:
                random = self._random(step, "hand", name)
                X_WH = _disturbed(X_WH, about.hand_noise, about.hand_noise_deg, random)
                X_BH = bases[name].inverse() @ X_WH
            found[name] = RobotReading(joints, gripper, X_WH, X_BH)
        return found

    def state(self, state: SceneState, step: int) -> SceneState:
        """Return the poses and joint positions of objects as they are observed."""
        about, poses, joints = self.about, dict(state.poses), dict(state.joints)
        if not (about.object_noise or about.object_noise_deg or about.object_joint_noise):
            return state
        if about.object_noise or about.object_noise_deg:
            for name, X_WO in poses.items():
                random = self._random(step, "object", name)
                poses[name] = _disturbed(X_WO, about.object_noise, about.object_noise_deg, random)
        if about.object_joint_noise:
            for name, position in joints.items():
                error = float(self._random(step, "object joint", name).standard_normal())
                joints[name] = position + about.object_joint_noise * error
        return SceneState.of(poses, joints, state.motions, state.robots, state.speeds)

    def image(self, image: Image, camera: str, step: int) -> Image:
        """Return a color image with the exposure and the noise of its camera."""
        about = self.about
        stops = about.exposure
        if about.exposure_noise:
            drawn = random_stream(self.seed, "exposure", camera).standard_normal()
            stops += about.exposure_noise * float(drawn)
        if stops:
            image = _exposure_table(stops)[image]
        if about.image_noise:
            errors = self._random(step, "image", camera).standard_normal(image.shape, dtype=np.float32)
            noisy = image + np.float32(255.0 * about.image_noise) * errors
            image = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        return image

    def depth(self, depth: NDArray[np.float32], camera: str, step: int) -> NDArray[np.float32]:
        """Return a depth image [m] with the noise of its camera; 0 where nothing is measured."""
        about, random = self.about, self._random(step, "depth", camera)
        errors = random.standard_normal(depth.shape, dtype=np.float32)
        noisy = depth + np.float32(about.depth_noise) * np.square(depth) * errors
        lost = random.random(depth.shape, dtype=np.float32) < about.depth_dropout
        return np.where((depth > 0) & (noisy > 0) & ~lost, noisy, np.float32(0.0))


def _disturbed(pose: Pose, position: float, rotation_deg: float, random: np.random.Generator) -> Pose:
    """Return a pose with errors of its position [m] along each axis and its rotation [deg] about each axis."""
    errors = random.standard_normal(6)
    turn = rotation_quat(math.radians(rotation_deg) * errors[3:], RotationForm.ROTVEC)
    return Pose.of(pose.p + position * errors[:3], (Pose.of(q=turn) @ Pose.of(q=pose.q)).q if rotation_deg else pose.q)


def _exposure_table(stops: float) -> NDArray[np.uint8]:
    """Return the sRGB value [0, 255] of each sRGB value if ``stops`` more light reaches the sensor, shape (256,)."""
    srgb = np.arange(256) / 255
    # The transfer function of IEC 61966-2-1: noise and exposure act on light, and images store encoded light.
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    light = np.clip(linear * 2.0**stops, 0, 1)
    encoded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * encoded), dtype=np.uint8)
