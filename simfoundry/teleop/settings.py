"""The settings of a session that determine the meaning of a device's packets, and the devices by name."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.task import Task
from simfoundry.geometry.frames import Array, Pose
from simfoundry.teleop.device import TeleopDevice
from simfoundry.teleop.leader import LeaderSpec, check_leader
from simfoundry.worlds.base import World

# The devices, with a few words about each.
DEVICES: Mapping[str, str] = {
    "keyboard": "keys of the page, which move the hand at a constant speed",
    "gizmo": "arrows and rings at the hand, which are dragged on the page",
    "spacemouse": "a SpaceMouse at this machine, whose deflection is the velocity of the hand",
    "joints": "a leader arm such as GELLO or JoyLo, whose joints are those of the robot",
    "vr": "controllers of a VR headset, by WebXR on the page or over a socket",
}

# Fewest actions per second [Hz], so that a command waits for at most 1/30 s until it is applied. Tasks are controlled
# at 15 Hz, at which it would wait for up to 67 ms.
MIN_ACTION_HZ = 30.0


class DeviceOptions(BaseModel):
    """The options of devices.

    Attributes:
        speed: Speed of the hand at a held key, and at full deflection of a SpaceMouse [m/s].
        turn_speed: The same for turning [rad/s].
        scale: Motion of the hand for each meter that a tracked controller moves.
        yaw_deg: Direction that the operator calls forward, as an angle about the vertical from x to y of the world
            [deg]; by default, that of the x axis of the first robot's base.
        leader: The servos of leader arms, or None for other devices.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    speed: float = Field(default=0.2, gt=0, le=1)  # 20 cm/s crosses a table in three seconds
    turn_speed: float = Field(default=0.8, gt=0, le=5)  # half a turn in four seconds
    scale: float = Field(default=1.0, gt=0, le=10)
    yaw_deg: float | None = Field(default=None, ge=-360, le=360)
    leader: LeaderSpec | None = None


@dataclass(frozen=True)
class TeleopSettings:
    """The settings that a replay of a session repeats.

    Attributes:
        device: The name of the device.
        control_hz: The number of actions per second [Hz].
        seed: The seed of the initial states.
        options: The options of the device.
    """

    device: str
    control_hz: float
    seed: int
    options: DeviceOptions


def parse_options(data: Mapping[str, Any]) -> DeviceOptions:
    """Return the options in the header of a stream.

    Raises:
        SimfoundryError: If they are not valid.
    """
    try:
        return DeviceOptions.model_validate(dict(data))
    except ValidationError as error:
        first = error.errors()[0]
        at = ".".join(map(str, first["loc"]))
        raise SimfoundryError(f"the options of the device are not valid: `{at}`: {first['msg']}") from None


def action_hz(task: Task) -> float:
    """Return the default number of actions per second: the least multiple of the task's that reacts fast enough."""
    return task.control_hz * math.ceil(MIN_ACTION_HZ / task.control_hz)


def joint_counts(task: Task, world: World) -> dict[str, int]:
    """Return the number of arm joints of each robot of a task."""
    return {name: len(world.robot(name).joints) for name in task.robots}


def create_device(name: str, options: DeviceOptions, joints: Mapping[str, int]) -> TeleopDevice:
    """Create a device.

    Args:
        name: Its name, as in :data:`DEVICES`.
        options: Its options.
        joints: The number of arm joints of each robot.

    Raises:
        SimfoundryError: If there is no such device.
    """
    match name:
        case "keyboard":
            from simfoundry.teleop.devices.keyboard import KeyboardDevice

            return KeyboardDevice(options.speed, options.turn_speed)
        case "gizmo":
            from simfoundry.teleop.devices.gizmo import GizmoDevice

            return GizmoDevice()
        case "spacemouse":
            from simfoundry.teleop.devices.spacemouse import SpaceMouseDevice

            return SpaceMouseDevice(options.speed, options.turn_speed, len(joints))
        case "joints" if options.leader is not None:
            from simfoundry.teleop.devices.dynamixel import DynamixelLeader

            check_leader(options.leader, joints, "the description of the leader arms")
            return DynamixelLeader(joints, options.leader.arms)
        case "joints":
            from simfoundry.teleop.devices.joints import JsonLeader

            return JsonLeader(joints)
        case "vr":
            from simfoundry.teleop.devices.vr import VrDevice, robots_of_hands

            return VrDevice(robots_of_hands(tuple(joints)))
    raise SimfoundryError(f"there is no device `{name[:40]}`; available: {', '.join(DEVICES)}")


def operator_rotation(task: Task, yaw_deg: float | None) -> Array:
    """Return the rotation from the axes of the operator (forward, left, up) to those of the world, shape (3, 3)."""
    if yaw_deg is None:
        forward = task.scene.robot(task.robots[0]).X_WB.rotation[:, 0]
        yaw = math.atan2(float(forward[1]), float(forward[0])) if math.hypot(*forward[:2]) > 0.1 else 0.0
    else:
        yaw = math.radians(yaw_deg)
    c, s = math.cos(yaw / 2), math.sin(yaw / 2)
    return Pose.of(q=(c, 0.0, 0.0, s)).rotation
