"""Leader arms that send the positions of their joints as lines of JSON: GELLO, JoyLo, or any program.

A line is ``{"robot": "left", "joints": [0.1, …], "gripper": 0.3, "press": ["save"]}``, with positions in rad or m in
the order from the base, and the gripper from 0 (open) to 1 (closed). ``robot`` can be omitted if the task has only
one, ``gripper`` if the leader has none, and ``press`` if no button was pressed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from simfoundry.geometry.frames import Array
from simfoundry.spec.models.signals import ActionSpace
from simfoundry.teleop.commands import Command, Control, ControlPress, GripperTarget, JointTargets
from simfoundry.teleop.device import InvalidPacketError, JumpFilter, LineSplitter, TeleopDevice, json_object, number
from simfoundry.teleop.device import numbers as packet_numbers

# Longest time between two lines of a working leader [s]; they send 30 to 1000 per second.
LEADER_SILENCE_S = 0.5

# Largest change of a joint between two packets [rad or m]: at 30 packets per second, this is 30 rad/s, three times as
# fast as a person throws.
MAX_JUMP = 1.0


class LeaderDevice(TeleopDevice):
    """A leader arm. Its joints are the targets of the joints of the robot."""

    name, title = "joints", "leader arm"
    space = ActionSpace.JOINT_POSITION

    def __init__(self, joints: Mapping[str, int]) -> None:
        """Expect the positions of a number of joints for each robot."""
        super().__init__()
        self._joints = joints
        self._jumps = {robot: JumpFilter(MAX_JUMP) for robot in joints}

    @property
    def silence_s(self) -> float:
        """The longest time between two packets [s]; a leader sends continuously."""
        return LEADER_SILENCE_S

    def targets(self, robot: str, positions: Array, gripper: float | None, time: float) -> list[Command]:
        """Return the commands for the measured positions of a leader.

        Raises:
            InvalidPacketError: If the positions jump.
        """
        self._jumps[robot].check(positions, time)
        found: list[Command] = [JointTargets(robot, positions)]
        if gripper is not None:
            found.append(GripperTarget(robot, min(max(gripper, 0.0), 1.0)))
        return found

    def release(self) -> list[Command]:
        """Stay where the joints are. After a loss, the leader can be anywhere."""
        for jumps in self._jumps.values():
            jumps.forget()
        return []


class JsonLeader(LeaderDevice):
    """A leader that sends lines of JSON."""

    def __init__(self, joints: Mapping[str, int]) -> None:
        super().__init__(joints)
        self._lines = LineSplitter(self.refuse)

    def packets(self, data: bytes) -> list[bytes]:
        """Return the lines that the data completes."""
        return self._lines.lines(data)

    def parse(self, packet: bytes, time: float) -> list[Command]:
        """Return the targets in a line."""
        found = json_object(packet)
        robot = self._robot(found.get("robot", ""))
        if "joints" not in found:
            raise InvalidPacketError("`joints` is missing")
        positions = packet_numbers(found["joints"], "joints", self._joints[robot])
        gripper = number(found["gripper"], "gripper") if "gripper" in found else None
        return [*self.targets(robot, positions, gripper, time), *presses(found.get("press", []))]

    def _robot(self, name: Any) -> str:
        if name == "" and len(self._joints) == 1:
            return next(iter(self._joints))
        if not isinstance(name, str) or name not in self._joints:
            raise InvalidPacketError(f"`robot` must be one of {', '.join(self._joints)}")
        return name


def presses(names: Any) -> list[Command]:
    """Return the presses of the controls that a packet lists.

    Raises:
        InvalidPacketError: If one of them is unknown.
    """
    known = list(Control)
    if not isinstance(names, list) or len(names) > len(known) or not all(name in known for name in names):
        raise InvalidPacketError(f"`press` must be a list of {', '.join(known)}")
    return [ControlPress(Control(name)) for name in names]
