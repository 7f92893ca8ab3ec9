"""Tasks that are enumerated from affordances, and that become an axis of a recipe."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.cousins.tasks.acceptance import AcceptedTask, accept
from simfoundry.cousins.tasks.candidate_poses import meaning, objects_of
from simfoundry.cousins.tasks.context import TaskContext
from simfoundry.cousins.tasks.enumeration import Proposal, Proposals, checked, enumerate_tasks, task, write
from simfoundry.cousins.tasks.proposals import task_cousins
from simfoundry.cousins.tasks.witness import Witness, witness
from simfoundry.errors import OutputError
from simfoundry.geometry.frames import Pose
from simfoundry.lint.lints import lint
from simfoundry.scene.state import SceneState
from simfoundry.spec.load import load, load_scene
from simfoundry.spec.models.cousins import TaskAxis
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import TaskSpec
from tests.cousins.tasks.rooms import CASE, RACK, rooms, shown


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


def test_the_same_seed_gives_the_same_and_another_another_order(setting: TaskContext, bench: Path) -> None:
    first = enumerate_tasks(setting, 3, seed=1)
    assert enumerate_tasks(TaskContext.load(bench), 3, seed=1) == first
    assert [p.name for p in enumerate_tasks(setting, 3, seed=2)] != [p.name for p in first]


def test_only_what_is_asked_for(setting: TaskContext) -> None:
    found = enumerate_tasks(setting, objects=("ball", "bowl"))
    assert found
    assert {name for p in found for name in ("block", "cabinet") if name in p.goal} == set()


def test_documents_pass_every_check_and_load_as_tasks(proposals: list[Proposal], bench: Path) -> None:
    again = checked(proposals, bench.parent)
    assert [p.accepted for p in again] == [p.accepted for p in proposals]
    for file in write(again, bench.parent):
        loaded = load(file)
        assert isinstance(loaded.spec, TaskSpec)
        assert not loaded.findings
        assert not [d for d in lint(loaded) if d.file == str(file)]
    spec = load(bench.parent / "ball_in_bowl.task.yaml").spec
    assert isinstance(spec, TaskSpec)
    assert spec.instruction == "Pick up the ball, then put it inside the bowl."
    assert list(spec.subtasks) == ["touch_ball", "pick_up_ball", "ball_in_bowl"]
    assert {"ball", "bowl"} == spec.reset.objects.keys()


def test_an_edited_task_is_replaced_only_if_that_is_asked(proposals: list[Proposal], tmp_path: Path) -> None:
    files = write(proposals, tmp_path)
    assert write(proposals, tmp_path) == files
    written = files[-1].read_text()
    files[-1].write_text(written + "# my edit\n")
    files[0].unlink()
    with pytest.raises(OutputError, match=f"{files[-1].name} exists and differs from what would be written"):
        write(proposals, tmp_path)
    assert files[-1].read_text().endswith("# my edit\n") and not files[0].exists()
    write(proposals, tmp_path, force=True)
    assert files[-1].read_text() == written


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


def test_a_choice_is_asked_again_in_each_layout(setting: TaskContext, bench: Path) -> None:
    spec = load_scene(bench).spec
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
