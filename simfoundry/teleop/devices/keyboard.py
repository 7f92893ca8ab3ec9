"""The keyboard of the page: held keys move the hand at a constant speed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from simfoundry.geometry.frames import Array
from simfoundry.spec.models.signals import ActionSpace
from simfoundry.teleop.commands import Command, HandTwist
from simfoundry.teleop.device import TeleopDevice, json_object
from simfoundry.teleop.devices.page_keys import PAGE_SILENCE_S, HeldKeys
from simfoundry.teleop.keys import MOVES, SLOW, TURNS

# Fraction of the speed while Shift is held: 5 cm/s, with which a cup can be put down.
SLOW_FRACTION = 0.25


class KeyboardDevice(TeleopDevice):
    """A keyboard. Its packets are ``{"keys": [...]}`` with all keys that are held."""

    name, title = "keyboard", "keyboard"
    space = ActionSpace.parse("hand_delta:world")

    def __init__(self, speed: float, turn_speed: float) -> None:
        """Move the hand at ``speed`` [m/s], and turn it at ``turn_speed`` [rad/s]."""
        super().__init__()
        self._speed, self._turn_speed = speed, turn_speed
        self._keys = HeldKeys()

    @property
    def silence_s(self) -> float:
        """The longest time between two packets [s]; the page repeats the held keys."""
        return PAGE_SILENCE_S

    def parse(self, packet: bytes, time: float) -> list[Command]:
        """Return the twist of the held keys, and the commands of newly pressed ones."""
        before = self._keys.held
        commands = self._keys.update(json_object(packet).get("keys"))
        return commands if self._keys.held == before else [*commands, self._twist()]

    def release(self) -> list[Command]:
        """Release all keys."""
        self._keys.held = frozenset()
        return [self._twist()]

    def _twist(self) -> HandTwist:
        held = self._keys.held
        factor = SLOW_FRACTION if held.intersection(SLOW) else 1.0
        return HandTwist("", factor * self._speed * _sum(held, MOVES), factor * self._turn_speed * _sum(held, TURNS))


def _sum(held: frozenset[str], directions: Mapping[str, tuple[int, int, int]]) -> Array:
    """Return the sum of the directions of the held keys, no longer than 1."""
    total = np.sum([directions[key] for key in sorted(held & directions.keys())] or [(0, 0, 0)], axis=0)
    return np.asarray(total / max(1.0, float(np.linalg.norm(total))))
