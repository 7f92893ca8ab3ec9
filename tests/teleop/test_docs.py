"""The examples of docs/teleoperation.md."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

import simfoundry as sf
from simfoundry.teleop.commands import Control, ControlPress, JointTargets, TrackedPose
from simfoundry.teleop.devices.joints import JsonLeader
from simfoundry.teleop.devices.vr import VrDevice
from simfoundry.teleop.leader import load_leader
from tests.cli.command import run
from tests.conftest import REPOSITORY
from tests.teleop.streams import LEADER

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
