"""``simfoundry capture`` on a good capture: without PyBullet, killed half-way, run again."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from simfoundry.capture.synthesize import synthesize
from simfoundry.scene.lower import lower_file
from simfoundry.worlds.settle import SettleOptions, settle
from tests.cli.command import MAIN, Done, python, run, without
from tests.conftest import REPOSITORY

SCENE = """\
simfoundry: scene/1
name: small
objects:
  desk: {fixed: true, shape: {box: [0.9, 0.7, 0.03]}, color: [0.7, 0.55, 0.4], pose: {xyz: [0, 0, -0.015]}}
  tea: {shape: {box: [0.12, 0.09, 0.1]}, mass: 0.2, color: [0.2, 0.5, 0.25], pose: {xyz: [0.05, 0, 0.05], yaw_deg: 31}}
cameras:
  view: {size: [240, 180], fx: 229, fy: 229, pose: {xyz: [-0.6, 0.1, 0.6], look_at: [0.02, 0, 0.02]}}
lights: {key: {type: distant, direction: [0.5, -0.35, -1]}, sky: {type: dome, intensity: 0.45}}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    tmp = tmp_path_factory.mktemp("capture")
    (tmp / "small.scene.yaml").write_text(SCENE)
    scene = lower_file(tmp / "small.scene.yaml")
    synthesize(scene, scene.cameras[0], tmp / "capture", seed=0, masks=True)
    return tmp


@pytest.fixture(scope="module")
def first(folder: Path) -> Done:
    """A run where PyBullet is not installed."""
    cache = {"SIMFOUNDRY_CACHE": str(folder / "cache")}
    return python(without("pybullet"), "capture", folder / "capture", "-o", folder / "out", "--json", **cache)


def tree(folder: Path) -> dict[str, bytes]:
    """The output, without the results of stages, which a later run reuses."""
    files = sorted(p for p in folder.rglob("*") if p.is_file() and "stages" not in p.relative_to(folder).parts)
    return {str(p.relative_to(folder)): p.read_bytes() for p in files}


@pytest.mark.slow  # 3 s
def test_capture_works_without_pybullet(folder: Path, first: Done) -> None:
    assert first.code == 0 and first.err == ""
    assert first.json["passed"] is True and list(first.json["objects"]) == ["green_box"]
    scene = lower_file(Path(first.json["scene"]))
    box = scene.object("green_box")
    truth = lower_file(folder / "small.scene.yaml").object("tea")
    for found, real in zip(sorted(box.links[0].com), sorted(truth.links[0].com), strict=True):
        assert abs(found - real) < 0.005
    assert (folder / "out" / "compare.png").is_file() and (folder / "out" / "report.json").is_file()


@pytest.mark.slow  # 6 s: another capture
@pytest.mark.usefixtures("first")
def test_a_killed_run_leaves_the_earlier_output_whole(folder: Path) -> None:
    """Killed at several moments, the last of them when its own output is being written."""
    before = tree(folder / "out")
    for delay in (0.3, 0.9, None):
        _killed(folder, delay)
        assert tree(folder / "out") == before
    assert json.loads(before["report.json"])["files"].keys() == before.keys() - {"report.json"}


def _killed(folder: Path, delay: float | None) -> None:
    """Run all stages and kill after ``delay`` seconds, or as soon as the staging folder holds a scene."""
    command = [sys.executable, "-c", MAIN, "capture", str(folder / "capture"), "-o", str(folder / "out")]
    command += ["--from", "frames"]  # a run that reuses all results takes less than a second
    env = {**os.environ, "PYTHONPATH": str(REPOSITORY), "SIMFOUNDRY_CACHE": str(folder / "cache")}
    process = subprocess.Popen(command, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    old, end = set(folder.glob(".out.*")), time.monotonic() + (60 if delay is None else delay)
    while time.monotonic() < end and process.poll() is None:
        if delay is None and any(list(f.glob("*.yaml")) for f in set(folder.glob(".out.*")) - old):
            break
        time.sleep(0.005)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert process.returncode == -signal.SIGKILL


@pytest.mark.slow  # 6 s: another capture
@pytest.mark.usefixtures("first")
def test_running_again_replaces_what_a_run_wrote_by_the_same_bytes(folder: Path) -> None:
    """In a process with another hash seed and an empty cache."""
    before = tree(folder / "out")
    env = {"SIMFOUNDRY_CACHE": str(folder / "empty_cache"), "PYTHONHASHSEED": "7"}
    done = python(MAIN, "capture", folder / "capture", "-o", folder / "out", **env)
    assert done.code == 0 and done.err == "" and "[ok]" in done.out
    assert tree(folder / "out") == before


def test_what_does_not_rest_gives_1_unless_it_is_accepted(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same capture, with nothing allowed to move at all."""
    strict = partial(settle, options=SettleOptions(max_drift_m=-1.0))
    monkeypatch.setattr("simfoundry.capture.settling.standing.settle", strict)
    monkeypatch.setenv("SIMFOUNDRY_CACHE", str(folder / "cache"))
    done = run("capture", folder / "capture", "-o", folder / "strict", "--json")
    assert done.code == 1 and done.err == "" and done.json["passed"] is False
    (finding,) = done.json["findings"]
    assert (finding["code"], finding["objects"], finding["accepted"]) == ("SF603", ["green_box"], False)
    assert done.json["objects"]["green_box"]["settle"]["problems"] == [finding["message"]]
    assert (folder / "strict" / "capture.scene.yaml").is_file()  # it is written all the same
    accepted = run("capture", folder / "capture", "-o", folder / "strict", "--accept", "sf603")
    assert accepted.code == 0 and "green_box: SF603" in accepted.out and "(accepted)" in accepted.out
    report = json.loads((folder / "strict" / "report.json").read_text())
    assert report["passed"] is True and report["findings"] == [{**finding, "accepted": True}]


def test_only_doubts_can_be_accepted(folder: Path) -> None:
    done = run("capture", folder / "capture", "-o", folder / "none", "--accept", "SF501")
    assert done.code == 2 and "`SF501` is not a finding of a reconstruction" in done.err
