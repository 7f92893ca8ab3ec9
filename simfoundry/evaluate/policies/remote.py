"""The base of policies behind servers: name, cameras, checks of answers."""

from __future__ import annotations

from collections.abc import Mapping

from simfoundry.evaluate.policies.base import ActionSpace, ImageSize, InvalidAnswerError, Observation, PolicyError
from simfoundry.evaluate.policies.chunk import actions_of
from simfoundry.evaluate.policies.observation_keys import cameras_of
from simfoundry.evaluate.policies.record import PolicyRecord
from simfoundry.geometry.frames import Array
from simfoundry.spec.models.policy import PolicySpec


class RemotePolicy:
    """A policy behind a server, by its document; ``record`` says what passed between them.

    A subclass says how it asks: ``begin`` before a rollout, ``ask`` for an answer, ``close``.
    """

    def __init__(self, spec: PolicySpec) -> None:
        self.spec = spec
        self.record = PolicyRecord()
        self._instruction = ""

    @property
    def name(self) -> str:
        """The name in its document."""
        return self.spec.name

    @property
    def action_space(self) -> ActionSpace:
        """The action space of its document."""
        return ActionSpace(self.spec.action_space)

    @property
    def cameras(self) -> Mapping[str, ImageSize]:
        """The cameras of the scene that its document names."""
        return cameras_of(self.spec)

    def reset(self, instruction: str, seed: int) -> None:
        """Begin a rollout: connect where nothing is connected. What is random in the policy is the server's own."""
        self._instruction = instruction
        try:
            self.begin()
        except InvalidAnswerError as error:  # it was asked for no action yet, so no rollout has failed by its answer
            raise PolicyError(str(error)) from None

    def infer(self, observation: Observation) -> Array:
        """The actions that its document says are carried out, shape (horizon, numbers of an action)."""
        answer = self.ask(observation)
        try:
            return actions_of(self.spec, answer, observation.robots)
        except PolicyError as error:
            self.record.failed(str(error))
            raise

    def begin(self) -> None:
        """Begin a rollout."""
        raise NotImplementedError

    def ask(self, observation: Observation) -> object:
        """Return the server's answer, which should be an array of actions, shape (steps, numbers of an action)."""
        raise NotImplementedError

    def close(self) -> None:
        """Hang up."""
        raise NotImplementedError
