"""Streams: a session is repeated from its stream, to the same bytes, and no stream can do anything else."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Sequence
from pathlib import Path

import pytest

import simfoundry as sf
from simfoundry.errors import SimfoundryError
from simfoundry.teleop.commands import Control, ControlPress, JointTargets, TrackedPose
from simfoundry.teleop.devices.joints import JsonLeader
from simfoundry.teleop.devices.vr import VrDevice
from simfoundry.teleop.leader import load_leader
from simfoundry.teleop.run import TeleopReport, replay_session
from simfoundry.teleop.settings import DeviceOptions
from simfoundry.teleop.stream import (
    PacketEvent,
    PressEvent,
    StreamEvent,
    StreamHeader,
    TickEvent,
    read_stream,
    write_stream,
)
from tests.cli.command import run
from tests.conftest import REPOSITORY
from tests.teleop import streams
from tests.teleop.streams import FOLDER, LEADER, STREAMS, stream_file


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_the_streams_are_those_that_the_script_writes(tmp_path: Path) -> None:
    streams.write(tmp_path)
    for name in STREAMS:
        assert stream_file(tmp_path, name).read_text() == stream_file(FOLDER, name).read_text()


@pytest.mark.parametrize("name", STREAMS)
def test_a_stream_of_each_device_drives_a_rollout_to_the_same_bytes_twice(
    name: str, touch: Path, tmp_path: Path
) -> None:
    reports = [replay_session(touch, stream_file(FOLDER, name), tmp_path / part / "demos", 1) for part in "ab"]
    assert reports[0] == reports[1] and bytes_of(tmp_path / "a") == bytes_of(tmp_path / "b")
    report = reports[0]
    assert (report.summary.kept, report.summary.saved, report.summary.failures) == (1, 1, {})
    assert not report.refused and report.action_hz == 30
    (demo,) = sf.demonstrations(tmp_path / "a/demos")
    assert (demo.trajectory,) == report.summary.digests
    assert str(demo.action_space) == {
        "joints": "joint_position",
        "gizmo": "hand_pose:world",
        "vr": "hand_pose:world",
    }.get(STREAMS[name][0], "hand_delta:world")
    assert demo.action_hz == 30 and demo.steps <= 60 and (demo.subtasks["reach"] or 99) <= demo.steps - 2
    moved = demo.states["arm/hand"][-1] - demo.states["arm/hand"][0]
    assert 0.05 < moved[0] < 0.2 and abs(moved[1]) < 0.03 and abs(moved[2]) < 0.03
    gripper = demo.states["arm/gripper"][-1, 0]
    assert gripper == pytest.approx({"keyboard": 1, "spacemouse": 1, "gizmo": 0, "vr": 0}.get(name, gripper), abs=0.05)


def make(path: Path, events: list[StreamEvent], device: str = "keyboard", task: str = "touch") -> Path:
    write_stream(path, StreamHeader(device, task, 0, 30.0, DeviceOptions().model_dump(exclude_none=True)), events)
    return path


def keys(time: float, *held: str) -> PacketEvent:
    return PacketEvent(time, json.dumps({"keys": held}).encode())


def replayed(touch: Path, tmp_path: Path, events: Sequence[StreamEvent], count: int = 5) -> TeleopReport:
    return replay_session(touch, make(tmp_path / "s.jsonl", list(events)), tmp_path / "demos", count)


def test_marks_retries_and_discards_are_kept(touch: Path, tmp_path: Path) -> None:
    forward = [keys(k / 30, "KeyW") for k in range(60)]
    last = forward[-1].time
    events: list[StreamEvent] = [
        *forward[:20], PressEvent(20 / 30, Control.RETRY),
        *[keys(each.time + 1, "KeyW") for each in forward[:5]], PressEvent(1.2, Control.DISCARD),
        *[keys(each.time + 2, "KeyW") for each in forward[:15]], keys(2.5, "KeyW", "KeyM"),
        *[keys(each.time + 3, "KeyW") for each in forward], PressEvent(last + 3, Control.SAVE),
    ]  # fmt: skip
    report = replayed(touch, tmp_path, events, 1)
    summary = report.summary
    assert (summary.kept, summary.attempts, summary.retries, summary.failures) == (1, 2, 1, {"discarded": 1})
    (demo,) = sf.demonstrations(tmp_path / "demos")
    assert demo.index == 1 and demo.start.index == 1
    ((mark,),) = [demo.marks]
    assert mark.name == "reach" and 0 < mark.step < demo.steps
    assert demo.device == "keyboard"
    first, _ = attempts_of(tmp_path / "demos")
    assert (first["end"], first["kept"], first["device"]) == ("discarded", False, "keyboard")


def attempts_of(folder: Path) -> list[dict[str, object]]:
    from simfoundry.data.store import read_shards

    return [dict(attempt.about) for _, found in read_shards(folder) for attempt in found]


def test_a_pause_takes_no_time(touch: Path, tmp_path: Path) -> None:
    events = [keys(k / 30, "KeyW") for k in range(60)]
    paused: list[StreamEvent] = [
        *events[:10], PressEvent(10 / 30, Control.PAUSE), keys(5.0, "KeyW"), PressEvent(9.0, Control.PAUSE),
        *[keys(each.time + 9, "KeyW") for each in events],
    ]  # fmt: skip
    plain = replayed(touch, tmp_path / "a", [*events])
    assert replayed(touch, tmp_path / "b", paused).summary.digests == plain.summary.digests


def test_silence_pauses_and_releases_the_keys(touch: Path, tmp_path: Path) -> None:
    """The page is silent for 3 s while W is held; without a pause, the hand would reach the block in that time."""
    events = [*[keys(k / 30, "KeyW") for k in range(10)], keys(4.0), keys(4.1)]
    report = replayed(touch, tmp_path, events, 1)
    assert report.summary.failures == {"horizon": 1}


def test_a_tap_that_is_shorter_than_an_action_moves_the_hand(touch: Path, tmp_path: Path) -> None:
    still, tapped = (
        replayed(touch, tmp_path / name, [keys(0.0), *events, keys(1.0)], 1)
        for name, events in (("a", []), ("b", [keys(0.501, "KeyW"), keys(0.509)]))
    )
    assert still.summary.digests != tapped.summary.digests


def test_ticks_decide_when_there_are_any(touch: Path, tmp_path: Path) -> None:
    """A session whose actions were late gives the same rollout, whatever the times."""
    events: list[StreamEvent] = []
    for k in range(60):
        events += [keys(k / 30, "KeyW"), TickEvent(k / 30)]
    late = [type(each)(2 * each.time, *list(vars(each).values())[1:]) for each in events]
    digests = {
        replayed(touch, tmp_path / name, list(each)).summary.digests for name, each in (("a", events), ("b", late))
    }
    assert len(digests) == 1


def test_several_devices_fill_one_folder(touch: Path, tmp_path: Path) -> None:
    for k, name in enumerate(("keyboard", "joints"), 1):
        assert replay_session(touch, stream_file(FOLDER, name), tmp_path / "demos", k).summary.kept == k
    first, second = sf.demonstrations(tmp_path / "demos")
    assert (first.device, second.device) == ("keyboard", "joints") and first.action_space != second.action_space


@pytest.mark.parametrize(
    ("lines", "reason"),
    [
        ("", "Expecting value"),
        ('{"simfoundry": "teleop_stream/1", "device": "vr"}', "its first line does not state the device, the task"),
        ("FAST\n", "its first line does not state the device, the task, the seed, the frequency"),
        ("{}\n", "its first line does not state the format"),
        ('HEAD\n{"t": 1, "text": "x"}\n{"t": 0.5, "text": "x"}\n', "line 3 is not valid: its time is before"),
        ('HEAD\n{"t": NaN, "text": "x"}\n', "line 2 is not valid: `t` is not a time"),
        ('HEAD\n{"t": 0, "hex": "0g"}\n', "line 2 is not valid: non-hexadecimal"),
        ('HEAD\n{"t": 0, "press": "explode"}\n', "line 2 is not valid: 'explode' is not a valid Control"),
        ('HEAD\n{"t": 0, "start": -1}\n', "line 2 is not valid: `start` is not an event, or has no valid value"),
        ('HEAD\n{"t": 0, "text": "x", "hex": ""}\n', "line 2 is not valid: it is not an event with a time"),
        ('HEAD\n{"t": 0, "text": "' + "x" * 20000 + '"}\n', "line 2 is not valid: it is longer than 16384 characters"),
        ("HEAD\n" + "[" * 9000 + "\n", "line 2 is not valid"),
        ("\x00\xff", "codec can't decode"),
    ],
)
def test_files_that_are_no_streams_are_refused_in_a_sentence(lines: str, reason: str, tmp_path: Path) -> None:
    head = make(tmp_path / "head.jsonl", []).read_text().strip()
    path = tmp_path / "bad.jsonl"
    lines = lines.replace("HEAD", head).replace("FAST", head.replace("30.0", "1000"))
    path.write_bytes(lines.encode("latin-1"))
    with pytest.raises(SimfoundryError, match=r"bad\.jsonl is not a stream") as caught:
        read_stream(path)
    assert reason in str(caught.value)


def test_a_killed_session_leaves_a_stream_that_can_be_read(tmp_path: Path) -> None:
    path = make(tmp_path / "s.jsonl", [keys(0.0), keys(0.1)])
    path.write_text(path.read_text()[:-4])
    assert len(read_stream(path)[1]) == 1


def test_streams_of_another_task_start_or_device_are_refused(touch: Path, tmp_path: Path) -> None:
    for name, options, reason in (
        ("a", {"task": "other"}, "was recorded for the task `other`, not for `touch`"),
        ("b", {"device": "theremin"}, "there is no device `theremin`"),
    ):
        path = make(tmp_path / f"{name}.jsonl", [keys(0.0)], **options)
        with pytest.raises(SimfoundryError, match=reason):
            replay_session(touch, path, tmp_path / "demos", 1)
    path = tmp_path / "start.jsonl"
    path.write_text(make(tmp_path / "head.jsonl", []).read_text() + '{"t": 0, "start": 3}\n')
    with pytest.raises(SimfoundryError, match="recorded at initial state 3, but the next one here is 0"):
        replay_session(touch, path, tmp_path / "demos", 1)


def test_a_leader_of_the_wrong_size_is_refused_in_one_sentence(touch: Path, tmp_path: Path) -> None:
    six = [PacketEvent(k / 30, json.dumps({"joints": [0.0] * 6}).encode() + b"\n") for k in range(30)]
    path = make(tmp_path / "six.jsonl", list(six), "joints")
    done = run("teleop", touch, "--replay-stream", path, "-o", tmp_path / "demos", "-n", "1")
    assert done.code == 2
    done.one_line("the leader arm sent no valid packet; 30 were refused, 30 of them because", "6 numbers instead of 7")


def test_the_command_replays_a_stream(touch: Path, tmp_path: Path) -> None:
    words: list[str | Path] = ["--replay-stream", stream_file(FOLDER, "keyboard"), "-o", tmp_path / "demos"]
    done = run("teleop", touch, *words, "--json")
    assert done.code == 0, done.err
    assert (done.json["device"], done.json["saved"], done.json["demonstrations"]) == ("keyboard", 1, 1)
    assert run("teleop", touch, *words, "--speed", "0.3").code == 2
    assert "has no effect with --replay-stream" in run("teleop", touch, *words, "--speed", "0.3").err


# -- the examples of docs/teleoperation.md

PAGE = (REPOSITORY / "docs" / "teleoperation.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def test_the_packets_on_the_page_are_valid() -> None:
    leader, controller = (text.encode() for text in blocks("json"))
    device = JsonLeader({"left": 7, "right": 7})
    joints, _, press = device.feed(leader, 0.0)
    assert isinstance(joints, JointTargets) and press == ControlPress(Control.MARK)
    vr = VrDevice({"right": "arm"})
    save, pose, _ = vr.feed(controller, 0.0)
    assert save == ControlPress(Control.SAVE) and isinstance(pose, TrackedPose) and not vr.refused


def test_the_leader_on_the_page_is_that_of_the_streams(tmp_path: Path) -> None:
    path = tmp_path / "leader.yaml"
    path.write_text(*blocks("yaml"))
    spec = load_leader(path, {"arm": 7})
    assert spec.arms["arm"].servos == LEADER.arms["arm"].servos
    assert spec.arms["arm"].offsets == pytest.approx(LEADER.arms["arm"].offsets, abs=1e-4)


def test_a_program_writes_a_stream_that_is_replayed(
    touch: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in touch.parent.glob("*.yaml"):
        shutil.copy(path, tmp_path)
    monkeypatch.chdir(tmp_path)
    write, read = blocks("python")
    exec(write, {})
    (line,) = re.findall(r"^simfoundry (teleop .*--replay-stream.*)$", PAGE, re.MULTILINE)
    assert run(*line.split()).code == 0
    exec(read, {})
    assert capsys.readouterr().out.endswith("keyboard hand_delta:world 30.0 ()\n")
    first, again = (Path(folder) / "shards/00000.npz" for folder in ("demos", "again"))
    assert first.read_bytes() == again.read_bytes() and len(sf.demonstrations("again")) == 1


def test_a_leader_that_does_not_fit_the_robot_is_refused(touch: Path, tmp_path: Path) -> None:
    text = (stream_file(FOLDER, "dynamixel")).read_text()
    for old, new, reason in (
        ('"arms": {"arm"', '"arms": {"other"', "describes a leader of `other`; the task has arm"),
        ('"ids": [1, 2, 3, 4, 5, 6, 7]', '"ids": [1, 2, 3, 4, 5, 6, 8]', "the numbers of servos must differ"),
        ('"ids": [1, 2', '"ids": [0, 2', "lie between 1 and 252"),
        ('"closed_deg": 158.0', '"closed_deg": 200.0', "`open_deg` and `closed_deg` must differ"),
    ):
        path = tmp_path / "bad.jsonl"
        assert old in text
        path.write_text(text.replace(old, new))
        with pytest.raises(SimfoundryError, match=reason):
            replay_session(touch, path, tmp_path / "demos", 1)


@pytest.mark.parametrize("hz", [1, 7, 44, 200])
def test_every_rate_of_actions_is_replayed(hz: int, touch: Path, tmp_path: Path) -> None:
    events = [keys(k / 30, "KeyW") for k in range(100)]
    path = tmp_path / "s.jsonl"
    path.write_text(
        make(tmp_path / "30.jsonl", list(events)).read_text().replace('"control_hz": 30.0', f'"control_hz": {hz}')
    )
    report = replay_session(touch, path, tmp_path / "demos", 1)
    assert report.action_hz == hz and report.summary.attempts == 1
    if report.summary.kept:
        assert sf.demonstrations(tmp_path / "demos")[0].action_hz == hz


def test_a_session_that_was_killed_ends_its_replay(touch: Path, tmp_path: Path) -> None:
    events: list[StreamEvent] = []
    for k in range(10):
        events += [keys(k / 30, "KeyW"), TickEvent(k / 30)]
    summary = replayed(touch, tmp_path / "a", events).summary
    assert summary.was_ended and summary.attempts == 0 and summary.digests == ()
    paused = replayed(touch, tmp_path / "b", [*events, PressEvent(1.0, Control.PAUSE)]).summary
    assert paused.was_ended and paused.attempts == 0
