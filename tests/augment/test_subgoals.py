"""Sub-goals, their references, and the rotations that objects allow."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from simfoundry.augment.subgoals import Subgoal, subgoals
from simfoundry.augment.symmetry import DIRECTIONS, symmetry_order
from simfoundry.augment.transform import ObjectFacts
from simfoundry.evaluate.task import Task, load_task
from tests.conftest import REPOSITORY

SCENE = """\
simfoundry: scene/1
name: shapes
objects:
  desk: {fixed: true, shape: {box: [2, 1.4, 0.04]}, pose: {xyz: [0, 0, -0.02]}}
  can: {density: 500, shape: {cylinder: {radius: 0.04, height: 0.1}}, place: {on: desk, xy: [0.4, 0]}}
  brick: {density: 500, shape: {box: [0.05, 0.1, 0.05]}, place: {on: desk, xy: [0.4, 0.2]}}
  tile: {density: 500, shape: {box: [0.1, 0.1, 0.02]}, place: {on: desk, xy: [0.4, 0.4]}}
  mug:
    density: 500
    shape:
      compound:
        body: {shape: {cylinder: {radius: 0.04, height: 0.1}}}
        handle: {shape: {box: [0.03, 0.01, 0.06]}, pose: {xyz: [0.05, 0, 0]}}
    place: {on: desk, xy: [0.4, -0.2]}
robots:
  arm: {model: demo_arm, pose: {xyz: [0, 0, 0]}, joints: home}
"""


def task_of(folder: Path, goal: str, steps: str = "{}") -> Task:
    """A task about the shapes."""
    (folder / "shapes.scene.yaml").write_text(SCENE)
    lines = ["simfoundry: task/1", "name: shapes", "scene: shapes.scene.yaml", "instruction: Do it."]
    (folder / "shapes.task.yaml").write_text("\n".join([*lines, f"goal: {goal}", f"subtasks: {steps}", ""]))
    return load_task(folder / "shapes.task.yaml")


def rows(found: tuple[Subgoal, ...]) -> list[tuple[str, str, str]]:
    return [(str(one.call), one.reference, one.held) for one in found]


def test_the_hand_acts_on_what_it_grasps_and_then_on_the_target(tmp_path: Path) -> None:
    task = task_of(tmp_path, '{all: ["OnTop(can, tile)", "Released(can)"]}', '{touch: {goal: "Touching(arm, can)"}}')
    grasp, place = subgoals(task)
    assert rows((grasp, place)) == [("Grasped(can)", "can", ""), ("OnTop(can, tile)", "tile", "can")]
    assert grasp.is_implied and not place.is_implied and grasp.lasts


def test_a_touch_is_part_of_the_grasp_and_a_push_goes_through_the_world(tmp_path: Path) -> None:
    steps = '{touch: {goal: "Touching(arm, can)"}, take: {goal: Grasped(can)}, on: {goal: "OnTop(can, brick)"}}'
    assert [one.name for one in subgoals(task_of(tmp_path, '"OnTop(can, brick)"', steps))] == ["take", "on"]
    push = subgoals(task_of(tmp_path, '"At(can, 0.5, 0)"', '{touch: {goal: "Touching(arm, can)"}}'))
    assert rows(push) == [("Touching(arm, can)", "can", ""), ("At(can, 0.5, 0)", "", "")]
    assert not push[0].lasts and push[0].robots == ("arm",)


def test_grasps_come_directly_before_their_placements() -> None:
    task = load_task(REPOSITORY / "specs" / "tasks" / "serve_fruits.task.yaml")
    assert [one.name for one in subgoals(task)] == [
        "pick_up_banana", "banana_on_plate", "pick_up_apple", "apple_on_plate",
    ]  # fmt: skip
    drawer = subgoals(load_task(REPOSITORY / "specs" / "tasks" / "store_marker.task.yaml"))
    assert [one.reference for one in drawer] == ["cabinet.drawer", "marker", "cabinet.drawer", "cabinet.drawer"]
    assert [one.held for one in drawer] == ["", "", "marker", ""]
    pot = subgoals(load_task(REPOSITORY / "specs" / "tasks" / "pot_on_stove.task.yaml"))
    assert [(one.name, one.robots, one.held) for one in pot] == [
        ("left_grasps_handle", ("left",), ""),
        ("right_grasps_handle", ("right",), ""),
        ("pot_lifted", (), "pot"),
        ("pot_on_stove", (), "pot"),
    ]


@pytest.mark.parametrize(("name", "order"), [("can", DIRECTIONS), ("brick", 2), ("tile", 4), ("mug", 1)])
def test_the_symmetry_of_a_shape(tmp_path: Path, name: str, order: int) -> None:
    task = task_of(tmp_path, '"OnTop(can, tile)"')
    assert symmetry_order(task.scene.object(name)) == order
    turns = ObjectFacts(task.scene).rotations(name)
    assert len(turns) == min(order, 12) and turns[0] == 0.0
    np.testing.assert_allclose(np.diff(turns), 2 * math.pi / len(turns))
