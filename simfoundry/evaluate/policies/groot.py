"""Policies of GR00T N1.6 and N1.7 (``gr00t/policy/server_client.py``)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from simfoundry.evaluate.policies.base import InvalidAnswerError, Observation, PolicyError
from simfoundry.evaluate.policies.groot_modality import Modality, eef_9d, modality
from simfoundry.evaluate.policies.observation_keys import droid_cameras, pictures, reading
from simfoundry.evaluate.policies.remote import RemotePolicy
from simfoundry.evaluate.policies.zmq_socket import Requests
from simfoundry.geometry.frames import Array
from simfoundry.spec.models.policy import PolicyProtocol, PolicySpec

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


PROTOCOL = PolicyProtocol(
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
