"""The scripted expert with the project's own arm: it takes a cube up and puts it down where a task wants it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from simfoundry.evaluate.expert.policy import ExpertPolicy
from simfoundry.evaluate.resets.starts import starts
from simfoundry.evaluate.rollouts.rollout import RolloutEnd, rollout
from simfoundry.evaluate.task import load_task
from simfoundry.predicates import Judge
from simfoundry.worlds import open_world

pytest.importorskip("mink", reason="the expert solves its arms with mink")

SCENE = """\
simfoundry: scene/1
name: tray
materials:
  wood: {density: 500, friction: 0.6}
objects:
  desk: {fixed: true, shape: {box: [1.1, 1.3, 0.04]}, material: wood, pose: {xyz: [0.35, 0, -0.02]}}
  cube: {shape: {box: [0.04, 0.04, 0.04]}, material: wood, place: {on: desk, xy: [0.45, 0.1]}}
  tray: {shape: {box: [0.12, 0.12, 0.02]}, material: wood, place: {on: desk, xy: [0.45, -0.15]}}
robots:
  arm: {model: demo_arm, joints: home}
"""

TASK = """\
simfoundry: task/1
name: cube_on_tray
scene: tray.scene.yaml
instruction: Put the cube on the tray.
goal: {all: ["OnTop(cube, tray)", Released(cube)]}
subtasks:
  pick_up_cube: {goal: Grasped(cube)}
reset:
  objects: {cube: {x: [0.42, 0.48], y: [0.08, 0.14], yaw_deg: [-45, 45]}}
horizon: 300
"""


@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_the_expert_puts_a_cube_on_a_tray(tmp_path: Path, engine: str) -> None:
    pytest.importorskip(engine, reason=f"{engine} is not installed")
    (tmp_path / "tray.scene.yaml").write_text(SCENE)
    file = tmp_path / "cube_on_tray.task.yaml"
    file.write_text(TASK)
    task = load_task(file)
    (start,) = starts(task, 1, seed=3)
    expert, judge = ExpertPolicy(task), Judge(task.scene)
    with open_world(task.scene, engine) as world:
        one = rollout(task, start, expert, world, judge)
        assert (one.end, expert.log) == (RolloutEnd.SUCCESS, [])
        picked = one.subtasks["pick_up_cube"]
        assert picked is not None and 0 < picked < one.steps < task.horizon
        assert not judge(task.goal, start.state).value and judge(task.goal, one.final).value
        apart = one.final.poses["cube"].p - one.final.poses["tray"].p
        assert abs(apart[:2]).max() < 0.05 and one.final.poses["cube"].p[2] == pytest.approx(0.04, abs=2e-3)
        short = rollout(replace(task, horizon=picked), start, expert, world, judge)  # the same again, as far as it goes
        assert (short.actions == one.actions[:picked]).all() and short.end is RolloutEnd.HORIZON
