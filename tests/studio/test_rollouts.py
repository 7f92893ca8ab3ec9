"""Policies and recordings in the studio: what runs, what hangs, and what is read back."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from simfoundry.data.attempt import state_arrays
from simfoundry.data.index import build_index, write_index
from simfoundry.data.plan import RecordPlan
from simfoundry.data.shards import Attempt, write_shard
from simfoundry.data.store import SHARDS
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.entries import TaskEntry, contenders, create_policy
from simfoundry.evaluate.resets.starts import starts, state_to_json
from simfoundry.evaluate.rollouts.rollout import rollout
from simfoundry.evaluate.run import EvaluationPlan, prepare
from simfoundry.evaluate.run import run as run_evaluation
from simfoundry.evaluate.task import load_task
from simfoundry.predicates import Judge
from simfoundry.studio.acts.names import RenameSymbol
from simfoundry.studio.session import StudioSession
from simfoundry.studio.trial.folders import found_folders, has_cousins, has_recordings
from simfoundry.studio.trial.recordings import demonstration_states, find_recordings, inside_project
from simfoundry.studio.trial.rollouts import RolloutTrial
from simfoundry.studio.view.robots import ShownRobots
from simfoundry.worlds import open_world
from tests.studio.conftest import SCENE
from tests.studio.test_trial import Stage, document_of, until

# Raises the arm by small steps for ever.
POLICY = """\
import time
from simfoundry.evaluate.policies.base import Policy
from simfoundry.spec.models.signals import ActionSpace
import numpy as np

class Wave(Policy):
    name = "wave"
    action_space = ActionSpace.JOINT_POSITION
    def infer(self, observation):
        joints = observation.robots["arm"].joints + 0.05
        return np.array([[*joints, 0.0]] * 3)

class Hang(Wave):
    def infer(self, observation):
        if observation.time > 0.3:
            time.sleep(1e6)
        return super().infer(observation)
