"""SpaceMouse: HID reports of 3Dconnexion devices.

A report is its number, followed by values in little-endian order:

======  ==================  ==================================================================
number  length [bytes]      content
======  ==================  ==================================================================
1       7                   translation: int16 for x, y and z
1       13                  translation and rotation (newer devices)
2       7                   rotation: int16 about x, y and z
3       2 to 33             buttons: one bit each, the first one in the lowest bit
23      2 to 33             charge of the battery, which is ignored
======  ==================  ==================================================================

x points right, y toward the person, and z down; the values reach about ±350. The layout is that of the drivers
`spacenavd` and `pyspacemouse`.
"""

from __future__ import annotations

import struct

import numpy as np

from simfoundry.geometry.frames import Array
from simfoundry.spec.models.signals import ActionSpace
from simfoundry.teleop.commands import Command, Control, ControlPress, GripperTarget, HandTwist, SwitchArm
from simfoundry.teleop.device import InvalidPacketError, TeleopDevice

TRANSLATION, ROTATION, BUTTONS, BATTERY = 1, 2, 3, 23

# Value at full deflection (pyspacemouse, for all models), and the largest one that a device can send; above, a report
# is damaged.
FULL, MAX_VALUE = 350.0, 1000

# Fraction of full deflection below which the cap counts as at rest; caps rest at up to 3 % (15 of 350).
DEAD = 0.05

# Longest time between two reports while the cap is deflected [s]; devices then send a report every 8 to 16 ms.
DEFLECTED_SILENCE_S = 1.0

# Rotation from the axes of the device to those of the operator (forward, left, up).
R_OD = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


class SpaceMouseDevice(TeleopDevice):
    """A SpaceMouse. The deflection of the cap is the velocity of the hand.

    The first button toggles the gripper, the second one switches to the next arm, or marks a sub-task if there is only
    one. Further buttons have no meaning.
    """

    name, title = "spacemouse", "SpaceMouse"
    space = ActionSpace.parse("hand_delta:world")

    def __init__(self, speed: float, turn_speed: float, arms: int = 1) -> None:
        """Move the hand at up to ``speed`` [m/s], and turn it at up to ``turn_speed`` [rad/s]."""
        super().__init__()
        self._speed, self._turn_speed, self._arms = speed, turn_speed, arms
        self._axes = np.zeros(6)
        self._buttons = 0

    @property
    def silence_s(self) -> float | None:
        """The longest time between two packets [s], or None while the cap is at rest and sends nothing."""
        return DEFLECTED_SILENCE_S if self._axes.any() else None

    def parse(self, packet: bytes, time: float) -> list[Command]:
        """Return the commands in a report."""
        kind, size = packet[0] if packet else 0, len(packet)
        if kind == TRANSLATION and size in (7, 13):
            self._axes = np.concatenate([_deflections(packet[1:7]), _deflections(packet[7:13]), self._axes[3:]])[:6]
            return [self._twist()]
        if kind == ROTATION and size == 7:
            self._axes = np.concatenate([self._axes[:3], _deflections(packet[1:7])])
            return [self._twist()]
        if kind == BUTTONS and 2 <= size <= 33:
            now = int.from_bytes(packet[1:], "little")
            pressed, self._buttons = now & ~self._buttons, now
            second: Command = SwitchArm() if self._arms > 1 else ControlPress(Control.MARK)
            return [command for k, command in enumerate((GripperTarget("", None), second)) if pressed >> k & 1]
        if kind == BATTERY and 2 <= size <= 33:
            return []
        raise InvalidPacketError("it is not a report of a SpaceMouse of a known length")

    def release(self) -> list[Command]:
        """Center the cap."""
        self._axes, self._buttons = np.zeros(6), 0
        return [self._twist()]

    def _twist(self) -> HandTwist:
        return HandTwist("", self._speed * (R_OD @ self._axes[:3]), self._turn_speed * (R_OD @ self._axes[3:]))


def _deflections(data: bytes) -> Array:
    """Return the deflections about or along three axes, from -1 to 1, or nothing without data."""
    values = np.array(struct.unpack(f"<{len(data) // 2}h", data), dtype=np.float64)
    if (np.abs(values) > MAX_VALUE).any():
        raise InvalidPacketError("its values are larger than a SpaceMouse can send")
    share = np.clip(values / FULL, -1.0, 1.0)
    return np.where(np.abs(share) < DEAD, 0.0, share)


def translation_report(x: int, y: int, z: int) -> bytes:
    """Return a report of a translation, as a device sends it."""
    return struct.pack("<B3h", TRANSLATION, x, y, z)


def rotation_report(x: int, y: int, z: int) -> bytes:
    """Return a report of a rotation, as a device sends it."""
    return struct.pack("<B3h", ROTATION, x, y, z)


def button_report(*pressed: int) -> bytes:
    """Return a report of the pressed buttons, counted from 0, as a device sends it."""
    return struct.pack("<BH", BUTTONS, sum(1 << k for k in pressed))
