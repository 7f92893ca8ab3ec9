"""Policies of GR00T N1.6 and N1.7 (``gr00t/policy/server_client.py``), over ZeroMQ."""

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

MANY = 64
"""Upper limit of keys and steps, above those of any known policy."""

DROID_HAND = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Rotation of DROID's hand in GR00T's convention, relative to the hand's own frame."""


@dataclass(frozen=True)
class Modality:
    """The ``keys`` of one modality and its time ``steps``, 0 for the present and negative for earlier ones."""

    keys: tuple[str, ...]
    steps: tuple[int, ...]


def modality(found: Any, name: str) -> Modality:
    """Parse one modality of an answer to ``get_modality_config``; raises :class:`PolicyError`."""
    described = found.get(name) if isinstance(found, dict) else None
    if not isinstance(described, dict):
        raise PolicyError(f"the server does not describe its `{name}`")
    keys, steps = described.get("modality_keys"), described.get("delta_indices")
    if not isinstance(keys, list) or not 0 < len(keys) <= MANY or not all(isinstance(k, str) for k in keys):
        raise PolicyError(f"`modality_keys` of the server's `{name}` is not a list of names")
    if not isinstance(steps, list) or not 0 < len(steps) <= MANY or not all(type(s) is int for s in steps):
        raise PolicyError(f"`delta_indices` of the server's `{name}` is not a list of steps")
    return Modality(tuple(keys), tuple(steps))


def eef_9d(X_BH: Pose) -> Array:
    """Hand pose in the base frame as in GR00T's training on DROID: position [m], then the first two rows of the
    rotation.

    The rotation is the hand's times a fixed one of DROID; shape (9,).
    """
    rotation = X_BH.rotation @ DROID_HAND
    return np.concatenate([X_BH.p, rotation[0], rotation[1]])


LARGEST = 64 * 2**20
"""Maximum size of an answer [bytes]; ZeroMQ disconnects on a larger one."""
PING_S = 5.0
"""Timeout for the answer to a ping [s]."""


class Requests(ServerConnection):
    """A REQ socket, which is replaced after a missing answer, because it cannot be used any more.

    ZeroMQ connects in the background and does not report missing servers: a short ``ping`` before a rollout detects
    them. A message goes in each direction.
    """

    codec = GROOT_CODEC

    def __init__(self, spec: PolicySpec, record: PolicyRecord) -> None:
        super().__init__(spec, record)
        self._socket: Any = None
        self._monitor: Any = None

    def begin(self) -> None:
        """Verify that the server is there; raises :class:`PolicyError` after ``spec.retries`` further attempts."""
        fresh = self._socket is None
        for left in range(self.spec.retries, -1, -1):
            if self._ping():
                self.record.connections += fresh
                return
            fresh = True
            if left:
                self.record.reconnects += 1
        raise self.fail(f"no server answers at {self.uri}{self.retried}")

    def ask(self, endpoint: str, data: Mapping[str, Any] | None = None) -> Any:
        """Return the answer of an endpoint; raises :class:`PolicyError`.

        A query is never repeated, because the server's rollout state would then differ from the actual rollout.
        """
        with self.timed():
            return self._sound(self._exchange(endpoint, data, self.patience))

    def close(self) -> None:
        """Close the socket; unsent messages are dropped."""
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
            raise self.fail(f"the server at {self.uri} failed without giving a reason", InvalidAnswerError)
        answer = self.unpacked(data)
        if isinstance(answer, dict) and "error" in answer:
            reason = last_line(str(answer["error"]))
            raise self.fail(f"the server at {self.uri} failed: {reason}", InvalidAnswerError)
        return answer

    def _exchange(self, endpoint: str, data: Mapping[str, Any] | None, patience: float) -> bytes:
        zmq = needed("zmq", "the protocol of groot")
        request: dict[str, Any] = {"endpoint": endpoint}
        if data is not None:
            request["data"] = data
        key = self.secret()
        if key is not None:
            request["api_token"] = key
        packed = self.packed(request)
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
        """Wait for an answer; raises ``zmq.Again`` on timeout, :class:`PolicyError` if the server has disconnected."""
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
                large = f"its answer is larger than {LARGEST // 2**20} MiB"
                raise self.fail(f"the server at {self.uri} closed the connection: it has stopped, or {large}")
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
    """Return the number of a monitor event: the first two bytes of a report."""
    return int.from_bytes(monitor.recv_multipart()[0][:2], sys.byteorder)


