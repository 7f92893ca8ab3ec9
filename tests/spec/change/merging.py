"""Documents and helpers for the tests of three-way merges."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from simfoundry.spec.change.merge.conflict import dotted
from simfoundry.spec.change.merge.trees import Merged, merge_trees
from simfoundry.spec.models.kinds import model_of
from simfoundry.spec.yaml.text import parse, read
from simfoundry.spec.yaml.tree import plain_tree
from simfoundry.spec.yaml.write import write_tree
from tests.conftest import REPOSITORY

SCENE = """\
simfoundry: scene/1
name: table
viewpoint: front
materials:
  wood: {density: 700, friction: 0.5}
  ceramic: {density: 2400, friction: 0.35, color: [0.9, 0.8, 0.7]}
objects:
  desk:
    fixed: true
    shape: {box: [1.4, 0.7, 0.04]}
    material: wood
    pose: {xyz: [0.45, 0.1, -0.02]}
  plate:
    shape: {cylinder: {radius: 0.1, height: 0.02}}
    material: ceramic
    place: {on: desk, xy: [0.45, 0.1]}
  cup:
    shape: {cylinder: {radius: 0.04, height: 0.1}}
    mass: 0.2
    friction: 0.4
    pose: {xyz: [0.4, 0.12, 0.05], yaw_deg: 30}
  block:
    shape: {box: [0.05, 0.06, 0.07]}
    mass: {value: 0.1, range: [0.05, 0.2], source: vlm}
    pose: {xyz: [0.2, 0.11, 0.035]}
robots:
  arm: {model: franka_robotiq, pose: {xyz: [-0.1, 0.2, 0.3]}}
cameras:
  front: {size: [64, 48], fx: 60.5, fy: 61.5, pose: {xyz: [-0.8, 0.1, 0.7], look_at: [0.1, 0.2, 0.3]}}
lights:
  sun: {type: distant, intensity: 0.8, direction: [0.1, 0.2, -0.9]}
relations:
  - OnTop(plate, desk)
  - OnTop(cup, desk)
"""

TASK = """\
simfoundry: task/1
name: tidy
scene: table.scene.yaml
instruction: Put the cup on the plate.
goal: {all: [OnTop(cup, plate), {any: [Upright(cup), Released(cup)]}]}
subtasks:
  pick: {goal: Grasped(cup)}
  put: {goal: OnTop(cup, plate), start: {place: {block: {on: desk}}}}
reset:
  grid: [5, 5]
  objects:
    cup: {x: [0.3, 0.5], y: [0.1, 0.2], yaw_deg: [-30, 30]}
    block: {x: [0.1, 0.2], y: [0.1, 0.2]}
start: {place: {cup: {on: desk, xy: [0.3, 0.1]}}}
control_hz: 15.5
"""

BASES = {
    "scene": parse(SCENE).data,
    "task": parse(TASK).data,
    **{
        Path(name).name: read(REPOSITORY / "specs" / name).data
        for name in (
            "assets/cabinet.asset.yaml",
            "captures/desk/desk.scene.yaml",
            "scenes/cluttered.scene.yaml",
            "tasks/clear_table.task.yaml",
        )
    },
}
SHORT, PAIRS = 20, 1000 // len(BASES) + 1
"""Pairs of edits for each of the documents, in a default run and in a long one."""

seeds = pytest.mark.parametrize(
    "seeds", [range(SHORT), pytest.param(range(SHORT, PAIRS), marks=pytest.mark.slow)], ids=["short", "long"]
)


def merge(base: Any, ours: Any, theirs: Any) -> Merged:
    """Merge three documents as plain data; ``base`` is None if both sides added the document."""
    return merge_trees(*(plain_tree({} if data is None else data) for data in (base, ours, theirs)))


def changed(*replacements: tuple[str, str], text: str = SCENE) -> Any:
    """The data of a text in which each of some pieces, which is there once, is replaced."""
    for old, new in replacements:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return parse(text).data


def both(ours: Any, theirs: Any, base: Any = None) -> Merged:
    """The merge, which must say the same, or the same conflicts, whichever side is which."""
    base = BASES["scene"] if base is None else base
    merged, mirrored = merge(base, ours, theirs), merge(base, theirs, ours)
    assert table(mirrored, swap=True) == table(merged)
    if not merged.conflicts:
        assert text_of(merged) == text_of(mirrored)
    return merged


def table(merged: Merged, swap: bool = False) -> dict[str, tuple[Any, Any, Any]]:
    """The conflicts by path: base, ours, theirs."""
    sides = [(c, (c.base, c.theirs, c.ours) if swap else (c.base, c.ours, c.theirs)) for c in merged.conflicts]
    return {dotted(c.path): values for c, values in sides}


def text_of(merged: Merged) -> str:
    return write_tree(merged.tree, model_of(merged.data["simfoundry"]))


def as_sets(data: Any) -> Any:
    """Data in which relations have no order."""
    return {**data, "relations": sorted(data.get("relations", ()))}
