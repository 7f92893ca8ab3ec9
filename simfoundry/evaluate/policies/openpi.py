"""Clients for openpi (``openpi_client.websocket_client_policy``, 0.1.2) and for RoboArena and DreamZero policies.

RoboArena and DreamZero extend openpi's messages with an ``endpoint`` and keep rollout state on the server. Their server
first sends its configuration (``PolicyServerConfig`` in ``roboarena/policy_server.py``), which is checked against the
policy document. RoboArena and DreamZero number cameras from 0, whereas openpi numbers cameras from 1.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any

from simfoundry.evaluate.policies.base import InvalidAnswerError, Observation
from simfoundry.evaluate.policies.remote import RemotePolicy, droid_cameras, pictures, state
from simfoundry.evaluate.policies.websocket import Connection
from simfoundry.spec.models.policy import PolicyProtocol, PolicySpec

# Keys of the robot state in DROID policies.
DROID_STATE = MappingProxyType({"observation/joint_position": "joints", "observation/gripper_position": "gripper"})


class OpenpiPolicy(RemotePolicy):
    """A client of openpi's ``WebsocketPolicyServer``.

    Requests are independent of each other. If the connection is lost, the client therefore reconnects and repeats the
    request. ``state_keys`` maps robot state keys to readings. It is used if the policy document does not specify a
    mapping.
    """

    state_keys: Mapping[str, str] = DROID_STATE

    def __init__(self, spec: PolicySpec) -> None:
        super().__init__(spec)
        self._connection = Connection(spec, self.record)

    def begin(self) -> None:
        """Connect to the server.

        The protocol does not announce the start of a rollout.
        """
        self._connection.begin()

    def ask(self, observation: Observation) -> object:
        """Return the ``actions`` entry of the server's response."""
        answer = self._connection.ask(self._message(observation))
        if not isinstance(answer, dict) or "actions" not in answer:
            keys = ", ".join(map(str, answer)) if isinstance(answer, dict) else f"a `{type(answer).__name__}`"
            message = f"the response from {self._connection.uri} does not contain `actions`: {keys[:200]}"
            raise self._connection.fail(message, InvalidAnswerError)
        return answer["actions"]

    def _message(self, observation: Observation) -> dict[str, Any]:
        measured = state(self.spec, self.state_keys, observation)
        return {**pictures(self.spec, observation), **measured, "prompt": self._instruction}

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()


_DROID_VIEWS = {"observation/exterior_image_1_left": "exterior", "observation/wrist_image_left": "wrist"}

OPENPI = PolicyProtocol(
    open=OpenpiPolicy,
    schemes=("ws", "wss"),
    port=8000,
    short_form={"cameras": droid_cameras(_DROID_VIEWS, size=(224, 224), render=(448, 252))},
)


# The text with which a server confirms that it has reset its rollout state.
RESET_DONE = "reset successful"


class RoboarenaPolicy(OpenpiPolicy):
    """A client of RoboArena's ``WebsocketPolicyServer``, which DreamZero also uses.

    The server keeps state during a rollout. If the connection is lost, the rollout therefore has no result and counts
    as missing, and the next rollout reconnects. ``new_session`` generates a unique session ID for each rollout. The
    server resets its state whenever the ID changes.
    """

    state_keys = MappingProxyType({**DROID_STATE, "observation/cartesian_position": "hand"})

    def __init__(self, spec: PolicySpec, new_session: Callable[[], object] = uuid.uuid4) -> None:
        super().__init__(spec)
        self._new_session, self._session = new_session, ""

    def begin(self) -> None:
        """Connect, compare the server's configuration with the document, and reset the server's rollout state."""
        self._connection.begin()
        wrong = next(disagreements(self.spec, self._connection.greeting), None)
        if wrong is not None:
            self.close()
            both = f"{self._connection.uri} and the document of {self.spec.name}"
            raise self._connection.fail(f"{both} disagree: {wrong}")
        self._session = str(self._new_session())
        self._connection.ask({"endpoint": "reset"}, expect_text=RESET_DONE)

    def ask(self, observation: Observation) -> object:
        """Return the ``actions`` entry of the response, or the response itself if it has no such entry.

        Servers use both forms.
        """
        message = self._message(observation) | {"session_id": self._session, "endpoint": "infer"}
        answer = self._connection.ask(message, again=False)
        return answer["actions"] if isinstance(answer, dict) and "actions" in answer else answer


# RoboArena's name of a hand pose in the base frame; DROID describes rotations by roll, pitch and yaw.
CARTESIAN = MappingProxyType({"cartesian_position": "hand_pose:rpy"})


def disagreements(spec: PolicySpec, wishes: Mapping[str, Any]) -> Iterator[str]:
    """Yield a sentence for each mismatch between the server's configuration and the document."""
    space = wishes.get("action_space")
    if isinstance(space, str) and CARTESIAN.get(space, space) != str(spec.space):
        yield f"its action space is `{space[:40]}`, but the document specifies `action_space: {spec.action_space}`"
    for key in _wanted_cameras(wishes):
        if key not in spec.cameras:
            yield f"it needs the image `{key}`, which is missing from `cameras`"
    wanted = wishes.get("image_resolution")
    if isinstance(wanted, list | tuple) and len(wanted) == 2:
        for key, view in spec.cameras.items():
            if list(view.size) != [wanted[1], wanted[0]]:
                yield f"it needs images of {wanted[1]} × {wanted[0]}, but `{key}` has `size: {list(view.size)}`"


def _wanted_cameras(wishes: Mapping[str, Any]) -> Iterator[str]:
    external = wishes.get("n_external_cameras")
    sides = ("left", "right") if wishes.get("needs_stereo_camera") is True else ("left",)
    for k in range(min(external, 2) if isinstance(external, int) else 0):
        yield from (f"observation/exterior_image_{k}_{side}" for side in sides)
    if wishes.get("needs_wrist_camera") is True:
        yield from (f"observation/wrist_image_{side}" for side in sides)


_ROBOARENA_VIEWS = {
    "observation/exterior_image_0_left": "exterior",
    "observation/exterior_image_1_left": "exterior_2",
    "observation/wrist_image_left": "wrist",
}

ROBOARENA = PolicyProtocol(
    open=RoboarenaPolicy,
    schemes=("ws", "wss"),
    port=8000,
    short_form={"cameras": droid_cameras(_ROBOARENA_VIEWS, size=(320, 180), render=(320, 180))},
)
