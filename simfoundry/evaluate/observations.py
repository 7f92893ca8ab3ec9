"""Observations as arrays, for the entries in :mod:`simfoundry.spec.models.signals`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.actions import normalized
from simfoundry.evaluate.policies.base import ImageSize, InvalidAnswerError, RobotReading
from simfoundry.evaluate.rollouts.control import camera_images, readings
from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.model import JointType
from simfoundry.scene.state import SceneState
from simfoundry.spec.diagnostics import nearest
from simfoundry.spec.models.signals import OBSERVATIONS, ImageKind, Signal
from simfoundry.worlds.base import World, WorldRobot

Observations = dict[str, NDArray[Any]]
# Images by kind and camera.
Images = Mapping[ImageKind, Mapping[str, NDArray[Any]]]


class ObservationLayout:
    """The arrays that are observed in a world, each with its shape, type and limits.

    Attributes:
        limits: The smallest and the largest value of each array, keyed by entry, as arrays of its shape.
    """

    def __init__(
        self,
        world: World,
        robots: Iterable[str],
        cameras: Mapping[str, ImageSize],
        kinds: Iterable[ImageKind] = (ImageKind.COLOR,),
        normalize: bool = False,
    ) -> None:
        """Prepare to observe a world.

        Args:
            world: The world.
            robots: The names of the robots that act.
            cameras: The image sizes, keyed by camera.
            kinds: The kinds of images of each camera.
            normalize: If true, the positions of joints and grippers are mapped from their limits to the range -1 to 1.
                Poses, which are in meters and quaternions, do not change.
        """
        self._world, self._cameras, self._kinds, self._normalize = world, cameras, tuple(kinds), normalize
        self._robots: dict[str, WorldRobot] = {name: world.robot(name) for name in robots}
        self._ranges = self._measured_ranges()
        self.limits = self._shown_limits()

    def read(self, state: SceneState) -> Observations:
        """Return the true observation. ``state`` is the current state of the world."""
        images = camera_images(self._world, self._cameras, self._kinds)
        return self.arrays(readings(self._world, self._robots), state, images)

    def arrays(self, robots: Mapping[str, RobotReading], state: SceneState, images: Images) -> Observations:
        """Return an observation that was made in the world as arrays."""
        found: dict[str, Array] = {}
        for name, reading in robots.items():
            found[f"{name}/joints"] = np.array(reading.joints)
            found[f"{name}/gripper"] = np.array([reading.gripper])
            found[f"{name}/hand"] = pose_numbers(reading.X_WH)
        found["objects"] = np.array([pose_numbers(pose) for pose in state.poses.values()]).reshape(-1, 7)
        found["joints"] = np.array(list(state.joints.values()), dtype=np.float64)
        if self._normalize:
            found |= {key: normalized(found[key], limits) for key, limits in self._ranges.items()}
        arrays: Observations = {key: value.astype(signal_of(key).dtype) for key, value in found.items()}
        for kind, by_camera in images.items():
            arrays |= {f"{kind}/{name}": image for name, image in by_camera.items()}
        return arrays

    def _measured_ranges(self) -> dict[str, Array]:
        """Return the limits of each entry that can be normalized, as arrays of shape (values, 2)."""
        ranges: dict[str, Array] = {}
        for name, robot in self._robots.items():
            ranges[f"{name}/joints"] = np.array(list(robot.limits().values())).reshape(-1, 2)
            ranges[f"{name}/gripper"] = np.array([[0.0, 1.0]])
        joints = [joint for item in self._world.scene.objects for joint in item.joints if joint.has_axis]
        endless = {JointType.PRISMATIC: 1.0}
        spans = [joint.limits or (-(m := endless.get(joint.type, math.pi)), m) for joint in joints]
        return ranges | {"joints": np.array(spans).reshape(-1, 2)}

    def _shown_limits(self) -> dict[str, tuple[NDArray[Any], NDArray[Any]]]:
        limits: dict[str, tuple[NDArray[Any], NDArray[Any]]] = {}
        for key, value in self.read(self._world.state()).items():
            if value.dtype == np.uint8:
                low, high = 0.0, 255.0
            elif value.dtype == np.int32:
                low, high = 0.0, float(np.iinfo(np.int32).max)
            elif key.startswith(f"{ImageKind.DEPTH}/"):
                low, high = 0.0, math.inf
            elif key.endswith("/gripper"):
                low, high = (-1.0 if self._normalize else 0.0), 1.0
            else:  # engines exceed joint limits slightly, so positions have no limits
                low, high = -math.inf, math.inf
            limits[key] = np.full(value.shape, low, value.dtype), np.full(value.shape, high, value.dtype)
        return limits


def pose_numbers(pose: Pose) -> Array:
    """Return the position [m] and wxyz quaternion of a pose, as an array of shape (7,)."""
    return np.concatenate([pose.p, pose.q])


def signal_of(key: str) -> Signal:
    """Return the definition of an entry such as ``arm/joints`` or ``depth/wrist``.

    Raises:
        SimfoundryError: If there is no such entry.
    """
    head, _, tail = key.partition("/")
    for name in (key, f"{head}/CAMERA", f"ROBOT/{tail}"):
        if name in OBSERVATIONS:
            return OBSERVATIONS[name]
    raise SimfoundryError(f"no observation is called `{key}`; {nearest(key, OBSERVATIONS)}")


def checked_observation(key: str, value: object, shape: tuple[int, ...]) -> NDArray[Any]:
    """Validate an array for an entry, such as one that was read from a file.

    Raises:
        InvalidAnswerError: If the type, the shape or a value is invalid. The message names the entry.
    """
    signal = signal_of(key)
    if not isinstance(value, np.ndarray) or value.dtype != np.dtype(signal.dtype):
        what = f"not of `{value.dtype}`" if isinstance(value, np.ndarray) else f"but it is a `{type(value).__name__}`"
        raise InvalidAnswerError(f"observation `{key}` must be an array of `{signal.dtype}`, {what}")
    if value.shape != shape:
        raise InvalidAnswerError(f"observation `{key}` must have shape {shape}; got {value.shape}")
    if value.dtype.kind == "f" and not np.isfinite(value).all():
        place = np.argwhere(~np.isfinite(value))[0].tolist()
        raise InvalidAnswerError(f"observation `{key}` must be finite; number {place} is {value[tuple(place)]}")
    return value


def image_kinds(kinds: Iterable[object], who: str) -> tuple[ImageKind, ...]:
    """Return kinds of images from their names.

    Raises:
        SimfoundryError: If a kind is unknown.
    """
    words = (kinds,) if isinstance(kinds, str) else tuple(map(str, kinds))
    for word in words:
        if word not in list(ImageKind):
            raise SimfoundryError(f"{who} requests images of kind `{word[:40]}`; {nearest(word, ImageKind)}")
    return tuple(ImageKind(word) for word in dict.fromkeys(words))
