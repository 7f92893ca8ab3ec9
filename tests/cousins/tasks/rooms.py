"""A shelf with rooms or boards, an arm and a cup: built with other numbers in each test."""

from __future__ import annotations

import shutil
from pathlib import Path

from simfoundry.cousins.tasks.context import TaskContext
from simfoundry.cousins.tasks.witness import Witness, witness
from tests.conftest import REPOSITORY

ROOMS = """\
simfoundry: scene/1
name: rooms
materials: {{wood: {{density: 600, friction: 0.5}}}}
objects:
  table: {{fixed: true, shape: {{box: [1.2, 1.4, 0.04]}}, material: wood, pose: {{xyz: [0.5, 0, -0.02]}}}}
  shelf: {{asset: shelf.asset.yaml, fixed: true, pose: {{xyz: [0.62, 0, 0], yaw_deg: {yaw}}}}}
  cup: {{asset: cup.asset.yaml, place: {{on: table, xy: [0.35, 0.35]}}}}
robots: {{arm: {{model: demo_arm}}}}
"""


CASE = """\
simfoundry: asset/1
name: shelf
materials: {{wood: {{density: 600, friction: 0.5}}}}
links:
  body:
    material: wood
    parts:
      bottom: {{shape: {{box: [0.2, 0.5, 0.015]}}, pose: {{xyz: [0, 0, 0.0075]}}}}
      middle: {{shape: {{box: [0.2, 0.5, 0.015]}}, pose: {{xyz: [0, 0, {middle}]}}}}
      top: {{shape: {{box: [0.2, 0.5, 0.015]}}, pose: {{xyz: [0, 0, 0.45]}}}}
      left: {{shape: {{box: [0.2, 0.015, 0.4575]}}, pose: {{xyz: [0, 0.2425, 0.22875]}}}}
      right: {{shape: {{box: [0.2, 0.015, 0.4575]}}, pose: {{xyz: [0, -0.2425, 0.22875]}}}}
      back: {{shape: {{box: [0.008, 0.5, 0.4575]}}, pose: {{xyz: [0.096, 0, 0.22875]}}}}
"""


RACK = """\
simfoundry: asset/1
name: shelf
materials: {wood: {density: 600, friction: 0.5}}
links:
  frame:
    material: wood
    parts:
      left: {shape: {box: [0.03, 0.03, 0.36]}, pose: {xyz: [0, 0.2, 0.18]}}
      right: {shape: {box: [0.03, 0.03, 0.36]}, pose: {xyz: [0, -0.2, 0.18]}}
  lower: {material: wood, parts: {board: {shape: {box: [0.2, 0.37, 0.01]}}}}
  upper: {material: wood, parts: {board: {shape: {box: [0.2, 0.37, 0.01]}}}}
joints:
  low: {type: fixed, parent: frame, child: lower, pose: {xyz: [0, 0, 0.1]}}
  high: {type: fixed, parent: frame, child: upper, pose: {xyz: [0, 0, 0.33]}}
"""


def rooms(folder: Path, asset: str, yaw: float = 0.0) -> TaskContext:
    """A table with a shelf, a cup and an arm before it."""
    shutil.copy(REPOSITORY / "specs" / "assets" / "cup.asset.yaml", folder)
    (folder / "shelf.asset.yaml").write_text(asset)
    (folder / "rooms.scene.yaml").write_text(ROOMS.format(yaw=yaw))
    return TaskContext.load(folder / "rooms.scene.yaml")


def shown(setting: TaskContext, goal: object) -> float | str:
    """How high the cup stands where a goal is reached [m], or why it is not."""
    found = witness(setting, goal)
    return float(found.state.poses["cup"].p[2]) if isinstance(found, Witness) else f"{found[0].code}: {found[0].text}"
