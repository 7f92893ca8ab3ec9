"""Write the streams of the tests: ``python -m tests.teleop.streams``.

Nobody held these devices. Each stream consists of packets in the format that the device's documentation states, as a
person might have sent them in two seconds: the hand moves forward from above the table until it touches the block. Real
devices send more noise, and were not available.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from simfoundry.geometry.frames import Array, Pose, to_xyzw
from simfoundry.teleop.devices import spacemouse
from simfoundry.teleop.devices.dynamixel import TURN, status_packet
from simfoundry.teleop.devices.vr import R_OX
from simfoundry.teleop.leader import LeaderArm, LeaderGripper, LeaderSpec
from simfoundry.teleop.settings import DeviceOptions, TeleopSettings
from simfoundry.teleop.stream import PacketEvent, StreamEvent, StreamHeader, write_stream

FOLDER = Path(__file__).parent / "streams"

SCENE = """\
simfoundry: scene/1
name: bench
materials:
  wood: {density: 300, friction: 0.4}
objects:
  table: {fixed: true, shape: {box: [1.2, 1.2, 0.04]}, material: wood, pose: {xyz: [0.4, 0, -0.02]}}
  block: {shape: {box: [0.2, 0.3, 0.5]}, material: wood, place: {on: table, xy: [0.62, 0]}}
robots:
  arm: {model: demo_arm}
cameras:
  front: {size: [640, 480], fx: 500, fy: 500, pose: {xyz: [1.3, 0, 0.7], look_at: [0.3, 0, 0]}}
relations: [OnTop(block, table)]
"""

TASK = """\
simfoundry: task/1
name: touch
scene: bench.scene.yaml
instruction: Touch the block.
goal: Touching(arm, block)
subtasks:
  reach: {goal: Touching(arm, block)}
reset:
  objects:
    block: {x: [0.61, 0.63], y: [-0.01, 0.01]}
horizon: 60
"""

ROBOT = "arm"

# Pose of the hand at the start, and how far it moves forward [m].
X_WH = Pose.of((0.3819, 0.0, 0.4852), (0.0, -1.0, 0.0, 0.0))
FORWARD = 0.2

# Positions of the joints at the start, and 20 cm ahead [rad].
HOME = np.array([0, 0, 0, 2, 0, 1.141593, 0])
AHEAD = np.array([0, 0.4315, 0, 1.4653, 0, 1.2449, 0])

LEADER = LeaderSpec(
    arms={
        ROBOT: LeaderArm(
            ids=(1, 2, 3, 4, 5, 6, 7),
            signs=(1, -1, 1, 1, 1, -1, 1),
            offsets=(0, math.pi, 0, -math.pi / 2, 0, 0, math.pi),
            gripper=LeaderGripper(id=8, open_deg=200, closed_deg=158),
        )
    }
)


def write_bench(folder: Path) -> Path:
    """Write the task of the streams to a folder, and return its document."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "bench.scene.yaml").write_text(SCENE)
    path = folder / "touch.task.yaml"
    path.write_text(TASK)
    return path


def _times(hz: float, seconds: float) -> Iterator[tuple[float, float]]:
    """Yield times, and the share of the motion at each of them, which is smooth."""
    for k in range(round(hz * seconds) + 1):
        yield k / hz, 0.5 - 0.5 * math.cos(math.pi * min(1.0, k / hz / seconds))


def _line(**content: object) -> bytes:
    return json.dumps(content).encode()


def keyboard() -> list[StreamEvent]:
    """Forward, then with a little to the left, and the gripper in between."""
    held = {0: [], 2: ["KeyW"], 20: ["KeyW", "Space"], 22: ["KeyW"], 40: ["KeyW", "KeyA"], 44: ["KeyW"], 60: []}
    events: list[StreamEvent] = []
    keys: list[str] = []
    for k in range(70):
        keys = held.get(k, keys)
        events.append(PacketEvent(k / 30, _line(keys=keys)))
    return events


def gizmo() -> list[StreamEvent]:
    """One drag of the arrow that points forward."""
    events: list[StreamEvent] = []
    for time, share in _times(30, 2):
        pose = Pose.of(X_WH.p + [FORWARD * share, 0, 0], X_WH.q)
        numbers = [round(float(v), 5) for v in (*pose.p, *pose.q)]
        events += [PacketEvent(time, _line(keys=[])), PacketEvent(time, _line(robot=ROBOT, pose=numbers))]
    return [*events, PacketEvent(events[-1].time, _line(robot=ROBOT, pose=None))]


