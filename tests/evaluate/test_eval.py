"""``simfoundry eval``: one command, its files, what it does not do again, and what it makes of a failing policy."""

from __future__ import annotations

import json
import re
import shutil
from importlib.metadata import version
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from simfoundry import __version__
from simfoundry.evaluate.entries import contenders
from simfoundry.evaluate.rollouts.videos import side_by_side, whole_picture
from simfoundry.evaluate.statistics.metrics import wilson
from simfoundry.evaluate.statistics.results import cells
from simfoundry.reports.evaluation import page
from tests.cli.command import run
from tests.evaluate.benches import TASK, write_bench
from tests.evaluate.test_pools import record

PUSH = np.column_stack([np.zeros(45), np.minimum(0.05 + 0.006 * np.arange(45), 0.22), np.zeros(45)])
"""Straight on, slowly, into the block."""


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the bench, its task and a recorded push."""
    folder = tmp_path_factory.mktemp("bench")
    write_bench(folder, TASK.replace("goal: At(block, 0.45, 0)", "goal: Touching(arm, block)", 1))
    np.save(folder / "push.npy", PUSH)
    np.save(folder / "still.npy", np.zeros((1, 3)))
    return folder


@pytest.fixture(scope="module")
def done(bench: Path) -> Path:
    """An evaluation of two policies."""
    out = bench / "out"
    result = run("eval", bench / "push.task.yaml", *_policies(bench), "-n", "4", "-o", out, "--no-video")
    assert result.code == 0, result.err
    assert "4/4  100%" in result.out
    return out


def _policies(bench: Path) -> list[str]:
    return ["-p", f"push=replay:{bench / 'push.npy'}", "-p", f"still=replay:{bench / 'still.npy'}"]


def _results(out: Path) -> dict[str, Any]:
    return dict(json.loads((out / "results.json").read_text()))


def test_scores_have_counts_intervals_steps_and_ends(done: Path) -> None:
    push, still = _results(done)["scores"]
    assert (push["policy"], push["successes"], push["rollouts"], push["rate"]) == ("push", 4, 4, 1.0)
    assert push["interval"] == pytest.approx(list(wilson(4, 4)), abs=1e-6)
    assert push["subtasks"]["touch"]["done"] == 4 and push["ends"] == {"success": 4}
    assert (still["successes"], still["ends"], still["subtasks"]["touch"]["done"]) == (0, {"horizon": 4}, 0)


def test_policies_begin_alike_in_cells_of_their_own(done: Path) -> None:
    rollouts = _results(done)["rollouts"]
    by_policy = {name: [r for r in rollouts if r["policy"] == name] for name in ("push", "still")}
    for mine, other in zip(by_policy["push"], by_policy["still"], strict=True):
        assert mine["start"] == other["start"] and mine["cells"] == other["cells"]
    for name in ("block", "dish"):
        assert len({tuple(r["cells"][name]) for r in by_policy["push"]}) == 4


def test_a_second_run_does_nothing_and_a_lost_rollout_comes_back_the_same(bench: Path, done: Path) -> None:
    before = (done / "results.json").read_bytes()
    files = {p: p.stat().st_mtime_ns for p in (done / "rollouts").rglob("*")}
    lost = done / "rollouts/push/push/mujoco/002.json"
    command: tuple[str | Path, ...] = (
        "eval",
        bench / "push.task.yaml",
        *_policies(bench),
        "-n",
        "4",
        "-o",
        done,
        "--no-video",
    )
    assert run(*command).code == 0
    assert {p: p.stat().st_mtime_ns for p in (done / "rollouts").rglob("*")} == files
    lost.unlink()
    assert run(*command).code == 0
    assert lost.exists() and (done / "results.json").read_bytes() == before


@pytest.mark.slow  # 3 s
def test_shards_and_processes_give_what_one_run_gives(bench: Path, done: Path, tmp_path: Path) -> None:
    command = ["eval", str(bench / "push.task.yaml"), *_policies(bench), "-n", "4", "-o", str(tmp_path), "--no-video"]
    first = run(*command, "--shard", "1/2")
    assert first.code == 0 and len(_results(tmp_path)["rollouts"]) == 4
    second = run(*command, "--shard", "2/2", "-j", "2")
    assert second.code == 0, second.err
    ours, theirs = _results(tmp_path), _results(done)
    assert ours == theirs


@pytest.mark.slow  # 2 s
def test_videos_play_and_the_page_shows_grids_and_links(bench: Path, tmp_path: Path) -> None:
    command: tuple[str | Path, ...] = (
        "eval",
        bench / "push.task.yaml",
        _policies(bench)[0],
        _policies(bench)[1],
        "-n",
        "1",
        "-o",
        tmp_path,
    )
    assert run(*command, "--camera", "front", "--camera", "tip").code == 0
    record = _results(tmp_path)["rollouts"][0]
    video = cv2.VideoCapture(str(tmp_path / record["video"]))
    ok, frame = video.read()
    assert ok and frame.shape == (240, 640, 3) and frame.std() > 5
    text = (tmp_path / "report.html").read_text()
    assert text.count("<video") == 1 and text.count("<figure>") == 3 and "rollouts/push/push/mujoco/000.webm" in text


@pytest.mark.parametrize(
    ("camera", "shown"),
    [((1280, 720), (426, 240)), ((640, 480), (320, 240)), ((480, 640), (180, 240)), ((4000, 500), (640, 80))],
)
def test_a_video_shows_all_that_a_camera_sees(camera: tuple[int, int], shown: tuple[int, int]) -> None:
    size = whole_picture(*camera)
    assert (size.width, size.height) == shown
    row = side_by_side([np.full((size.height, size.width, 3), 9, np.uint8), np.full((240, 10, 3), 7, np.uint8)])
    assert row.shape == (240, size.width + 10, 3)


def test_a_recorded_rollout_replays_to_the_same_trajectory(bench: Path, done: Path, tmp_path: Path) -> None:
    recorded = _results(done)["rollouts"][0]
    replay = f"again=replay:{done / 'rollouts/push/push/mujoco/000.npz'}"
    assert run("eval", bench / "push.task.yaml", "-p", replay, "-n", "1", "-o", tmp_path, "--no-video").code == 0
    assert _results(tmp_path)["rollouts"][0]["trajectory"] == recorded["trajectory"]


def test_a_step_alone_and_the_rest_from_a_step(bench: Path, tmp_path: Path) -> None:
    command: list[str | Path] = [
        "eval",
        bench / "push.task.yaml",
        _policies(bench)[0],
        _policies(bench)[1],
        "-n",
        "1",
        "--no-video",
        "-o",
        tmp_path,
    ]
    assert run(*command, "--subtasks").code == 0
    assert [s["task"] for s in _results(tmp_path)["scores"]] == ["push", "push.away"]
    assert run(*command, "--from", "away").code == 0
    assert [s.get("from") for s in _results(tmp_path)["scores"]] == [None, "away", None]
    result = run(*command, "--step", "awya")
    assert result.code == 2 and "has no sub-task `awya`" in result.err and "away" in result.err


def test_another_evaluation_in_the_same_folder_is_refused(bench: Path, done: Path) -> None:
    result = run("eval", bench / "push.task.yaml", *_policies(bench), "-n", "4", "-o", done, "--seed", "3")
    assert result.code == 2 and "a different evaluation: its start is" in result.err


def test_a_folder_of_an_earlier_version_is_refused(bench: Path, tmp_path: Path) -> None:
    (tmp_path / "rollouts/push/still").mkdir(parents=True)
    (tmp_path / "rollouts/push/still/000.json").write_text("{}")
    result = run("eval", bench / "push.task.yaml", *_policies(bench)[2:], "-n", "1", "-o", tmp_path, "--no-video")
    assert result.code == 2 and "did not use a separate folder per engine; choose a different folder" in result.err
    assert not list((tmp_path / "rollouts").glob("*/*/*/*"))  # said before the first rollout


def test_a_policy_that_fails_is_recorded_given_up_and_tried_again(bench: Path, tmp_path: Path) -> None:
    task: tuple[str | Path, ...] = ("eval", bench / "push.task.yaml", "--no-video", "-o", tmp_path, "-n", "5")
    nobody = "simfoundry: policy/1\nname: gone\nprotocol: openpi\naddress: localhost:1\naction_space: joint_position\n"
    (tmp_path / "gone.policy.yaml").write_text(f"{nobody}horizon: 8\ncameras: {{}}\nretries: 0\ntimeout: 0.2\n")
    result = run(*task, "-p", tmp_path / "gone.policy.yaml", "-p", _policies(bench)[3])
    assert result.code == 1 and "gone, rollout 0 is missing: could not reach a server at" in result.err
    assert "5 rollouts are missing" in result.err
    assert len(list((tmp_path / "rollouts/push/gone/mujoco").glob("*.missing.json"))) == 3  # then it was given up
    scores = _results(tmp_path)["scores"]
    assert [(s["policy"], s["successes"], s["rollouts"], s["missing"]) for s in scores] == [
        ("gone", 0, 0, 5), ("still", 0, 5, 0)
    ]  # fmt: skip


def test_what_cannot_be_is_said_before_the_first_rollout(bench: Path, tmp_path: Path) -> None:
    task = bench / "push.task.yaml"
    for arguments, said in [
        ((task, "-p", "nothing"), "`nothing` is not a valid policy"),
        ((task, "-p", "random", "-p", "random"), "two policies have the label `random`"),
        ((task, task, "-p", "random"), "two tasks have the name `push`"),
        ((bench / "none", "-p", "random"), "does not exist"),
        ((task, "-p", "random", "--shard", "3/2"), "expected I/N"),
        ((task, "-p", "random", "--camera", "nose"), "camera `nose`"),
    ]:
        result = run("eval", *arguments, "-o", tmp_path, "-n", "1")
        assert result.code == 2 and said in result.err, result.err
    shutil.copytree(bench, tmp_path / "copy", ignore=shutil.ignore_patterns("out"))
    (tmp_path / "copy/push.task.yaml").write_text(TASK.replace("At(block, 0.45, 0)", "At(block, 0.45)", 1))
    result = run("eval", tmp_path / "copy/push.task.yaml", "-p", "random", "-o", tmp_path)
    assert result.code == 2 and "push.task.yaml:5" in result.err


def test_a_rate_can_be_required(bench: Path, done: Path) -> None:
    command: tuple[str | Path, ...] = ("eval", bench / "push.task.yaml", *_policies(bench), "-n", "4", "-o", done)
    result = run(*command, "--require", "0.5")
    assert result.code == 1 and "push with still: 0% is below 50%" in result.err


def test_labels_come_from_what_was_asked_for() -> None:
    texts = ("random", "a.b=random", "openpi:localhost:8000?action_space=joint_position")
    assert [c.label for c in contenders(texts)] == ["random", "a.b", "openpi-localhost-8000"]


def test_the_page_says_what_was_run_and_why_rollouts_failed(done: Path) -> None:
    text = (done / "report.html").read_text()
    facts = {"SimFoundry": __version__, "engine": f"mujoco {version('mujoco')}", "robot": "arm: arm.xml", "seed": "0"}
    for name, value in {**facts, "rollouts": "8", "control": "15 Hz"}.items():
        assert f"<dt>{name}</dt><dd>{value}</dd>" in text, name
    assert '“Push the block away.” <span class="quiet">within 45 control steps (3 s)' in text
    for label in ("0.33", "0.31", "x [m]", "0.02", "-0.02", "y [m]"):  # the block's region
        assert f">{label}</text>" in text
    record = next(r for r in _results(done)["rollouts"] if r["policy"] == "still")
    assert "block" in record["unmet"] and f"not completed after 45 control steps; at the end: {record['unmet']}" in text
    assert '<article class="whole">' in text  # grids and tables use the whole window


def test_the_page_of_many_tasks_folds_them_and_shows_what_they_say_together() -> None:
    rows = [record(f"cousin{k}", p, won=p == "a" or k < 2) for k in range(13) for p in "ab"]
    rows.append(record("cousin0", "c", end="no answer", won=False))
    filled = {"engine_version": "3", "robots": {}, "version": "0", "seed": 0, "instruction": "go", "control_hz": 15.0}
    text = page([{**filled, "horizon": 9, "regions": {}, "cells": {}, "grid": [5, 5], **r} for r in rows])
    assert text.count("<summary><b>cousin") == 13 and "a 1/1; b 0/1" in text
    assert "All tasks combined" in text and "13/13" in text and "2/13" in text
    assert "no result" in text and "1 missing" in text
    assert "<th>a vs. b</th><td>mujoco</td><td>13</td><td>11</td><td>0</td><td>0.000977</td>" in text


def test_the_page_escapes_what_it_is_told() -> None:
    record = {
        "task": "<script>", "part": "whole", "step": "", "policy": "p&q", "index": 0, "success": False, "end": "fell",
        "reason": "<b>", "steps": 3, "subtasks": {"<i>": None}, "cells": {"x": [0, 0]}, "grid": [5, 5],
        "video": "a'b.webm", "engine": "<u>", "engine_version": "<s>", "robots": {"<q>": "<z>"}, "start": "1",
        "version": "<v>", "seed": 0, "instruction": "<k>", "asked_rollouts": 1, "control_hz": 15.0, "horizon": 9,
        "regions": {"x": {"x": [0, 1], "y": [0, 1]}}, "cousin": {"recipe": "<r>", "axes": ["<a>"]},
    }  # fmt: skip
    text = page([record])
    assert not re.search(r"<(script|b|i|u|s|q|z|v|k|r|a)>", text) and "a'b" not in text
    assert cells([record])[0].success.interval == pytest.approx(wilson(0, 1))


def test_a_goal_that_cannot_be_judged_is_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "a.scene.yaml").write_text(
        "simfoundry: scene/1\nname: a\nobjects:\n"
        "  desk: {fixed: true, shape: {box: [1, 1, 0.04]}, pose: {xyz: [0.5, 0, -0.02]}}\n"
        "  cube: {shape: {box: [0.04, 0.04, 0.04]}, mass: 0.1, place: {on: desk, xy: [0.5, 0]}}\n"
        "robots: {arm: {model: demo_arm}}\n"
    )
    (tmp_path / "a.task.yaml").write_text(
        "simfoundry: task/1\nname: a\nscene: a.scene.yaml\ninstruction: Put it in.\ngoal: Inside(cube, desk)\n"
    )
    done = run("eval", tmp_path / "a.task.yaml", "-p", "random", "-n", "1", "--no-video", "-o", tmp_path / "out")
    assert (done.code, done.err) == (
        2,
        "Error: `desk` has no cavity, because its colliders do not enclose any space\n",
    )


def test_where_nothing_draws_an_evaluation_goes_without_videos(
    push_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYOPENGL_PLATFORM", "none")  # as where there is no GL driver
    arguments = ("eval", push_file, "-p", "random", "-n", "1", "-o", tmp_path / "out")
    done = run(*arguments)
    assert done.code == 0, done.err
    assert "no videos: MuJoCo could not find a GL driver; run `simfoundry doctor` to see how to install one" in done.err
    assert not list((tmp_path / "out").rglob("*.webm")) and (tmp_path / "out" / "report.html").is_file()
    asked = run(*arguments[:-1], tmp_path / "asked", "--video")
    assert asked.code == 2 and "MuJoCo could not find a GL driver: install libegl1" in asked.err
