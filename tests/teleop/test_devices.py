"""Devices: what their packets mean, and that no packet can do anything else."""

from __future__ import annotations

import json
import math
import random
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from simfoundry.geometry.frames import Pose
from simfoundry.teleop.commands import (
    Command,
    Control,
    ControlPress,
    GripperTarget,
    HandTarget,
    HandTwist,
    JointTargets,
    SwitchArm,
    TrackedPose,
)
from simfoundry.teleop.device import MAX_PACKET, TeleopDevice
from simfoundry.teleop.devices import spacemouse
from simfoundry.teleop.devices.dynamixel import DynamixelLeader, crc16, status_packet, sync_read
from simfoundry.teleop.devices.gizmo import GizmoDevice
from simfoundry.teleop.devices.joints import JsonLeader
from simfoundry.teleop.devices.keyboard import KeyboardDevice
from simfoundry.teleop.devices.spacemouse import SpaceMouseDevice
from simfoundry.teleop.devices.vr import VrDevice, robots_of_hands
from simfoundry.teleop.leader import LeaderArm, LeaderGripper
from tests.teleop.streams import LEADER

JOINTS = {"arm": 7}


def line(**content: Any) -> bytes:
    return json.dumps(content).encode() + b"\n"


def joint_targets(commands: list[Command]) -> list[Any]:
    return [command.positions.tolist() for command in commands if isinstance(command, JointTargets)]


# -- keyboard and gizmo


def test_held_keys_are_a_velocity_and_pressed_ones_act_once() -> None:
    device = KeyboardDevice(0.2, 0.8)
    twist, *rest = reversed(device.feed(line(keys=["KeyW", "KeyA", "Space", "KeyM"]), 0.0))
    assert isinstance(twist, HandTwist)
    np.testing.assert_allclose(twist.linear, 0.2 * np.array([1, 1, 0]) / math.sqrt(2))  # diagonals are no faster
    assert rest[::-1] == [ControlPress(Control.MARK), GripperTarget("", None)]
    assert device.feed(line(keys=["KeyW", "KeyA", "Space", "KeyM"]), 0.2) == []
    (slow,) = device.feed(line(keys=["KeyE", "ShiftLeft"]), 0.3)
    assert isinstance(slow, HandTwist)
    np.testing.assert_allclose(slow.angular, [0, 0, -0.2])
    (still,) = device.release()
    assert isinstance(still, HandTwist) and not still.linear.any() and not still.angular.any()


def test_a_drag_is_a_pose_in_the_world() -> None:
    device = GizmoDevice()
    (target,) = device.feed(line(robot="left", pose=[0.1, 0.2, 0.3, 0, 2, 0, 0]), 0.0)
    assert isinstance(target, HandTarget) and target.robot == "left" and target.X_WH is not None
    np.testing.assert_allclose(target.X_WH.q, [0, 1, 0, 0])
    assert device.feed(line(keys=["Tab"]), 0.0) == [SwitchArm()]


# -- SpaceMouse


def test_the_axes_of_a_space_mouse_are_those_of_the_operator() -> None:
    """The cap pushed away, to the left and pulled up, and then turned about the same axes."""
    device = SpaceMouseDevice(0.35, 3.5)
    for report, values, expected in (
        (spacemouse.translation_report, (0, -350, 0), [0.35, 0, 0, 0, 0, 0]),
        (spacemouse.translation_report, (-350, 0, 0), [0, 0.35, 0, 0, 0, 0]),
        (spacemouse.translation_report, (0, 0, -175), [0, 0, 0.175, 0, 0, 0]),
        (spacemouse.translation_report, (0, 0, 10), [0, 0, 0, 0, 0, 0]),  # within the play of the cap
        (spacemouse.rotation_report, (0, 0, 350), [0, 0, 0, 0, 0, -3.5]),
        (spacemouse.rotation_report, (0, -350, 0), [0, 0, 0, 3.5, 0, 0]),
    ):
        (twist,) = device.feed(report(*values), 0.0)
        assert isinstance(twist, HandTwist)
        np.testing.assert_allclose([*twist.linear, *twist.angular], expected, atol=1e-12)
    long = struct.pack("<B6h", 1, 0, -350, 0, 0, 0, -350)
    (twist,) = device.feed(long, 0.0)
    assert isinstance(twist, HandTwist)
    np.testing.assert_allclose([*twist.linear, *twist.angular], [0.35, 0, 0, 0, 0, 3.5], atol=1e-12)
    assert device.silence_s is not None
    device.release()
    assert device.silence_s is None  # a cap at rest sends nothing


