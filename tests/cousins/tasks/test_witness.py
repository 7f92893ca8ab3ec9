"""Witnesses of goals: states in which they hold, found and proved in engines."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from simfoundry.cousins.tasks.context import TaskContext
from simfoundry.cousins.tasks.trial import lost, put
from simfoundry.cousins.tasks.witness import Witness, witness
from simfoundry.errors import MissingEngineError
from simfoundry.geometry.frames import Pose
from tests.cli.command import run
from tests.conftest import REPOSITORY
from tests.cousins.tasks.conftest import let_roll
from tests.cousins.tasks.rooms import CASE, rooms, shown


def test_what_is_closed_is_opened_on_the_way(setting: TaskContext) -> None:
    found = witness(setting, {"all": ["Inside(block, cabinet.drawer)", "Closed(cabinet.drawer)"]})
    assert isinstance(found, Witness)
    assert found.opened == ("cabinet.drawer",)
    assert found.state.joints["cabinet.drawer"] == pytest.approx(0, abs=2e-3)


def test_a_bottle_stands_in_a_mug_with_a_handle(tmp_path: Path) -> None:
    for name in ("mug", "red_bottle"):
        shutil.copy(REPOSITORY / "specs" / "assets" / f"{name}.asset.yaml", tmp_path)
    file = tmp_path / "mug.scene.yaml"
    file.write_text(
        "simfoundry: scene/1\nname: mug\nmaterials: {wood: {density: 600}}\nobjects:\n"
        "  table: {fixed: true, shape: {box: [1, 1, 0.04]}, material: wood, pose: {xyz: [0, 0, -0.02]}}\n"
        "  mug: {asset: mug.asset.yaml, place: {on: table, xy: [0, 0]}}\n"
        "  bottle: {asset: red_bottle.asset.yaml, place: {on: table, xy: [0.3, 0]}}\n"
    )
    setting = TaskContext.load(file)
    found = witness(setting, "Inside(bottle, mug)")
    assert isinstance(found, Witness)
    apart = found.state.poses["bottle"].p - found.state.poses["mug"].p
    assert float(np.hypot(*apart[:2])) < 0.036  # the mug's inner radius


SHELF = """
simfoundry: scene/1
name: shelf
materials: {wood: {density: 600, friction: 0.5}, rubber: {density: 400, friction: 0.6}}
objects:
  table: {fixed: true, shape: {box: [1, 1, 0.04]}, material: wood, pose: {xyz: [0, 0, -0.02]}}
  organizer: {asset: organizer.asset.yaml, place: {on: table, xy: [0, 0]}}
  ball: {asset: tennis_ball.asset.yaml, place: {on: table, xy: [-0.3, 0.2]}}
  cup: {asset: cup.asset.yaml, place: {on: table, xy: [0.3, 0.2]}}
"""


@pytest.fixture(scope="module")
def shelf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("shelf")
    for name in ("organizer", "tennis_ball", "cup"):
        shutil.copy(REPOSITORY / "specs" / "assets" / f"{name}.asset.yaml", folder)
    let_roll(folder / "tennis_ball.asset.yaml")
    (folder / "shelf.scene.yaml").write_text(SHELF)
    return folder / "shelf.scene.yaml"


def test_what_is_done_may_have_to_last_in_another_engine(shelf: Path) -> None:
    pytest.importorskip("pybullet", reason="PyBullet has no wheel for this Python")
    goal = "OnTop(ball, organizer)"
    one, both = (TaskContext.load(shelf, engines=e) for e in (("mujoco",), ("mujoco", "pybullet")))
    found = witness(both, goal)
    assert isinstance(found, Witness) and not lost(both, goal, found.state)
    fleeting = put(both, "ball", Pose.of((0.0, 0.0, 0.4)), found.state)
    assert "after 2 s in pybullet" in lost(both, goal, fleeting), "it falls, and rolls away or lies elsewhere"
    assert lost(one, goal, fleeting) == "", "nobody asked"
    done = run(
        "propose",
        shelf,
        "-n",
        "1",
        "--about",
        "ball",
        "--about",
        "organizer",
        "--engine",
        "mujoco",
        "--engine",
        "pybullet",
        "--json",
    )
    assert done.code == 0 and done.json["accepted"] == 1, done.err


def test_an_engine_that_is_not_there_is_said(shelf: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pybullet", None)
    with pytest.raises(MissingEngineError, match="PyBullet"):
        witness(TaskContext.load(shelf, engines=("mujoco", "pybullet")), "OnTop(ball, organizer)")


@pytest.mark.parametrize(
    ("middle", "yaw", "said"),
    [
        (0.22, 180.0, "out_of_reach: no arm can get to `cup` from an open side"),
        (0.09, 0.0, None),  # the room below is too low for the cup, the one above is not
    ],
)
def test_a_room_is_entered_from_its_open_side(tmp_path: Path, middle: float, yaw: float, said: str | None) -> None:
    pytest.importorskip("mink", reason="the extra `expert` is not installed")
    found = shown(rooms(tmp_path, CASE.format(middle=middle), yaw), "Inside(cup, shelf)")
    assert (
        found.startswith(said) if isinstance(found, str) and said else found == pytest.approx(middle + 0.0075, abs=2e-3)
    )
