"""The shared parts of all policies behind servers: observations, response validation, and request statistics."""

from __future__ import annotations

import importlib
import os
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from types import ModuleType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from simfoundry.evaluate.actions import checked_actions, columns, rotation_numbers
from simfoundry.evaluate.policies.base import (
    ImageSize,
    InvalidAnswerError,
    Observation,
    Policy,
    PolicyError,
    RobotReading,
)
from simfoundry.evaluate.policies.codec import Codec, CodecError
from simfoundry.geometry.frames import Array
from simfoundry.runtime.extras import install_line
from simfoundry.spec.models.policy import PROTOCOLS, GripperConvention, PolicySpec, address_uri
from simfoundry.spec.models.signals import HAND_READINGS, HandFrame, ImageKind


def needed(module: str, what: str, install: str = f"install with `{install_line('policies')}`") -> ModuleType:
    """Import an optional module.

    Raises:
        PolicyError: If the module is missing. The message contains the install command.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        absent = getattr(error, "name", None) or module
        raise PolicyError(f"{what} needs the package `{absent.partition('.')[0]}`; {install}") from None


# Maximum number of error messages to keep; any others are only counted, so that reports stay short.
KEPT = 100


@dataclass
class PolicyRecord:
    """The number of requests to a policy, their response times and their errors, accumulated over rollouts.

    ``seconds`` contains the time from each request to its response [s], including reconnections and repeated requests.
    """

    questions: int = 0
    connections: int = 0
    reconnects: int = 0
    failures: int = 0
    errors: list[str] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    def failed(self, sentence: str) -> None:
        """Record an error."""
        self.failures += 1
        if len(self.errors) < KEPT:
            self.errors.append(sentence)

    def to_json(self) -> Mapping[str, Any]:
        """Return counts, messages, and the median and maximum response times [s] for a report."""
        ordered = sorted(self.seconds)
        counts = {key: value for key, value in asdict(self).items() if key != "seconds"}
        median, longest = (ordered[len(ordered) // 2], ordered[-1]) if ordered else (None, None)
        return counts | {"median_s": median, "longest_s": longest}


def cameras_of(spec: PolicySpec) -> dict[str, ImageSize]:
    """Return the cameras in the scene that a policy uses, with the size at which each camera is rendered.

    If two keys request different sizes from the same camera, the larger size is used.
    """
    sizes = [(view.camera, ImageSize(*(view.render or view.size))) for view in spec.cameras.values()]
    cameras = dict.fromkeys(camera for camera, _ in sizes)
    return {c: max((s for name, s in sizes if name == c), key=lambda s: s.width * s.height) for c in cameras}


def pictures(spec: PolicySpec, observation: Observation) -> dict[str, NDArray[Any]]:
    """Return the images under the policy's keys.

    Raises:
        PolicyError: If the image of a camera is missing.
    """
    found: dict[str, NDArray[Any]] = {}
    kinds: Mapping[ImageKind, Mapping[str, NDArray[Any]]] = {
        ImageKind.COLOR: observation.images,
        ImageKind.DEPTH: observation.depths,
        ImageKind.MASK: observation.masks,
    }
    for key, view in spec.cameras.items():
        image: NDArray[Any] | None = kinds[ImageKind(view.kind)].get(view.camera)
        if image is None:
            known = ", ".join(f"`{name}`" for name in observation.images) or "none"
            message = f"{spec.name} needs an image from camera `{view.camera}` as `{key}`, but it was not rendered"
            raise PolicyError(f"{message}; available images: {known}")
        found[key] = resize_with_pad(image, ImageSize(*view.size))
    return found


def reading(what: str, robots: Mapping[str, RobotReading], gripper: GripperConvention) -> Array:
    """Return one sensor quantity of all robots in order, as an array.

    The quantities are described under ``state`` in the documentation of policy documents.
    """
    rows: list[Any] = [np.zeros(0)]
    for robot in robots.values():
        closed = gripper.open + (gripper.closed - gripper.open) * robot.gripper
        known = {"joints": robot.joints, "gripper": [closed], "joints_gripper": [*robot.joints, closed]}
        rows.append(known[what] if what in known else hand_numbers(robot, what))
    return np.concatenate(rows)


def hand_numbers(robot: RobotReading, what: str) -> Array:
    """Return a hand pose as position [m] and rotation, for a name in :data:`HAND_READINGS`."""
    frame, form = HAND_READINGS[what]
    pose = robot.X_WH if frame is HandFrame.WORLD else robot.X_BH
    return np.concatenate([pose.p, rotation_numbers(pose.q, form)])


def state(spec: PolicySpec, default: Mapping[str, str], observation: Observation) -> dict[str, Any]:
    """Return the state of the robots under the policy's keys, in float32 as in DROID's recordings."""
    wanted = default if spec.state is None else spec.state
    return {key: reading(what, observation.robots, spec.gripper).astype(np.float32) for key, what in wanted.items()}


# Cameras of the DROID cell (``specs/scenes/droid.scene.yaml``), used by servers in short form.
DROID_CAMERAS = {"exterior": "exterior_left", "exterior_2": "exterior_right", "wrist": "wrist"}


def droid_cameras(
    keys: Mapping[str, str], size: tuple[int, int], render: tuple[int, int]
) -> dict[str, dict[str, object]]:
    """Return the camera views that are used by DROID's policies.

    Args:
        keys: The role of the camera for each key in the protocol.
        size: The width and height of the image that is sent [px].
        render: The width and height at which the camera is rendered [px].
    """
    return {key: {"camera": DROID_CAMERAS[role], "size": size, "render": render} for key, role in keys.items()}


def resize_with_pad(image: NDArray[Any], size: ImageSize) -> NDArray[Any]:
    """Resize an image to fit into ``size``, and center it on a black background.

    Side lengths are rounded down. For color images, Pillow's bilinear filter is used, which averages pixels when it
    shrinks an image; depths and masks take the value of the nearest pixel. The result of a color image is identical,
    pixel for pixel, to that of ``openpi_client.image_tools.resize_with_pad``, which was used to train the policies.

    Args:
        image: The image, shape (h, w, 3), or the depths or mask, shape (h, w).
        size: The size of the result.

    Returns:
        The resized image, as an array of shape (size.height, size.width) or (size.height, size.width, 3).
    """
    height, width = image.shape[:2]
    if (height, width) == (size.height, size.width):
        return image
    from PIL import Image as Pictures

    ratio = max(width / size.width, height / size.height)
    inner = max(1, int(width / ratio)), max(1, int(height / ratio))
    filtering = Pictures.Resampling.BILINEAR if image.ndim == 3 else Pictures.Resampling.NEAREST
    small = np.asarray(Pictures.fromarray(np.ascontiguousarray(image)).resize(inner, filtering))
    top, left = (size.height - inner[1]) // 2, (size.width - inner[0]) // 2
    out = np.zeros((size.height, size.width, *image.shape[2:]), dtype=image.dtype)
    out[top : top + inner[1], left : left + inner[0]] = small
    return out


def actions_of(spec: PolicySpec, answer: Any, robots: Mapping[str, RobotReading]) -> Array:
    """Validate an untrusted response and return its first ``horizon`` actions.

    Returns:
        Array of shape (horizon, action size) in the policy's action space. Gripper values range from 0 (open) to 1
        (closed), or from -1 to 1 if actions are normalized.

    Raises:
        InvalidAnswerError: If the response is not an array of at least ``horizon`` actions.
    """
    if not isinstance(answer, np.ndarray):
        raise InvalidAnswerError(f"{spec.name} returned a `{type(answer).__name__}` instead of an array of actions")
    if answer.dtype.kind not in "fiu":
        raise InvalidAnswerError(f"{spec.name} returned an array of `{answer.dtype}`, not of numbers")
    space = spec.space
    out = checked_actions(answer, robots, space, f"the actions of {spec.name}")[: spec.horizon]
    if len(out) < spec.horizon:
        message = f"{spec.name} returned {len(out)} actions, but its `horizon` is {spec.horizon}"
        raise InvalidAnswerError(f"{message}; lower `horizon` to {len(out)}")
    for _, arm, gripper in columns(robots, space):
        if spec.velocity_unit is not None:
            out[:, arm] = np.clip(out[:, arm], -1, 1) * spec.velocity_unit
        out[:, gripper] = gripper_of(spec, out[:, gripper])
        if space.normalized:
            out[:, gripper] = 2.0 * out[:, gripper] - 1.0
    return out


def gripper_of(spec: PolicySpec, numbers: Array) -> Array:
    """Convert gripper values in the policy's convention to the range from 0 (open) to 1 (closed).

    The result has shape (n,).
    """
    convention = spec.gripper
    closed = np.clip((numbers - convention.open) / (convention.closed - convention.open), 0.0, 1.0)
    return closed if convention.threshold is None else (closed > convention.threshold).astype(np.float64)


class ServerConnection(ABC):
    """A connection to a policy server.

    This base class contains everything that the protocols have in common.
    """

    codec: ClassVar[Codec]

    def __init__(self, spec: PolicySpec, record: PolicyRecord) -> None:
        self.spec, self.record = spec, record
        self.uri = address_uri(spec.protocol, spec.address)
        self.answered = False  # True once the server has responded to a request, which means that it has warmed up

    @abstractmethod
    def begin(self) -> None:
        """Start a rollout, connecting if necessary.

        Raises:
            PolicyError: If the connection fails.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the connection."""

    @property
    def patience(self) -> float:
        """The timeout for the next response [s]."""
        return self.spec.timeout if self.answered else self.spec.warm_up

    def fail(self, message: str, kind: type[PolicyError] = PolicyError) -> PolicyError:
        """Add an error to the record, and return it so that the caller can raise it."""
        self.record.failed(message)
        return kind(message)

    def silent(self, patience: float) -> PolicyError:
        """Return the error for a server that did not respond within ``patience`` [s]."""
        waits = "`timeout`" if self.answered else "`warm_up`"
        return self.fail(f"{self.uri} did not respond within {patience:g} s; increase {waits} if it needs more time")

    @property
    def retried(self) -> str:
        """A phrase that states the number of reconnection attempts.

        The phrase is empty if no attempts are allowed.
        """
        return f" after {self.spec.retries} attempts to connect again" if self.spec.retries else ""

    def packed(self, message: Mapping[str, Any]) -> bytes:
        """Serialize a request."""
        needed("msgpack", f"the protocol of {self.spec.protocol}")
        try:
            return self.codec.pack(message)
        except CodecError as error:
            raise self.fail(f"could not send a request to {self.spec.name}: {error}") from None

    def unpacked(self, data: bytes) -> Any:
        """Parse an untrusted response."""
        try:
            return self.codec.unpack(data)
        except CodecError as error:
            raise self.fail(f"could not parse the response from {self.uri}: {error}", InvalidAnswerError) from None

    @contextmanager
    def timed(self) -> Iterator[None]:
        """Count a request and measure the time until the response arrives."""
        start = time.monotonic()
        self.record.questions += 1
        try:
            yield
        finally:
            self.record.seconds.append(time.monotonic() - start)

    def secret(self) -> str | None:
        """Return the server's API key, which is read from an environment variable.

        The result is None if the document does not name an environment variable.
        """
        spec = self.spec
        if spec.api_key is None:
            return None
        key = os.environ.get(spec.api_key, "").strip()
        if not key:
            where = f"the environment variable {spec.api_key}, which is not set"
            raise PolicyError(f"{spec.name} reads the API key of its server from {where}")
        if not key.isascii() or not key.isprintable():
            reason = "it contains characters that are not allowed in a header"
            raise PolicyError(f"the value of {spec.api_key} is not a valid key: {reason}")
        return key


def last_line(text: str, most: int = 300) -> str:
    """Return the last line of a traceback, limited to ``most`` printable characters."""
    lines = [line.strip() for line in text[-20_000:].splitlines() if line.strip()]
    line = lines[-1] if lines else "no reason was given"
    return "".join(c if c.isprintable() else "?" for c in line[:most])


class RemotePolicy(Policy, ABC):
    """A policy behind a server, configured by a policy document.

    ``record`` contains statistics about its requests. Subclasses implement the protocol: ``begin`` is called before
    each rollout, ``ask`` sends a request, and ``close`` closes the connection.
    """

    def __init__(self, spec: PolicySpec) -> None:
        self.spec, self.name = spec, spec.name
        self.action_space, self.control_hz = spec.space, spec.control_hz
        self.cameras = cameras_of(spec)
        self.image_kinds = tuple(dict.fromkeys(ImageKind(view.kind) for view in spec.cameras.values()))
        self.record = PolicyRecord()
        self._instruction = ""

    def reset(self, instruction: str, seed: int) -> None:
        """Start a rollout, connecting if necessary.

        The server controls any randomness in the policy.
        """
        self._instruction = instruction
        try:
            PROTOCOLS.running(self.spec.protocol, PolicyError)(self.begin)()
        except InvalidAnswerError as error:
            # No action has been requested yet, so the rollout counts as missing rather than as failed.
            raise PolicyError(str(error)) from None

    def infer(self, observation: Observation) -> Array:
        """Return as many actions as ``horizon`` in the policy document specifies.

        The result has shape (horizon, action size).
        """
        answer = PROTOCOLS.running(self.spec.protocol, InvalidAnswerError)(self.ask)(observation)
        try:
            return actions_of(self.spec, answer, observation.robots)
        except PolicyError as error:
            self.record.failed(str(error))
            raise

    @abstractmethod
    def begin(self) -> None:
        """Start a rollout."""

    @abstractmethod
    def ask(self, observation: Observation) -> object:
        """Return the server's response.

        The response should be an array of actions of shape (steps, action size).
        """

    @abstractmethod
    def close(self) -> None:
        """Close the connection."""
