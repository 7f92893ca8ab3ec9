"""What is said to somebody who writes what another format, or common sense, would have."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.spec.load import load

SCENE = """\
simfoundry: scene/1
name: desk
materials: {wood: {density: 700}}
objects:
  desk: {fixed: true, shape: {box: [1, 1, 0.1]}, material: wood}
  mug: {shape: {sphere: 0.04}, mass: 0.3, place: {on: desk, xy: [0.1, 0]}}
robots:
  arm: {model: yam}
relations: [OnTop(mug, desk)]
"""
TASK = """\
simfoundry: task/1
name: lift
scene: desk.scene.yaml
instruction: Lift the mug.
goal: {all: [Lifted(mug)]}
subtasks: {pick_up: {goal: Grasped(mug)}}
"""


def hints(folder: Path, scene: str, task: str = TASK) -> list[tuple[str, str]]:
    """The message and the hint of each finding of the task and its scene."""
    (folder / "desk.scene.yaml").write_text(scene)
    (folder / "lift.task.yaml").write_text(task)
    return [(d.message, d.hint) for d in load(folder / "lift.task.yaml", folder).all_findings()]


def test_as_they_are_both_are_sound(tmp_path: Path) -> None:
    assert hints(tmp_path, SCENE) == []


@pytest.mark.parametrize(
    ("written", "instead", "message", "hint"),
    [
        ("OnTop(mug", "Onto(mug", "`Onto` is not a predicate", "did you mean `OnTop`?"),
        ("OnTop(mug", "Insid(mug", "`Insid` is not a predicate", "did you mean `Inside`?"),
        ("on: desk, ", "in: desk, ", "unknown key `in`", "did you mean `inside`?"),
        ("{sphere: 0.04}", "{cup: 0.04}", "unknown key `cup`", "did you mean `lathe`?"),
        ("shape: {sphere: 0.04}", "sphere: 0.04", "unknown key `sphere`", "write `shape: {sphere: ...}`"),
        ("mass: 0.3", "weight: 0.3", "unknown key `weight`", "did you mean `mass`?"),
        ("mass: 0.3", "mass: 300g", "expected a number, found the string `300g`",
         "masses are in kg, without the unit: `0.3`"),
        ("sphere: 0.04", "sphere: 4 cm", "expected a number, found the string `4 cm`",
         "lengths are in m, without the unit: `0.04`"),
        ("xy: [0.1, 0]", "yaw_deg: 30°", "expected a number, found the string `30°`",
         "angles are in degrees, without the unit: `30`"),
        ("arm: {model: yam}", "arm: yam", "expected a mapping, found the string `yam`", "write `{model: yam}`"),
        ("material: wood", "material: steel", "no material is called `steel`",
         "valid: `wood`; define new materials under `materials`"),
        ("material: wood", "material: woood", "no material is called `woood`", "did you mean `wood`?"),
    ],
)  # fmt: skip
def test_of_a_scene(written: str, instead: str, message: str, hint: str, tmp_path: Path) -> None:
    assert written in SCENE
    assert (message, hint) in hints(tmp_path, SCENE.replace(written, instead, 1))


@pytest.mark.parametrize(
    ("written", "instead", "message", "hint"),
    [
        ("{all: [", "{and: [", "unknown key `and`", "did you mean `all`?"),
        ("{all: [", "{either: [", "unknown key `either`", "valid: `all`, `any`, `not`"),
        ("subtasks:", "steps:", "unknown key `steps`", "did you mean `subtasks`?"),
        ("{pick_up: {goal: Grasped(mug)}}", "{pick_up: Grasped(mug)}",
         "expected a mapping, found the string `Grasped(mug)`", "write `{goal: Grasped(mug)}`"),
        ("{pick_up: {goal: Grasped(mug)}}", "[{goal: Grasped(mug)}]", "expected a mapping, found a list of 1",
         "`subtasks`: Steps by name, in order. Write `name: ...` for each, without `-`."),
    ],
)  # fmt: skip
def test_of_a_task(written: str, instead: str, message: str, hint: str, tmp_path: Path) -> None:
    assert written in TASK
    assert (message, hint) in hints(tmp_path, SCENE, TASK.replace(written, instead, 1))


def test_one_mistake_is_one_finding(tmp_path: Path) -> None:
    assert len(hints(tmp_path, SCENE.replace("{sphere: 0.04}", "{cup: 0.04}"))) == 1
    assert len(hints(tmp_path, SCENE, TASK.replace("{all: [", "{and: [", 1))) == 1