def test_the_buttons_of_a_space_mouse_act_when_they_are_pressed() -> None:
    device = SpaceMouseDevice(0.2, 0.8, arms=2)
    assert device.feed(spacemouse.button_report(0), 0.0) == [GripperTarget("", None)]
    assert device.feed(spacemouse.button_report(0, 1), 0.0) == [SwitchArm()]
    assert device.feed(spacemouse.button_report(5), 0.0) == [] and device.feed(spacemouse.button_report(), 0.0) == []
    assert SpaceMouseDevice(0.2, 0.8).feed(spacemouse.button_report(1), 0.0) == [ControlPress(Control.MARK)]
    assert device.feed(bytes([23, 80, 0]), 0.0) == [] and not device.refused  # the charge of a battery


# -- leader arms


def test_lines_of_joints_may_arrive_in_any_pieces() -> None:
    device = JsonLeader({"left": 2, "right": 2})
    data = line(robot="left", joints=[0.1, -0.2], gripper=0.3) + line(robot="right", joints=[1, 2], press=["save"])
    found = [command for k in range(len(data)) for command in device.feed(data[k : k + 1], 0.0)]
    assert joint_targets(found) == [[0.1, -0.2], [1.0, 2.0]]
    assert found[1] == GripperTarget("left", 0.3) and found[-1] == ControlPress(Control.SAVE)
    assert not device.refused


@pytest.mark.parametrize(
    ("packet", "reason"),
    [
        (line(joints=[0.0] * 6), "`joints` has 6 numbers instead of 7"),
        (line(joints=0.5), "`joints` is not a list instead of 7"),
        (b'{"joints": [NaN, 0, 0, 0, 0, 0, 0]}\n', "`joints` is not a number between -1000 and 1000"),
        (b'{"joints": [1e999, 0, 0, 0, 0, 0, 0]}\n', "`joints` is not a number between -1000 and 1000"),
        (b'{"joints": [' + b"9" * 3000 + b", 0, 0, 0, 0, 0, 0]}\n", "`joints` is not a number between -1000 and 1000"),
        (line(joints=[True] * 7), "`joints` is not a number"),
        (line(joints=[0.0] * 7, gripper="x"), "`gripper` is not a number"),
        (line(joints=[0.0] * 7, robot="else"), "`robot` must be one of arm"),
        (line(joints=[0.0] * 7, press=["jump"]), "`press` must be a list of"),
        (line(press=["save"]), "`joints` is missing"),
        (b"[1, 2]\n", "it is not a JSON object"),
        (b"\xff\xfe\n", "it is not JSON"),
        (b"[" * 4000 + b"\n", "it is not JSON"),
        (b'{"joints": ' + b"[" * (2 * MAX_PACKET) + b"\n", "it is longer than 4096 bytes"),
    ],
)
def test_invalid_lines_are_refused_in_a_sentence_and_the_next_one_counts(packet: bytes, reason: str) -> None:
    device = JsonLeader(JOINTS)
    assert device.feed(packet, 0.0) == []
    ((found, count),) = device.refused.items()
    assert found.startswith(reason) and count == 1 and device.last_refusal == found and device.heard_at is None
    assert joint_targets(device.feed(line(joints=[0.5] * 7), 0.1)) == [[0.5] * 7]
    assert device.last_refusal == "" and device.heard_at == 0.1


def test_jumps_are_refused_until_several_packets_agree() -> None:
    device = JsonLeader({"arm": 1})
    assert joint_targets(device.feed(line(joints=[0.0]), 0.0)) == [[0.0]]
    assert device.feed(line(joints=[3.0]), 0.01) == [] and device.feed(line(joints=[-3.0]), 0.02) == []
    assert joint_targets(device.feed(line(joints=[0.1]), 0.03)) == [[0.1]]
    answers = [device.feed(line(joints=[3.0]), 0.04 + 0.01 * k) for k in range(5)]
    assert answers[:4] == [[]] * 4 and joint_targets(answers[4]) == [[3.0]]
    assert joint_targets(device.feed(line(joints=[-3.0]), 1.0)) == [[-3.0]]  # after a pause, it can be anywhere
    assert device.refused == {"it jumps farther than a person moves": 6}


