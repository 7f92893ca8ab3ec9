"""Base class of policies behind servers: name, cameras, and validation of answers."""

from __future__ import annotations

from collections.abc import Mapping

from simfoundry.evaluate.policies.base import ActionSpace, ImageSize, InvalidAnswerError, Observation, PolicyError
from simfoundry.evaluate.policies.chunk import actions_of
from simfoundry.evaluate.policies.observation_keys import cameras_of
from simfoundry.evaluate.policies.record import PolicyRecord
from simfoundry.geometry.frames import Array
from simfoundry.spec.models.policy import PolicySpec


class RemotePolicy:
    """A policy behind a server, configured by its document; ``record`` has the statistics of their exchange.

    Subclasses implement the protocol: ``begin`` before a rollout, ``ask`` for an answer, and ``close``.
    """

    def __init__(self, spec: PolicySpec) -> None:
        self.spec = spec
        self.record = PolicyRecord()
        self._instruction = ""

    @property
    def name(self) -> str:
        """Name in its document."""
        return self.spec.name

    @property
    def action_space(self) -> ActionSpace:
        """Action space in its document."""
        return ActionSpace(self.spec.action_space)

    @property
    def cameras(self) -> Mapping[str, ImageSize]:
        """Cameras of the scene that its document names."""
        return cameras_of(self.spec)

    def reset(self, instruction: str, seed: int) -> None:
        """Start a rollout, connecting if necessary. Randomness in the policy is up to the server."""
        self._instruction = instruction
        try:
            self.begin()
        except InvalidAnswerError as error:  # no action was requested yet, so the rollout has not failed by an answer
            raise PolicyError(str(error)) from None

    def infer(self, observation: Observation) -> Array:
        """Return the number of actions stated by its document, shape (horizon, numbers of an action)."""
        answer = self.ask(observation)
        try:
            return actions_of(self.spec, answer, observation.robots)
        except PolicyError as error:
            self.record.failed(str(error))
            raise

    def begin(self) -> None:
        """Start a rollout."""
        raise NotImplementedError

    def ask(self, observation: Observation) -> object:
        """Return the server's answer, which should be an array of actions, shape (steps, numbers of an action)."""
        raise NotImplementedError

    def close(self) -> None:
        """Hang up."""
        raise NotImplementedError
