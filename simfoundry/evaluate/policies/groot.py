"""A client for GR00T N1.6 and N1.7 policies (``gr00t/policy/server_client.py``) over ZeroMQ."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from simfoundry.evaluate.policies.base import InvalidAnswerError, Observation, PolicyError
from simfoundry.evaluate.policies.codec import GROOT_CODEC
from simfoundry.evaluate.policies.remote import (
    PolicyRecord,
    RemotePolicy,
    ServerConnection,
    droid_cameras,
    last_line,
    needed,
    pictures,
    reading,
)
from simfoundry.geometry.frames import Array, Pose
from simfoundry.spec.models.policy import PolicyProtocol, PolicySpec

# Upper limit on the number of keys and time steps, above that of any known policy.
MANY = 64

# The rotation of DROID's hand in GR00T's convention, relative to the hand frame.
DROID_HAND = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True)
class Modality:
    """A modality, which consists of its ``keys`` and its time ``steps``.

    Step 0 is the current step, and past steps are negative.
    """

    keys: tuple[str, ...]
    steps: tuple[int, ...]


def modality(found: Any, name: str) -> Modality:
    """Parse a modality from the response to ``get_modality_config``.

    Raises:
        PolicyError: If the modality is invalid.
    """
    described = found.get(name) if isinstance(found, dict) else None
    if not isinstance(described, dict):
        raise PolicyError(f"the server does not describe its `{name}`")
    keys, steps = described.get("modality_keys"), described.get("delta_indices")
    if not isinstance(keys, list) or not 0 < len(keys) <= MANY or not all(isinstance(k, str) for k in keys):
        raise PolicyError(f"`modality_keys` in the server's `{name}` is not a list of names")
    if not isinstance(steps, list) or not 0 < len(steps) <= MANY or not all(type(s) is int for s in steps):
        raise PolicyError(f"`delta_indices` in the server's `{name}` is not a list of steps")
    return Modality(tuple(keys), tuple(steps))


def eef_9d(X_BH: Pose) -> Array:
    """Encode a hand pose in the base frame in the same way as GR00T's training data from DROID.

    The result is an array of shape (9,). It contains the position [m], followed by the first two rows of a rotation
    matrix. This matrix is the rotation of the hand multiplied by :data:`DROID_HAND`.
    """
    rotation = X_BH.rotation @ DROID_HAND
    return np.concatenate([X_BH.p, rotation[0], rotation[1]])


# The maximum size of a response [bytes]; ZeroMQ disconnects if a response is larger.
LARGEST = 64 * 2**20
# The timeout for the response to a ping [s].
PING_S = 5.0


class Requests(ServerConnection):
    """A REQ socket that is replaced if a request receives no response.

    ZeroMQ connects in the background and does not report unavailable servers, so each rollout starts with a short
    ``ping``. Each exchange consists of one request and one response.
    """

    codec = GROOT_CODEC

    def __init__(self, spec: PolicySpec, record: PolicyRecord) -> None:
        super().__init__(spec, record)
        self._socket: Any = None
        self._monitor: Any = None

    def begin(self) -> None:
        """Verify that the server is available, retrying up to ``spec.retries`` times.

        Raises:
            PolicyError: If the server is not available.
        """
        fresh = self._socket is None
        for left in range(self.spec.retries, -1, -1):
            if self._ping():
                self.record.connections += fresh
                return
            fresh = True
            if left:
                self.record.reconnects += 1
        raise self.fail(f"could not reach a server at {self.uri}{self.retried}")

    def ask(self, endpoint: str, data: Mapping[str, Any] | None = None) -> Any:
        """Return the response from an endpoint.

        Requests are never repeated. Otherwise, the server's rollout state would differ from the actual rollout.

        Raises:
            PolicyError: If there is no valid response.
        """
        with self.timed():
            return self._sound(self._exchange(endpoint, data, self.patience))

    def close(self) -> None:
        """Close the socket.

        Messages that have not been sent are dropped.
        """
        socket, self._socket = self._socket, None
        if socket is not None:
            socket.disable_monitor()
            self._monitor.close(linger=0)
            socket.close(linger=0)

    def _ping(self) -> bool:
        try:
            self._sound(self._exchange("ping", None, min(PING_S, self.spec.timeout)))
        except TimeoutError:
            return False
        return True

    def _sound(self, data: bytes) -> Any:
        if data == b"ERROR":
            raise self.fail(f"the server at {self.uri} failed without stating a reason", InvalidAnswerError)
        answer = self.unpacked(data)
        if isinstance(answer, dict) and "error" in answer:
            reason = last_line(str(answer["error"]))
            raise self.fail(f"the server at {self.uri} failed: {reason}", InvalidAnswerError)
        return answer

    def _exchange(self, endpoint: str, data: Mapping[str, Any] | None, patience: float) -> bytes:
        zmq = needed("zmq", "the protocol of groot")
        request = {"endpoint": endpoint, "data": data, "api_token": self.secret()}
        packed = self.packed({key: value for key, value in request.items() if value is not None})
        socket = self._opened(zmq)
        try:
            while self._monitor.poll(0):  # lost since the last query, and reconnected by ZeroMQ itself
                lost = _event(self._monitor) == zmq.EVENT_DISCONNECTED
                self.record.reconnects += lost
                self.record.connections += lost
            socket.send(packed)
            self._wait(zmq, socket, patience, endpoint == "ping")
            answer: bytes = socket.recv()
        except zmq.Again:
            self.close()
            if endpoint == "ping":
                raise TimeoutError from None
            raise self.silent(patience) from None
        except zmq.ZMQError as error:
            self.close()
            raise self.fail(f"the connection to {self.uri} was lost ({str(error).lower()})") from None
        self.answered = self.answered or endpoint == "get_action"
        return answer

    def _wait(self, zmq: Any, socket: Any, patience: float, is_ping: bool) -> None:
        """Wait for a response.

        Raises:
            zmq.Again: If the timeout expires.
            PolicyError: If the server has disconnected.
        """
        poller = zmq.Poller()
        poller.register(socket, zmq.POLLIN)
        poller.register(self._monitor, zmq.POLLIN)
        end = time.monotonic() + patience
        while (left := end - time.monotonic()) > 0:
            ready = dict(poller.poll(left * 1000))
            if socket in ready:
                return
            if self._monitor in ready and _event(self._monitor) == zmq.EVENT_DISCONNECTED and not is_ping:
                self.close()
                large = f"its response is larger than {LARGEST // 2**20} MiB"
                raise self.fail(f"the server at {self.uri} closed the connection: either it has stopped, or {large}")
        raise zmq.Again

    def _opened(self, zmq: Any) -> Any:
        if self._socket is None:
            self.answered = False
            socket = zmq.Context.instance().socket(zmq.REQ)
            socket.setsockopt(zmq.LINGER, 0)
            socket.setsockopt(zmq.MAXMSGSIZE, LARGEST)
            socket.setsockopt(zmq.SNDTIMEO, int(self.spec.timeout * 1000))
            self._monitor = socket.get_monitor_socket(zmq.EVENT_DISCONNECTED)
            socket.connect(self.uri)
            self._socket = socket
        return self._socket


def _event(monitor: Any) -> int:
    """Return the ID of a monitor event.

    The ID is stored in the first two bytes of the message.
    """
    return int.from_bytes(monitor.recv_multipart()[0][:2], sys.byteorder)


# Mapping from the server's names for parts of the robot state to the names in a policy document; ``eef_9d`` is handled
# separately.
READINGS = {"joint_position": "joints", "gripper_position": "gripper"}
# Parts of a response that are executed.
ACTION = ("joint_position", "gripper_position")


class GrootPolicy(RemotePolicy):
    """A client of GR00T's ``PolicyServer`` for a single arm.

    The server describes its inputs in response to ``get_modality_config``. If the server needs images from earlier
    steps, as N1.7 does, the images of earlier requests are sent again. The number of steps to look back must therefore
    be divisible by ``horizon``.
    """

    def __init__(self, spec: PolicySpec) -> None:
        super().__init__(spec)
        self._requests = Requests(spec, self.record)
        self._takes: dict[str, Modality] = {}
        self._past: list[Mapping[str, Mapping[str, Any]]] = []

    def begin(self) -> None:
        """Request the server's modalities, compare them with the document, and reset the server's rollout state."""
        self._requests.begin()
        self._past = []
        found = self._requests.ask("get_modality_config")
        try:
            self._takes = {name: modality(found, name) for name in ("video", "state", "action", "language")}
            _check(self.spec, self._takes)
        except PolicyError as error:
            raise self._requests.fail(f"{self._requests.uri}: {error}") from None
        self._requests.ask("reset", {"options": None})

    def ask(self, observation: Observation) -> object:
        """Return the joint and gripper values in the response, concatenated along the last axis.

        For a Franka, the result has shape (steps, 8).
        """
        if len(observation.robots) != 1:
            message = f"a groot policy controls one arm, but the task has {len(observation.robots)} robots"
            raise self._requests.fail(message)
        self._past = [*self._past, self._seen(observation)][-self._depth() :]
        request = {
            "video": {k: self._timed("video", k, np.uint8) for k in self._takes["video"].keys},
            "state": {k: self._timed("state", k, np.float32) for k in self._takes["state"].keys},
            "language": {k: [[self._instruction]] for k in self._takes["language"].keys},
        }
        answer = self._requests.ask("get_action", {"observation": request, "options": None})
        try:
            return _joined(answer)
        except PolicyError as error:
            message = f"could not parse the response from {self._requests.uri}: {error}"
            raise self._requests.fail(message, InvalidAnswerError) from None

    def close(self) -> None:
        """Close the socket."""
        self._requests.close()

    def _depth(self) -> int:
        """Return the number of requests to remember, including the current request."""
        steps = (*self._takes["video"].steps, *self._takes["state"].steps)
        return 1 + max(-step // self.spec.horizon for step in steps)

    def _seen(self, observation: Observation) -> Mapping[str, Mapping[str, Any]]:
        """Collect all inputs that the server needs for the current time."""
        images, robots = pictures(self.spec, observation), observation.robots
        (robot,) = robots.values()
        known = {key: reading(name, robots, self.spec.gripper) for key, name in READINGS.items()}
        known["eef_9d"] = eef_9d(robot.X_BH)
        senses: dict[str, Mapping[str, Any]] = {"video": images, "state": known}
        return {kind: {key: every[key] for key in self._takes[kind].keys} for kind, every in senses.items()}

    def _timed(self, kind: str, key: str, number: type[np.generic]) -> np.ndarray[Any, Any]:
        """Return the values at the time steps that the server requests, as an array of shape (1, T, ...).

        Time steps before the start of the rollout are padded with the first value.
        """
        last = len(self._past) - 1
        moments = [max(0, last + step // self.spec.horizon) for step in self._takes[kind].steps]
        return np.stack([np.asarray(self._past[k][kind][key], dtype=number) for k in moments])[None]


def _check(spec: PolicySpec, takes: Mapping[str, Modality]) -> None:
    """Check that the document and this client provide all inputs that the server needs.

    Raises:
        PolicyError: If an input is not provided.
    """
    if spec.space.of_hand:
        known = " and ".join(ACTION)
        raise PolicyError(f"`action_space: {spec.action_space}` is not supported; this client executes {known}")
    for key in takes["video"].keys:
        if key not in spec.cameras:
            raise PolicyError(f"the server needs the image `{key}`, which is missing from `cameras` in {spec.name}")
    for key in takes["state"].keys:
        if key not in READINGS and key != "eef_9d":
            known = ", ".join([*READINGS, "eef_9d"])
            raise PolicyError(f"the server needs the state `{key}`; this client supports {known}")
    for key in ACTION:
        if key not in takes["action"].keys:
            there = ", ".join(takes["action"].keys)[:200]
            raise PolicyError(f"the server's actions do not contain `{key}`, only {there}")
    for step in (*takes["video"].steps, *takes["state"].steps):
        if step > 0 or -step % spec.horizon:
            fits = ", ".join(str(n) for n in range(1, -step + 1) if -step % n == 0)
            reason = f"with `horizon: {spec.horizon}` there is no request at that step"
            raise PolicyError(f"the server needs data from {-step} steps back, but {reason}; set `horizon` to {fits}")


def _joined(answer: Any) -> Array:
    """Concatenate the parts of each action in a response of the form ``[actions, info]``."""
    parts = answer[0] if isinstance(answer, list | tuple) and answer else answer
    if not isinstance(parts, dict):
        raise PolicyError(f"it is a `{type(parts).__name__}`, not a mapping of actions")
    found = []
    for key in ACTION:
        part = parts.get(key, parts.get(f"action.{key}"))
        if not isinstance(part, np.ndarray) or part.ndim != 3 or part.shape[0] != 1:
            what = f"an array of shape {part.shape}" if isinstance(part, np.ndarray) else f"a `{type(part).__name__}`"
            raise PolicyError(f"`{key}` is {what}, but must be an array of shape (1, steps, numbers)")
        if part.dtype.kind not in "fiu":
            raise PolicyError(f"`{key}` is an array of `{part.dtype}`, not of numbers")
        found.append(part[0].astype(np.float64))
    if len(found[0]) != len(found[1]):
        raise PolicyError(f"it has {len(found[0])} steps for the joints but {len(found[1])} for the gripper")
    return np.concatenate(found, axis=1)


GROOT = PolicyProtocol(
    open=GrootPolicy,
    schemes=("tcp",),
    port=5555,
    has_path=False,
    tells_state=False,
    short_form={
        "horizon": 15,
        "cameras": droid_cameras(
            {"exterior_image_1_left": "exterior", "wrist_image_left": "wrist"}, size=(320, 180), render=(320, 180)
        ),
    },
)
