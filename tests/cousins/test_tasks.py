"""Task cousins from affordances: proposed, proved, refused with numbers, written."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from simfoundry.cousins.tasks.acceptance import AcceptedTask, accept
from simfoundry.cousins.tasks.candidate_poses import meaning, objects_of
from simfoundry.cousins.tasks.context import TaskContext
from simfoundry.cousins.tasks.enumeration import Proposal, Proposals, checked, enumerate_tasks, task, write
from simfoundry.cousins.tasks.ideas import Affordances
from simfoundry.cousins.tasks.proposals import task_cousins
from simfoundry.cousins.tasks.trial import lost, put
from simfoundry.cousins.tasks.witness import Witness, witness
from simfoundry.errors import MissingEngineError
from simfoundry.geometry.frames import Pose
from simfoundry.geometry.grasp_width import grasp_width
from simfoundry.lint.run import lint
from simfoundry.scene.object_shapes import solid
from simfoundry.scene.state import SceneState
from simfoundry.spec.load import load, load_scene
from simfoundry.spec.models.cousins import TaskAxis
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import TaskSpec
from tests.cli.command import run
from tests.conftest import REPOSITORY

SCENE = """\
simfoundry: scene/1
name: bench
materials: {wood: {density: 600, friction: 0.5}, lead: {density: 11000, friction: 0.5}}
objects:
  desk: {fixed: true, shape: {box: [1.6, 1.4, 0.04]}, material: wood, pose: {xyz: [0.6, 0, -0.02]}}
  bowl: {asset: bowl.asset.yaml, place: {on: desk, xy: [0.5, 0]}}
  cabinet: {asset: cabinet.asset.yaml, place: {on: desk, xy: [0.45, 0.37]}}
  ball: {asset: tennis_ball.asset.yaml, place: {on: desk, xy: [0.4, -0.2]}}
  block: {shape: {box: [0.03, 0.03, 0.03]}, material: wood, pose: {xyz: [0.33, 0.12, 0.015]}}
  wide: {shape: {box: [0.12, 0.12, 0.12]}, material: wood, pose: {xyz: [0.5, -0.4, 0.06]}}
  heavy: {shape: {box: [0.07, 0.07, 0.07]}, material: lead, pose: {xyz: [0.4, -0.5, 0.035]}}
  far: {shape: {box: [0.03, 0.03, 0.03]}, material: wood, pose: {xyz: [1.2, 0, 0.015]}}