def space_mouse() -> list[StreamEvent]:
    """Push the cap forward, with some yaw, and press the first button."""
    events: list[StreamEvent] = [
        PacketEvent(0, spacemouse.button_report(0)),
        PacketEvent(0.02, spacemouse.button_report()),
    ]
    for time, share in _times(60, 1.6):
        push = round(-350 * math.sin(math.pi * min(1.0, 1.5 * share + 0.2)))
        events.append(PacketEvent(0.03 + time, spacemouse.translation_report(4, push, -3)))
        events.append(PacketEvent(0.03 + time, spacemouse.rotation_report(2, -6, 40)))
    end = events[-1].time + 0.016
    return [
        *events,
        *(PacketEvent(end, report(0, 0, 0)) for report in (spacemouse.translation_report, spacemouse.rotation_report)),
    ]


def _joints(share: float) -> Array:
    return np.asarray(HOME + share * (AHEAD - HOME))


def joints() -> list[StreamEvent]:
    """A leader that sends lines of JSON, two of which arrive in several parts."""
    events: list[StreamEvent] = []
    for time, share in _times(60, 2):
        values = [round(float(v), 4) for v in _joints(share)]
        line = _line(joints=values, gripper=round(share, 3)) + b"\n"
        cut = len(line) // 3
        parts = (line[:cut], line[cut:]) if round(time * 60) % 50 == 10 else (line,)
        events += [PacketEvent(time, part) for part in parts]
    return events


def dynamixel() -> list[StreamEvent]:
    """The servos of a leader arm, which answer one after another; serial lines join and split their packets."""
    arm = LEADER.arms[ROBOT]
    assert arm.gripper is not None
    events: list[StreamEvent] = []
    for time, share in _times(30, 2):
        angles = _joints(share) * np.array(arm.signs) + np.array(arm.offsets)
        grip = math.radians(arm.gripper.open_deg + share * (arm.gripper.closed_deg - arm.gripper.open_deg))
        data = b"".join(
            status_packet(servo, round(float(angle) / (2 * math.pi) * TURN))
            for servo, angle in zip(arm.servos, (*angles, grip), strict=True)
        )
        cut = round(time * 30) % len(data)
        events += [PacketEvent(time, part) for part in (data[:cut], data[cut:]) if part]
    return events


def vr() -> list[StreamEvent]:
    """A controller of the right hand that is squeezed and moved forward, away from the person."""
    events: list[StreamEvent] = []
    for time, share in _times(72, 2):
        p_O = np.array([0.3 + 0.25 * share, -0.2, 1.1])
        X_XC = Pose.of(R_OX.T @ p_O, Pose.about(np.array([1.0, 0.0, 0.0]), -0.4 - 0.05 * share).q)
        content = {
            "position": [round(float(v), 4) for v in X_XC.p],
            "orientation": [round(float(v), 5) for v in to_xyzw(X_XC.q)],
        }
        events.append(
            PacketEvent(
                time, _line(hand="right", squeeze=float(time > 0.1), trigger=0.0, buttons=[], **content) + b"\n"
            )
        )
    return events


# The stream of each device: the name of the device, its options, and its events.
STREAMS = {
    "keyboard": ("keyboard", DeviceOptions(), keyboard),
    "gizmo": ("gizmo", DeviceOptions(), gizmo),
    "spacemouse": ("spacemouse", DeviceOptions(), space_mouse),
    "joints": ("joints", DeviceOptions(), joints),
    "dynamixel": ("joints", DeviceOptions(leader=LEADER), dynamixel),
    "vr": ("vr", DeviceOptions(), vr),
}


def stream_file(folder: Path, name: str) -> Path:
    """Return the path of a stream in a folder."""
    return folder / f"{name}.jsonl"


def write(folder: Path) -> None:
    """Write all streams to a folder."""
    for name, (device, options, events) in STREAMS.items():
        settings = TeleopSettings(device, 30.0, 0, options)
        found = sorted(events(), key=lambda event: event.time)
        header = StreamHeader(device, "touch", 0, 30.0, settings.options.model_dump(mode="json", exclude_none=True))
        path = stream_file(folder, name)
        path.unlink(missing_ok=True)
        write_stream(path, header, found)


if __name__ == "__main__":
    write(FOLDER)