def test_servos_are_read_as_their_manual_says() -> None:
    # The example of "Status Packet" in the manual: present position 166 of servo 1.
    example = bytes.fromhex("FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0")
    assert status_packet(1, 166) == example and crc16(example[:-2]) == 0xC08C
    # The example of "Sync Read": present positions of the servos 1 and 2.
    assert sync_read((1, 2)) == bytes.fromhex("FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA")
    arm = LeaderArm(
        ids=(1, 2), signs=(1, -1), offsets=(0, math.pi), gripper=LeaderGripper(id=3, open_deg=0, closed_deg=90)
    )
    device = DynamixelLeader({"arm": 2}, {"arm": arm})
    data = sync_read((1, 2, 3)) + status_packet(1, 1024) + status_packet(2, 1024) + status_packet(3, 512)
    found = [command for k in range(len(data)) for command in device.feed(data[k : k + 1], 0.5)]
    np.testing.assert_allclose(joint_targets(found), [[math.pi / 2, math.pi / 2]])
    assert found[-1] == GripperTarget("arm", 0.5) and not device.refused and device.heard_at == 0.5


def test_stuffed_positions_are_read() -> None:
    device = DynamixelLeader({"arm": 1}, {"arm": LeaderArm(ids=(4,))})
    position = struct.unpack("<i", b"\xff\xff\xfd\xff")[0]
    packet = status_packet(4, position)
    assert len(packet) == 16
    assert joint_targets(device.feed(packet, 0.0)) == [[pytest.approx(position / 4096 * 2 * math.pi)]]
    assert device.feed(status_packet(4, 2**31 - 1), 0.0) == [] and device.refused.total() == 1


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda data: data[:9] + b"\x01" + data[10:], "its check sum is wrong"),
        (lambda data: data[:-4], "its check sum is wrong"),  # the next packet begins too early
        (lambda data: b"noise" + data[5:], "there are bytes between packets"),
        (lambda data: data[:5] + b"\xff\xff" + data[7:], "its length is not that of a status packet"),
        (lambda data: status_packet(1, 0, error=3), "a servo reports an error"),
        (lambda data: status_packet(9, 0), "it is not the position of a servo of the leader"),
    ],
)
def test_damaged_packets_of_servos_are_refused_and_the_next_one_counts(
    damage: Callable[[bytes], bytes], reason: str
) -> None:
    device = DynamixelLeader({"arm": 1}, {"arm": LeaderArm(ids=(1,))})
    assert device.feed(damage(status_packet(1, 77)), 0.0) == []
    assert joint_targets(device.feed(status_packet(1, 2048), 0.1)) == [[pytest.approx(math.pi)]]
    assert reason in device.refused


def test_a_leader_with_a_dead_servo_gives_no_sign_of_life() -> None:
    device = DynamixelLeader(JOINTS, LEADER.arms)
    for k in range(30):
        for servo in (1, 2, 3, 5, 6, 7, 8):
            assert device.feed(status_packet(servo, 2048), k / 30) == []
    assert device.heard_at is None and not device.refused


# -- VR


def controller(p: Any, q: Any = (0, 0, 0, 1), **more: Any) -> bytes:
    return line(hand="right", position=list(p), orientation=list(q), **more)


def test_controllers_are_turned_to_the_axes_of_the_operator() -> None:
    device = VrDevice({"right": "arm"})
    still, moved = (device.feed(controller(p, squeeze=0.9), 0.0)[0] for p in ((0, 1, 0), (0.1, 1.05, -0.15)))
    assert isinstance(still, TrackedPose) and isinstance(moved, TrackedPose) and moved.is_engaged
    # 10 cm to the right, 5 cm up and 15 cm ahead of the person
    np.testing.assert_allclose(moved.X_OC.p - still.X_OC.p, [0.15, -0.1, 0.05], atol=1e-12)