"""

TASK = """\
simfoundry: task/1
name: wave
scene: desk.scene.yaml
instruction: Wave.
goal: Inside(mug, tray)
horizon: 12
"""


@pytest.fixture
def arm_task(desk: Path) -> Path:
    """A task with an arm, and policies beside it."""
    desk.write_text(
        SCENE.replace("cameras:", "robots: {arm: {model: demo_arm, pose: {xyz: [-0.5, 0.3, 0]}}}\n\ncameras:")
    )
    desk.with_name("policies.py").write_text(POLICY)
    path = desk.with_name("wave.task.yaml")
    path.write_text(TASK)
    return path


@pytest.fixture
def trial() -> Iterator[list[RolloutTrial]]:
    """Trials that are closed at the end."""
    every: list[RolloutTrial] = []
    yield every
    for one in every:
        one.close()


@pytest.mark.slow
def test_a_policy_is_watched_and_recorded_and_replayed(arm_task: Path, trial: list[RolloutTrial]) -> None:
    stage, policy = Stage(), f"python:{arm_task.with_name('policies.py')}:Wave"
    document = document_of(arm_task)
    run = RolloutTrial(stage.states.append, stage.said.append, "run_policy", document, policy, 0, 0, "mujoco")
    trial.append(run)
    until(lambda: not run.is_running, "the end of the rollout")
    assert run.outcome["steps"] == 12 and not run.outcome["success"], stage.said
    assert stage.said[-1].startswith("Failure: not completed after 12 control steps")
    assert run.playback.count == 13 and run.playback.is_complete
    first, last = run.playback._frames[0], run.playback._frames[-1]
    assert last.robots["arm"] != first.robots["arm"]

    folder = arm_task.parent / "eval"
    plan = EvaluationPlan(folder, (TaskEntry(arm_task),), tuple(contenders((policy,))), rollouts=1, video=False)
    prepare(plan)
    run_evaluation(plan, lambda *_: None)
    scene = StudioSession(arm_task).scene
    assert scene is not None
    (recording,) = find_recordings(folder, scene)
    assert recording.label == "000: Wave in mujoco, failure (horizon)" and recording.record is not None
    again = RolloutTrial(
        stage.states.append, stage.said.append, "run_recorded", document, dict(recording.record), recording.actions
    )
    trial.append(again)
    until(lambda: not again.is_running, "the replay")
    assert again.outcome["is_identical"] and again.outcome["digest"] == run.outcome["digest"], stage.said
    heavier = document_of(arm_task)
    texts = {path: text.replace("radius: 0.04", "radius: 0.05") for path, text in heavier.texts.items()}
    other = RolloutTrial(
        stage.states.append, stage.said.append, "run_recorded", type(heavier)(heavier.path, texts),
        dict(recording.record), recording.actions,
    )  # fmt: skip
    trial.append(other)
    until(lambda: not other.is_running, "the replay")
    assert stage.said[-1].endswith("because the scene, the task or the engine has changed since.")


@pytest.mark.slow
def test_a_hanging_policy_is_stopped_and_its_states_stay(arm_task: Path, trial: list[RolloutTrial]) -> None:
    stage, policy = Stage(), f"python:{arm_task.with_name('policies.py')}:Hang"
    run = RolloutTrial(
        stage.states.append, stage.said.append, "run_policy", document_of(arm_task), policy, 0, 0, "mujoco"
    )
    trial.append(run)
    until(lambda: run.playback.count >= 6, "the first states")
    assert run.is_running
    run.stop()
    until(lambda: not run.is_running, "the stop")
    assert stage.said[-1] == "Stopped." and run.playback.count >= 6 and run.playback.is_complete


@pytest.mark.slow
@pytest.mark.parametrize(
    ("policy", "said"),
    [("expert", "Failure|Success|error"), ("no_such", "not a valid policy"), ("python:missing.py:X", "missing.py")],
)
def test_errors_of_policies_are_told(arm_task: Path, trial: list[RolloutTrial], policy: str, said: str) -> None:
    stage = Stage()
    run = RolloutTrial(
        stage.states.append, stage.said.append, "run_policy", document_of(arm_task), policy, 0, 0, "mujoco"
    )
    trial.append(run)
    until(lambda: not run.is_running, "the end")
    assert re.search(said, stage.said[-1]), stage.said


@pytest.mark.slow
def test_a_demonstration_is_shown_without_simulating_it(arm_task: Path) -> None:
    policy = f"python:{arm_task.with_name('policies.py')}:Wave"
    folder = arm_task.parent / "demos"
    plan = RecordPlan(folder, (arm_task,), contenders((policy,))[0], 1, 1)
    task = load_task(arm_task)
    judge, start = Judge(task.scene), starts(task, 1)[0]
    with open_world(task.scene, "mujoco") as world:
        done = rollout(task, start, create_policy(plan.contender.choice(), task, judge), world, judge, trace=True)
    about = {
        "index": 0, "seed": 0, "cells": {}, "kept": True, "success": True, "steps": done.steps, "subtasks": {},
        "trajectory": done.digest, "action_space": "joint_position", "action_hz": 15.0,
        "initial": state_to_json(start.state),
    }  # fmt: skip
    (folder / SHARDS).mkdir(parents=True)
    write_index(folder, build_index(plan))
    write_shard(folder / SHARDS / "00000.npz", [Attempt(about, {"actions": done.actions, **state_arrays(done.trace)})])

    scene = StudioSession(arm_task).scene
    assert scene is not None
    (recording,) = find_recordings(folder, scene)
    assert recording.label == "demonstration 0, 12 steps"
    robots = ShownRobots()
    robots.read(scene.surroundings.robots)
    states, hz = demonstration_states(recording, scene, robots.known(scene.surroundings.robots))
    assert hz == 15.0 and len(states) == 13
    for shown, (state, _) in zip(states, done.trace, strict=True):
        assert shown.robots == state.robots and shown.joints == state.joints
        assert all((shown.poses[name].p == pose.p).all() for name, pose in state.poses.items())
    renamed = StudioSession(arm_task)
    renamed.apply(RenameSymbol("mug", "beaker"))
    assert renamed.scene is not None
    with pytest.raises(SimfoundryError, match="recorded with desk, mug, tray, ball, but the scene has desk, beaker"):
        demonstration_states(recording, renamed.scene, [])


def test_what_libraries_report_meanwhile_is_told(desk: Path, trial: list[RolloutTrial]) -> None:
    stage = Stage()
    document = document_of(desk)
    run = RolloutTrial(stage.states.append, stage.said.append, "run_policy", document, "random", 0, 0, "mujoco")
    trial.append(run)
    run._progress("convex parts of 3 of 5 meshes")
    assert "convex parts of 3 of 5 meshes" in stage.said


def test_folders_are_looked_for_in_the_project_only(desk: Path) -> None:
    inside = desk.parent / "inner"
    inside.mkdir()
    root = desk.parent.resolve()
    assert inside_project(root, " inner/ ") == inside.resolve()
    for text in ("..", "/etc", "inner/../.."):
        with pytest.raises(SimfoundryError, match="outside of the project"):
            inside_project(root, text)
    (inside / "link").symlink_to("/etc")
    with pytest.raises(SimfoundryError, match="outside of the project"):
        inside_project(root, "inner/link")
    with pytest.raises(SimfoundryError, match="not a folder"):
        inside_project(root, "missing")


def test_folders_of_the_project_are_listed_with_the_latest_first(desk: Path) -> None:
    root = desk.parent
    for name in ("build/old", "runs/größer", ".hidden/run", "elsewhere"):
        (root / name).mkdir(parents=True)
    for name in ("build/old", "runs/größer", ".hidden/run"):
        (root / name / "manifest.json").write_text('{"simfoundry": "cousins-run/1", "cousins": []}')
        (root / name / "rollouts" / "deep").mkdir(parents=True)
    (root / "elsewhere" / "manifest.json").write_text('{"simfoundry": "build/1"}')
    (root / "link").symlink_to(root / "build")
    os.utime(root / "build" / "old", (1e9, 1e9))
    assert found_folders(root, has_cousins) == ("runs/größer", "build/old")
    assert found_folders(root, has_recordings) == ("runs/größer", "build/old")
    (root / "elsewhere" / "demonstrations.json").touch()
    assert "elsewhere" in found_folders(root, has_recordings)


def test_a_folder_without_recordings_says_what_it_expects(task: Path, desk: Path) -> None:
    scene = StudioSession(task).scene
    assert scene is not None
    with pytest.raises(SimfoundryError, match="neither rollouts of `simfoundry eval` nor demonstrations"):
        find_recordings(task.parent, scene)
    other = task.parent / "rollouts" / "other" / "expert" / "mujoco"
    other.mkdir(parents=True)
    record = {"simfoundry": "rollout/2", "index": 0, "task": "other", "end": "success", "success": True}
    (other / "000.json").write_text(json.dumps(record))
    with pytest.raises(SimfoundryError, match="no recordings of the task `put_mug`: only those of other"):
        find_recordings(task.parent, scene)
    only_scene = StudioSession(desk).scene
    assert only_scene is not None
    with pytest.raises(SimfoundryError, match="open the task document"):
        find_recordings(task.parent, only_scene)