READINGS = {"joint_position": "joints", "gripper_position": "gripper"}
"""Servers' names for the robot's state, and the corresponding ones of a policy document; ``eef_9d`` is computed
separately.
"""
ACTION = ("joint_position", "gripper_position")
"""Parts of an answer that are executed."""


class GrootPolicy(RemotePolicy):
    """A client of GR00T's ``PolicyServer``, for one arm.

    The server describes its inputs (``get_modality_config``). If it needs images of earlier steps, as N1.7 does, they
    are those of earlier queries: ``horizon`` must divide the number of steps that it looks back.
    """

    def __init__(self, spec: PolicySpec) -> None:
        super().__init__(spec)
        self._requests = Requests(spec, self.record)
        self._takes: dict[str, Modality] = {}
        self._past: list[Mapping[str, Mapping[str, Any]]] = []

    def begin(self) -> None:
        """Query the server's modalities, check them against the document, and reset the server's rollout."""
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
        """Return the joints and gripper of the answer side by side, shape (steps, 8) for a Franka."""
        if len(observation.robots) != 1:
            message = f"a groot policy moves one arm, but the task has {len(observation.robots)} robots"
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
            message = f"the answer of {self._requests.uri} cannot be read: {error}"
            raise self._requests.fail(message, InvalidAnswerError) from None

    def close(self) -> None:
        """Close the socket."""
        self._requests.close()

    def _depth(self) -> int:
        """Number of remembered time steps, including the present one."""
        steps = (*self._takes["video"].steps, *self._takes["state"].steps)
        return 1 + max(-step // self.spec.horizon for step in steps)

    def _seen(self, observation: Observation) -> Mapping[str, Mapping[str, Any]]:
        """Collect all inputs of the server at this time."""
        images = pictures(self.spec, observation)
        (robot,) = observation.robots.values()
        senses = {
            key: eef_9d(robot.X_BH)
            if key == "eef_9d"
            else reading(READINGS[key], observation.robots, self.spec.gripper)
            for key in self._takes["state"].keys
        }
        return {"video": {k: images[k] for k in self._takes["video"].keys}, "state": senses}

    def _timed(self, kind: str, key: str, number: type[np.generic]) -> np.ndarray[Any, Any]:
        """Values at the time steps that the server requests, padded by repeating the first; shape (1, T, ...)."""
        last = len(self._past) - 1
        moments = [max(0, last + step // self.spec.horizon) for step in self._takes[kind].steps]
        return np.stack([np.asarray(self._past[k][kind][key], dtype=number) for k in moments])[None]


def _check(spec: PolicySpec, takes: Mapping[str, Modality]) -> None:
    """Raise :class:`PolicyError` if the document, or this client, lacks an input that the server needs."""
    for key in takes["video"].keys:
        if key not in spec.cameras:
            raise PolicyError(f"the server needs the image `{key}`, which is missing in `cameras` of {spec.name}")
    for key in takes["state"].keys:
        if key not in READINGS and key != "eef_9d":
            known = ", ".join([*READINGS, "eef_9d"])
            raise PolicyError(f"the server needs the state `{key}`; this client supports {known}")
    missing = [key for key in ACTION if key not in takes["action"].keys]
    if missing:
        raise PolicyError(f"the server's actions have no `{missing[0]}`, only {', '.join(takes['action'].keys)[:200]}")
    for kind in ("video", "state"):
        for step in takes[kind].steps:
            if step > 0 or -step % spec.horizon:
                fits = [n for n in range(1, -step + 1) if -step % n == 0]
                raise PolicyError(
                    f"the server looks {-step} steps back, but `horizon: {spec.horizon}` makes no query at that step; "
                    f"use one of {', '.join(map(str, fits))}"
                )


def _joined(answer: Any) -> Array:
    """Join the parts of an action side by side, from an answer ``[actions, info]``."""
    parts = answer[0] if isinstance(answer, list | tuple) and answer else answer
    if not isinstance(parts, dict):
        raise PolicyError(f"it is a `{type(parts).__name__}`, not a mapping of actions")
    found = []
    for key in ACTION:
        part = parts.get(key, parts.get(f"action.{key}"))
        if not isinstance(part, np.ndarray) or part.ndim != 3 or part.shape[0] != 1:
            what = f"of shape {part.shape}" if isinstance(part, np.ndarray) else f"a `{type(part).__name__}`"
            raise PolicyError(f"`{key}` is {what}, not an array (1, steps, numbers)")
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