def test_a_press_of_the_thumbstick_makes_the_direction_of_the_controller_forward() -> None:
    device = VrDevice({"right": "arm"})
    left = Pose.about(np.array([0.0, 1.0, 0.0]), math.pi / 2).q  # the controller points to the left of the headset
    q = [*left[1:], left[0]]
    device.feed(controller((0, 1, 0), q, squeeze=1, buttons=[3]), 0.0)
    (before, *_) = device.feed(controller((0, 1, 0), q, squeeze=1), 0.1)
    (after, *_) = device.feed(controller((-0.1, 1, 0), q, squeeze=1), 0.2)
    assert isinstance(before, TrackedPose) and isinstance(after, TrackedPose)
    np.testing.assert_allclose(after.X_OC.p - before.X_OC.p, [0.1, 0, 0], atol=1e-12)


def test_the_clutch_has_play_and_the_trigger_grips_only_while_it_is_engaged() -> None:
    device = VrDevice({"right": "arm"})
    engaged = []
    for squeeze in (0.5, 0.7, 0.5, 0.3, 0.5):
        commands = device.feed(controller((0, 1, 0), squeeze=squeeze, trigger=0.8), 0.0)
        engaged.append(any(isinstance(c, TrackedPose) and c.is_engaged for c in commands))
        assert any(isinstance(c, GripperTarget) for c in commands) == engaged[-1]
    assert engaged == [False, True, True, False, False]
    assert device.feed(controller((0, 1, 0), buttons=[4, 5]), 0.1)[:2] == [
        ControlPress(Control.SAVE), ControlPress(Control.DISCARD),
    ]  # fmt: skip
    assert device.feed(controller((5, 1, 0)), 0.2) == []
    assert device.feed(controller((0, 1, 0), (0, 0, 0, 0)), 0.2) == []
    assert device.feed(line(hand="third", position=[0, 0, 0], orientation=[0, 0, 0, 1]), 0.2) == []
    assert device.refused.total() == 3


def test_hands_move_the_robots_that_are_named_after_them() -> None:
    assert robots_of_hands(("arm",)) == {"right": "arm"}
    assert robots_of_hands(("Left_arm", "right_arm")) == {"left": "Left_arm", "right": "right_arm"}
    assert robots_of_hands(("a", "b")) == {"right": "a", "left": "b"}


# -- all of them

EVERY: dict[str, Callable[[], TeleopDevice]] = {
    "keyboard": lambda: KeyboardDevice(0.2, 0.8),
    "gizmo": GizmoDevice,
    "spacemouse": lambda: SpaceMouseDevice(0.2, 0.8),
    "joints": lambda: JsonLeader(JOINTS),
    "dynamixel": lambda: DynamixelLeader(JOINTS, LEADER.arms),
    "vr": lambda: VrDevice({"right": "arm"}),
}


@pytest.mark.parametrize("name", EVERY)
def test_no_bytes_crash_a_device_or_fill_the_memory(name: str) -> None:
    """Random bytes, and packets of all devices with random damage; what is not finite never becomes a command."""
    device, rng = EVERY[name](), random.Random(name)
    good = [
        line(keys=["KeyW"]), line(pose=[0, 0, 0, 1, 0, 0, 0]), spacemouse.translation_report(1, 2, 3),
        line(joints=[0] * 7), status_packet(1, 5), controller((0, 1, 0), squeeze=1), sync_read((1, 2)),
    ]  # fmt: skip
    for k in range(1500):
        data = bytearray(rng.choice(good) if rng.random() < 0.7 else rng.randbytes(rng.randrange(300)))
        for _ in range(rng.randrange(4)):
            if data:
                data[rng.randrange(len(data))] = rng.randrange(256)
        for command in device.feed(bytes(data[: rng.randrange(len(data) + 1)]), k / 100):
            values = [v for v in vars(command).values() if isinstance(v, np.ndarray | float)]
            assert all(np.isfinite(v).all() for v in values)
    held = sum(len(v) for v in vars(device).values() if isinstance(v, bytes))
    assert device.refused.total() > 0 and len(device.refused) < 400 and held <= MAX_PACKET
