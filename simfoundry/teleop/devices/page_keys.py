"""The keys that are held on the page, as both devices of the page send them."""

from __future__ import annotations

from typing import Any

from simfoundry.teleop.commands import Command, ControlPress, GripperTarget, SwitchArm
from simfoundry.teleop.device import InvalidPacketError
from simfoundry.teleop.keys import CONTROLS, GRIPPER, KNOWN, SWITCH

# Longest time between two packets of an open page [s]. It sends all held keys with each change and every 0.2 s, and
# browsers slow pages that are not visible to one packet per second.
PAGE_SILENCE_S = 2.0

# Largest number of keys in a packet; people have ten fingers.
MAX_KEYS = 32


class HeldKeys:
    """The keys that are held. A packet ``{"keys": ["KeyW", "Space"]}`` lists all of them."""

    def __init__(self) -> None:
        self.held: frozenset[str] = frozenset()

    def update(self, keys: Any) -> list[Command]:
        """Take in the held keys, and return the commands of those that were pressed since.

        Raises:
            InvalidPacketError: If they are not a list of keys.
        """
        if not isinstance(keys, list) or len(keys) > MAX_KEYS or not all(isinstance(key, str) for key in keys):
            raise InvalidPacketError(f"`keys` is not a list of at most {MAX_KEYS} names of keys")
        now = KNOWN.intersection(keys)
        pressed, self.held = sorted(now - self.held), now
        commands: list[Command] = []
        for key in pressed:
            if key == GRIPPER:
                commands.append(GripperTarget("", None))
            elif key == SWITCH:
                commands.append(SwitchArm())
            elif key in CONTROLS:
                commands.append(ControlPress(CONTROLS[key]))
        return commands
