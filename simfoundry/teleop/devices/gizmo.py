"""The gizmo of the page: the hand follows the arrows and rings that a person drags."""

from __future__ import annotations

from simfoundry.geometry.frames import Pose
from simfoundry.spec.models.signals import ActionSpace
from simfoundry.teleop.commands import Command, HandTarget
from simfoundry.teleop.device import InvalidPacketError, TeleopDevice, json_object, numbers
from simfoundry.teleop.devices.page_keys import PAGE_SILENCE_S, HeldKeys

# Length below which a quaternion has no direction; browsers send unit quaternions.
MIN_QUATERNION = 0.5


class GizmoDevice(TeleopDevice):
    """A gizmo. Its packets are ``{"robot": "arm", "pose": [x, y, z, qw, qx, qy, qz]}``, or those of the keyboard.

    The pose is that of the hand in the world. ``{"pose": null}`` ends a drag, so that the hand stays where it is. Keys
    do not move the hand, but have their other meanings.
    """

    name, title = "gizmo", "gizmo"
    space = ActionSpace.parse("hand_pose:world")

    def __init__(self) -> None:
        super().__init__()
        self._keys = HeldKeys()

    @property
    def silence_s(self) -> float:
        """The longest time between two packets [s]; the page repeats the held keys."""
        return PAGE_SILENCE_S

    def parse(self, packet: bytes, time: float) -> list[Command]:
        """Return the target of the hand."""
        found = json_object(packet)
        if "keys" in found:
            return self._keys.update(found["keys"])
        robot, pose = found.get("robot", ""), found.get("pose")
        if not isinstance(robot, str):
            raise InvalidPacketError("`robot` is not a name")
        return [HandTarget(robot, None if pose is None else pose_of(pose, "pose"))]

    def release(self) -> list[Command]:
        """End the drag."""
        self._keys.held = frozenset()
        return [HandTarget("", None)]


def pose_of(value: object, name: str) -> Pose:
    """Return a pose from the numbers x, y, z, qw, qx, qy, qz of a packet.

    Raises:
        InvalidPacketError: If they are not a pose.
    """
    found = numbers(value, name, 7)
    if float((found[3:] ** 2).sum()) < MIN_QUATERNION**2:
        raise InvalidPacketError(f"the quaternion of `{name}` has no direction")
    return Pose.of(found[:3], found[3:])