robots: {arm: {model: franka_robotiq}}
relations: [OnTop(bowl, desk)]
"""


def _let_roll(ball: Path) -> None:
    """Take its resistance from a ball: what rolls off wherever it is not held is what these tests need."""
    ball.write_text(ball.read_text().replace("rolling_friction: 0.001, ", ""))


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bench")
    for name in ("bowl", "cabinet", "tennis_ball"):
        shutil.copy(REPOSITORY / "specs" / "assets" / f"{name}.asset.yaml", folder)
    _let_roll(folder / "tennis_ball.asset.yaml")
    file = folder / "bench.scene.yaml"
    file.write_text(SCENE)
    return file


@pytest.fixture(scope="module")
def setting(path: Path) -> TaskContext:
    return TaskContext.load(path)


@pytest.fixture(scope="module")
def proposals(setting: TaskContext) -> list[Proposal]:
    return enumerate_tasks(setting, scene="bench.scene.yaml")


def why(setting: TaskContext, goal: object) -> tuple[str, str]:
    reasons = accept(goal, setting)
    return (reasons[0].code, reasons[0].text) if isinstance(reasons, tuple) else ("", "")


# -- what things afford -----------------------------------------------------------------------------------------------


def test_what_can_be_taken_is_measured(setting: TaskContext) -> None:
    there = Affordances.of(setting)
    assert there.things == ("bowl", "ball", "block")
    assert there.containers == ("bowl", "cabinet.drawer", "cabinet.bottom_drawer")
    assert there.joints == ("cabinet.drawer", "cabinet.bottom_drawer")


@pytest.mark.parametrize(
    ("name", "code", "said"),
    [
        ("wide", "too_wide", "12"),
        ("heavy", "too_heavy", "3.77 kg, but the robot lifts 2 kg"),
        ("far", "out_of_reach", "1.20 m from `arm`, which reaches 0.855 m"),
        ("desk", "fixed", "fixed"),
    ],
)
def test_what_cannot_be_taken_says_why(setting: TaskContext, name: str, code: str, said: str) -> None:
    reasons = setting.cannot_take(name)
    assert [r.code for r in reasons] == [code]
    assert said in reasons[0].text


def test_fingers_measure_a_ball_at_its_equator_and_a_bowl_at_its_wall(setting: TaskContext) -> None:
    def width(name: str) -> float:
        return grasp_width(solid(setting.twin.item_at(name, setting.twin.state.poses[name])))

    assert width("ball") == pytest.approx(0.067, abs=0.002)
    assert width("block") == pytest.approx(0.03, abs=0.002)
    assert width("wide") == pytest.approx(0.12, abs=0.003)
    assert 0.004 < width("bowl") < 0.02


# -- proposals --------------------------------------------------------------------------------------------------------


def test_every_accepted_task_has_a_witness_and_is_not_true_yet(setting: TaskContext, proposals: list[Proposal]) -> None:
    accepted = [p for p in proposals if p.accepted]
    assert {"ball_in_bowl", "block_in_bowl", "open_cabinet_drawer", "store_block_in_cabinet_drawer"} <= {
        p.name for p in accepted
    }
    for proposal in accepted:
        assert proposal.task is not None
        assert not setting.twin.judge(proposal.task.goal, setting.twin.state).value
        found = witness(setting, proposal.task.goal)
        assert isinstance(found, Witness)
        assert setting.twin.judge(proposal.task.goal, found.state).value


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
    _let_roll(folder / "tennis_ball.asset.yaml")
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


def test_no_two_proposals_mean_the_same(proposals: list[Proposal]) -> None:
    meanings = [meaning(p.task.goal) for p in proposals if p.accepted and p.task is not None]
    assert len(meanings) == len(set(meanings)) > 5


def test_no_two_proposals_are_done_by_one_state(setting: TaskContext, proposals: list[Proposal]) -> None:
    goals = {p.name: p.task.goal for p in proposals if p.accepted and p.task is not None}
    assert "ball_in_bowl" in goals and "ball_on_bowl" not in goals, "of the two the one that asks for more"
    for name, goal in goals.items():
        done = witness(setting, goal)
        assert isinstance(done, Witness)
        same = [n for n, g in goals.items() if n != name and set(objects_of(g)) == set(objects_of(goal))]
        assert [n for n in same if setting.twin.judge(goals[n], done.state).value] == []


def test_of_two_stated_tasks_the_one_that_asks_for_more_stays(setting: TaskContext) -> None:
    def stated(*goals: object) -> list[tuple[str, str]]:
        proposed = Proposals(setting)
        for k, goal in enumerate(goals):
            made = task(f"task_{k}", setting, "bench.scene.yaml", "Do it.", goal, {}, "")
            proposed.add(made.name, "", made)
        return [(p.name, p.reasons[0].text if p.reasons else "") for p in proposed.found]

    on, within = "OnTop(ball, bowl)", "Inside(ball, bowl)"
    assert stated(on) == [("task_0", "")], "what is stated alone is taken at its word"
    assert stated(within, on) == [("task_0", ""), ("task_1", "it is achieved whenever `task_0` is")]
    assert stated(on, within) == [("task_0", ""), ("task_1", "it is achieved whenever `task_0` is")]
    both = {"all": ("Open(cabinet.drawer)", "Open(cabinet.bottom_drawer)")}
    assert stated("Open(cabinet.drawer)", both) == [
        ("task_0", "it is achieved whenever the stricter task `task_1` is"),
        ("task_1", ""),
    ]


def test_the_same_seed_gives_the_same_and_another_another_order(setting: TaskContext, path: Path) -> None:
    first = enumerate_tasks(setting, 3, seed=1)
    assert enumerate_tasks(TaskContext.load(path), 3, seed=1) == first
    assert [p.name for p in enumerate_tasks(setting, 3, seed=2)] != [p.name for p in first]


def test_only_what_is_asked_for(setting: TaskContext) -> None:
    found = enumerate_tasks(setting, objects=("ball", "bowl"))
    assert found
    assert {name for p in found for name in ("block", "cabinet") if name in p.goal} == set()


def test_documents_pass_every_check_and_load_as_tasks(proposals: list[Proposal], path: Path) -> None:
    again = checked(proposals, path.parent)
    assert [p.accepted for p in again] == [p.accepted for p in proposals]
    for file in write(again, path.parent):
        loaded = load(file)
        assert isinstance(loaded.spec, TaskSpec)
        assert not loaded.findings
        assert not [d for d in lint(loaded) if d.file == str(file)]
    spec = load(path.parent / "ball_in_bowl.task.yaml").spec
    assert isinstance(spec, TaskSpec)
    assert spec.instruction == "Pick up the ball, then put it inside the bowl."
    assert list(spec.subtasks) == ["touch_ball", "pick_up_ball", "ball_in_bowl"]
    assert {"ball", "bowl"} == spec.reset.objects.keys()


# -- shelves ----------------------------------------------------------------------------------------------------------

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


def test_a_shelf_has_two_places_that_no_state_confuses(tmp_path: Path) -> None:
    setting = rooms(tmp_path, CASE.format(middle=0.22))
    found = {p.name: p for p in enumerate_tasks(setting)}
    assert {name: p.goal for name, p in found.items() if p.accepted} == {
        "cup_in_shelf": "Inside(cup, shelf)",
        "cup_on_top_of_shelf": "OnTop(cup, shelf) and not Inside(cup, shelf)",
    }
    top = found["cup_on_top_of_shelf"].task
    assert top is not None and top.instruction == "Pick up the cup, then put it on top of the shelf."
    within, above = (shown(setting, found[name].task.goal) for name in found if found[name].task is not None)  # type: ignore[union-attr]
    assert isinstance(within, float) and isinstance(above, float)
    assert min(within, above) < 0.24 and max(within, above) > 0.45, "on the middle board, and on the top"


def test_the_boards_of_a_rack_are_places_by_name(tmp_path: Path) -> None:
    setting = rooms(tmp_path, RACK)
    goals = [p.goal for p in enumerate_tasks(setting) if p.accepted]
    assert sorted(goals) == ["OnTop(cup, shelf.lower)", "OnTop(cup, shelf.upper)"]
    assert shown(setting, "OnTop(cup, shelf.lower)") == pytest.approx(0.105, abs=0.002)
    assert isinstance(accept("OnTop(cup, shelf)", setting), AcceptedTask), "what is stated is taken at its word"


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


def test_what_is_shut_in_cannot_be_taken(tmp_path: Path) -> None:
    for shut, codes in ((False, []), (True, ["covered"])):
        front = "      front: {shape: {box: [0.008, 0.5, 0.4575]}, pose: {xyz: [-0.096, 0, 0.22875]}}\n" * shut
        setting = rooms(tmp_path, CASE.format(middle=0.22) + front)
        inside = put(setting, "cup", Pose.of((0.62, 0.0, 0.228)), setting.twin.state)
        assert [r.code for r in setting.cannot_hold("cup", inside)] == codes


# -- acceptance -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("goal", "code", "said"),
    [
        ("Inside(ball, bucket)", "unknown_name", "no object is called `bucket`"),
        ("Inside(ball, cabinet.door)", "unknown_name", "`cabinet` has no part `door`"),
        ("Boiled(ball)", "bad_goal", "`Boiled` is not a predicate"),
        ("Inside(ball)", "bad_goal", "takes 2 arguments"),
        ("Inside(ball, ball)", "bad_goal", "needs two different objects"),
        ({"all": []}, "bad_goal", "has 0"),
        ({"not": "OnTop(ball, bowl)"}, "already_true", "at the start"),
        ({"not": "OnTop(bowl, desk)"}, "no_change", "only requires conditions to be false"),
        ("OnTop(bowl, desk)", "already_true", "touches `desk`"),
        ("Closed(cabinet.drawer)", "already_true", "0.0%"),
        ("Inside(block, ball)", "impossible", "no cavity"),
        ("Inside(cabinet, bowl)", "too_heavy", "lifts 2 kg"),
        ("OnTop(ball, block)", "impossible", "placements of `ball` (6.7 x 6.7 x 6.7 cm)"),
        ("Open(bowl)", "impossible", "bowl"),
        ("At(block, 1.3, 0)", "out_of_reach", "reaches 0.855 m"),
        ("Lifted(wide)", "too_wide", "fingers open"),
        ({"all": ["Inside(ball, bowl)", "OnTop(ball, cabinet)"]}, "impossible", "does not become true"),
    ],
)
def test_refused(setting: TaskContext, goal: object, code: str, said: str) -> None:
    found = why(setting, goal)
    assert found[0] == code, found
    assert said in found[1]


@pytest.mark.parametrize(
    "goal",
    [
        "RightOf(block, bowl)",
        "NextTo(ball, bowl)",
        "Lifted(ball)",
        {"any": ["OnTop(wide, bowl)", "OnTop(block, bowl)"]},
        {"all": ["Open(cabinet.drawer)", {"not": "Open(cabinet.bottom_drawer)"}]},
        {"all": ["Inside(ball, bowl)", "Released(ball)"]},
    ],
)
def test_accepted(setting: TaskContext, goal: object) -> None:
    assert isinstance(accept(goal, setting), AcceptedTask)


def test_a_duplicate_is_told_by_its_meaning(setting: TaskContext) -> None:
    first = AcceptedTask("first", {"all": ["Inside(ball, bowl)", "Released(ball)"]})
    refused = accept("In(ball, bowl)", setting, [first])
    assert isinstance(refused, tuple)
    (reason,) = refused
    assert (reason.code, reason.text) == ("duplicate", "it has the same goal as `first`")


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("Under(a, b)", "Above(b, a)"),
        ("RightOf(a, b)", "LeftOf(b, a)"),
        ("NextTo(a, b)", "NextTo(b, a)"),
        ({"all": ["Open(a)", "Inside(b, c)"]}, {"all": [{"all": ["Inside(b, c)"]}, "Open(a)", "Open(a)"]}),
        ({"not": {"not": "Open(a)"}}, "Open(a)"),
    ],
)
def test_one_meaning(one: object, other: object) -> None:
    assert meaning(one) == meaning(other)


def test_released_counts_where_nothing_else_says_it() -> None:
    assert meaning({"all": ["Lifted(a)", "Released(a)"]}) != meaning("Lifted(a)")
    assert meaning("Inside(a, b)") != meaning("Inside(b, a)")


# -- as an axis of a recipe -------------------------------------------------------------------------------------------


def test_a_choice_is_asked_again_in_each_layout(setting: TaskContext, path: Path) -> None:
    spec = load_scene(path).spec
    assert isinstance(spec, SceneSpec)
    axis = TaskAxis(count=1, objects=("ball", "bowl"))
    (choice,), seen = task_cousins(setting.twin, spec, axis, reference="bench.scene.yaml")
    assert len(seen) >= 1
    twin = setting.twin
    assert choice.reasons(twin, twin.state) == ()
    done = witness(setting, choice.spec.goal)
    assert isinstance(done, Witness)
    assert [r.code for r in choice.reasons(twin, done.state)] == ["already_true"]
    away = SceneState.of({**twin.state.poses, "ball": Pose.of((1.1, 0.3, 0.0335))}, twin.state.joints)
    assert [r.code for r in choice.reasons(twin, away)] == ["out_of_reach"]
