"""Tracked controllers, such as those of VR headsets.

A packet is a line ``{"hand": "right", "position": [x, y, z], "orientation": [x, y, z, w], "squeeze": 0.9, "trigger":
0.2, "buttons": [4]}`` in a frame of WebXR: x right, y up, z back [m], with the scalar of the quaternion last.
``buttons`` lists the pressed ones as in the mapping `xr-standard` (https://www.w3.org/TR/webxr-gamepads-module-1/).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from simfoundry.geometry.frames import Array, Pose, from_xyzw
from simfoundry.spec.models.signals import ActionSpace
from simfoundry.teleop.commands import Command, Control, ControlPress, GripperTarget, TrackedPose
from simfoundry.teleop.device import (
    InvalidPacketError,
    JumpFilter,
    LineSplitter,
    TeleopDevice,
    json_object,
    number,
    numbers,
)
from simfoundry.teleop.devices.joints import presses

# Longest time between two packets of a controller that is tracked [s]; headsets send 72 to 120 per second.
TRACKED_SILENCE_S = 0.5

# Largest change of a position between two packets [m]: at 72 packets per second, this is 14 m/s, faster than a throw.
MAX_JUMP = 0.2

# Position of the squeeze button above which the clutch is engaged, and below which it is released, so that a hand that
# trembles does not do both.
ENGAGE, RELEASE = 0.6, 0.4

# Rotation from WebXR's axes to those of the operator: x forward, y left, z up.
R_OX = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
X_OX = Pose.from_matrix(R_OX)

# Buttons of `xr-standard`: the thumbstick calibrates, and the others control the attempt, for each hand.
THUMBSTICK, LOWER, UPPER = 3, 4, 5
BUTTONS: Mapping[str, Mapping[int, Control]] = {
    "right": {LOWER: Control.SAVE, UPPER: Control.DISCARD},
    "left": {LOWER: Control.MARK, UPPER: Control.PAUSE},
}


class VrDevice(TeleopDevice):
    """Controllers of a VR headset, one for each hand, which move a robot while their squeeze button is pressed."""

    name, title = "vr", "controller"
    space = ActionSpace.parse("hand_pose:world")

    def __init__(self, robots: Mapping[str, str]) -> None:
        """Let each controller move a robot; ``robots`` is keyed by ``left`` and ``right``."""
        super().__init__()
        self._robots = robots
        self._lines = LineSplitter(self.refuse)
        self._forward = Pose.of()  # the rotation from the operator's axes before calibration to those after it
        self._jumps = {hand: JumpFilter(MAX_JUMP) for hand in BUTTONS}
        self._engaged = dict.fromkeys(BUTTONS, False)
        self._pressed: dict[str, frozenset[int]] = dict.fromkeys(BUTTONS, frozenset())

    @property
    def silence_s(self) -> float:
        """The longest time between two packets [s]; a tracked controller sends continuously."""
        return TRACKED_SILENCE_S

    def packets(self, data: bytes) -> list[bytes]:
        """Return the lines that the data completes."""
        return self._lines.lines(data)

    def parse(self, packet: bytes, time: float) -> list[Command]:
        """Return the commands in a packet."""
        found = json_object(packet)
        hand = found.get("hand")
        if not isinstance(hand, str) or hand not in BUTTONS:
            raise InvalidPacketError("`hand` must be left or right")
        X_XC = _pose(found)
        squeeze, trigger = (number(found.get(key, 0.0), key) for key in ("squeeze", "trigger"))
        buttons, pressed = _buttons(found.get("buttons", [])), presses(found.get("press", []))
        self._jumps[hand].check(X_XC.p, time)
        new, self._pressed[hand] = buttons - self._pressed[hand], buttons
        commands = [*pressed, *(ControlPress(BUTTONS[hand][b]) for b in sorted(new & BUTTONS[hand].keys()))]
        if THUMBSTICK in new:
            self._forward = _facing(X_XC)
            self._engaged[hand] = False  # its frame has changed, so it has to be pressed again
        elif squeeze > ENGAGE:
            self._engaged[hand] = True
        elif squeeze < RELEASE:
            self._engaged[hand] = False
        if hand in self._robots:
            robot = self._robots[hand]
            X_OC = self._forward @ X_OX @ X_XC
            commands.append(TrackedPose(robot, X_OC, self._engaged[hand]))
            if self._engaged[hand]:
                commands.append(GripperTarget(robot, min(max(trigger, 0.0), 1.0)))
        return commands

    def release(self) -> list[Command]:
        """Release the clutches."""
        for hand, jumps in self._jumps.items():
            jumps.forget()
            self._engaged[hand] = False
        return [TrackedPose(robot, Pose.of(), False) for robot in self._robots.values()]


def _pose(found: Mapping[str, Any]) -> Pose:
    """Return the pose of a controller in WebXR's frame."""
    q: Array = numbers(found.get("orientation"), "orientation", 4)
    if float(np.linalg.norm(q)) < 0.5:
        raise InvalidPacketError("`orientation` has no direction")
    return Pose.of(numbers(found.get("position"), "position", 3), from_xyzw(q))


def _buttons(value: Any) -> frozenset[int]:
    if not isinstance(value, list) or len(value) > 32 or not all(type(b) is int and 0 <= b < 32 for b in value):
        raise InvalidPacketError("`buttons` must be a list of numbers from 0 to 31")
    return frozenset(value)


def _facing(X_XC: Pose) -> Pose:
    """Return the rotation about the vertical that makes the direction in which a controller points forward."""
    pointing = R_OX @ (X_XC.rotation @ np.array([0.0, 0.0, -1.0]))
    yaw = math.atan2(float(pointing[1]), float(pointing[0]))
    return Pose.about(np.array([0.0, 0.0, 1.0]), -yaw)


def robots_of_hands(robots: tuple[str, ...]) -> dict[str, str]:
    """Return the robot that each hand moves: those named after hands, otherwise the first for the right hand."""
    found = {hand: name for name in robots for hand in BUTTONS if hand in name.lower()}
    if len(set(found.values())) < min(len(robots), len(BUTTONS)):
        found = dict(zip(("right", "left"), robots, strict=False))
    return found
