"""Policies of openpi, and of any server with its protocol (``openpi_client.websocket_client_policy``, 0.1.2)."""

from __future__ import annotations

from types import MappingProxyType

from simfoundry.evaluate.policies.base import InvalidAnswerError, Observation
from simfoundry.evaluate.policies.observation_keys import droid_cameras, pictures, state
from simfoundry.evaluate.policies.remote import RemotePolicy
from simfoundry.evaluate.policies.websocket import Connection
from simfoundry.spec.models.policy import PolicyProtocol, PolicySpec

DROID_STATE = MappingProxyType({"observation/joint_position": "joints", "observation/gripper_position": "gripper"})
"""State keys of DROID's policies."""


class OpenpiPolicy(RemotePolicy):
    """A client of openpi's ``WebsocketPolicyServer``.

    Queries are independent, so after a lost connection the client reconnects and repeats the query.
    """

    def __init__(self, spec: PolicySpec) -> None:
        super().__init__(spec)
        self._connection = Connection(spec, self.record)

    def begin(self) -> None:
        """Connect; the protocol has no message for the start of a rollout."""
        self._connection.begin()

    def ask(self, observation: Observation) -> object:
        """Return the ``actions`` of the answer."""
        seen = pictures(self.spec, observation)
        told = state(self.spec, DROID_STATE, observation)
        answer = self._connection.ask({**seen, **told, "prompt": self._instruction})
        if not isinstance(answer, dict) or "actions" not in answer:
            keys = ", ".join(map(str, answer)) if isinstance(answer, dict) else f"a `{type(answer).__name__}`"
            message = f"the answer of {self._connection.uri} has no `actions`: {keys[:200]}"
            raise self._connection.fail(message, InvalidAnswerError)
        return answer["actions"]

    def close(self) -> None:
        """Hang up."""
        self._connection.close()


PROTOCOL = PolicyProtocol(
    open=OpenpiPolicy,
    schemes=("ws", "wss"),
    port=8000,
    short_form={
        "cameras": droid_cameras(
            {"observation/exterior_image_1_left": "exterior", "observation/wrist_image_left": "wrist"},
            size=(224, 224),
            render=(448, 252),
        )
    },
)
