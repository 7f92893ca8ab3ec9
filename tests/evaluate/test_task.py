"""Tasks are lowered as they start; each step is a task of its own; what is wrong is said at its place."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.rollouts.execution import physics_steps
from simfoundry.evaluate.task import Task, load_task, need_robots
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.models.robot_file import OWN_ROBOTS
from tests.conftest import REPOSITORY
from tests.evaluate.benches import SCENE, TASK, write_bench

TASKS = REPOSITORY / "specs" / "tasks"


def test_a_task_stands_as_its_document_says(push: Task) -> None:
    assert (push.name, push.robots, push.horizon, push.control_hz) == ("push", ("arm",), 45, 15.0)
    assert list(push.subtasks) == ["touch", "away"]
    assert push.subtasks["touch"].instruction == "Push the block away."
    assert push.subtasks["away"].instruction == "Only push."
    assert push.carriers == {"block": "table", "dish": "table", "crumb": "dish"}
    need_robots(push)


def test_a_step_alone_starts_as_it_says_and_has_its_own_goal(push: Task) -> None:
    alone = push.alone("away")
    assert alone.scene.object("block").X_WO.p[0] == pytest.approx(0.4)
    assert alone.goal == "At(block, 0.45, 0)" and alone.instruction == "Only push."
    assert list(alone.subtasks) == ["away"] and alone.step == "away"
    assert list(alone.reset.objects) == ["dish"]  # the block stays where the step puts it
    assert push.scene.object("block").X_WO.p[0] == pytest.approx(0.32)
    rest = push.onward("away")
    assert rest.goal == push.goal and rest.instruction == push.instruction and list(rest.subtasks) == ["away"]


def test_an_unknown_step_is_refused_with_what_was_meant(push: Task) -> None:
    with pytest.raises(SimfoundryError, match=r"task `push` has no sub-task `awy`; did you mean `away`\?"):
        push.alone("awy")


def test_starts_of_steps_open_drawers_and_fill_them() -> None:
    task = load_task(TASKS / "store_marker.task.yaml")
    assert _drawer(task) == 0.0
    assert "Closed(cabinet.drawer)" in map(str, task.scene.relations)
    last = task.alone("close_drawer")
    assert _drawer(last) == 0.15
    assert "Closed(cabinet.drawer)" not in map(str, last.scene.relations)  # it need not hold any longer
    assert last.carriers["marker"] == "cabinet" and list(last.reset.objects) == ["cabinet"]
    assert last.scene.object("marker").X_WO.p[2] > 0.05  # in the drawer, not on the desk


def _drawer(task: Task) -> float:
    return next(j.position for j in task.scene.object("cabinet").joints if j.name == "drawer")


def test_what_a_start_cannot_do_is_said_where_it_stands(tmp_path: Path) -> None:
    text = TASK.replace("xy: [0.4, 0]", "xy: [4, 0]")
    task = load_task(write_bench(tmp_path, text))
    with pytest.raises(SpecError) as caught:
        task.alone("away")
    (finding,) = caught.value.diagnostics
    assert finding.code == "SF210" and "`block` at (4.000, 0.000) is not above `table`" in finding.message
    assert Path(finding.file).name == "push.task.yaml" and finding.path == "subtasks.away.start.place.block"
    assert "place: {block" in text.splitlines()[finding.line - 1]


@pytest.mark.parametrize(
    ("changed", "code", "message"),
    [
        (("goal: At(", "goal: Near("), "SF2", "Near"),
        (("scene: bench.scene.yaml", "scene: none.scene.yaml"), "SF", "none.scene.yaml"),
        (("    dish: {x", "    plate: {x"), "SF201", "plate"),
    ],
)
def test_bad_documents_are_findings(tmp_path: Path, changed: tuple[str, str], code: str, message: str) -> None:
    with pytest.raises(SpecError) as caught:
        load_task(write_bench(tmp_path, TASK.replace(*changed)))
    assert any(d.code.startswith(code) and message in d.message for d in caught.value.diagnostics)


def test_a_scene_is_no_task(push_file: Path) -> None:
    with pytest.raises(SpecError, match="expected a `task/1` document"):
        load_task(push_file.with_name("bench.scene.yaml"))


def test_a_robot_that_is_not_there_is_missed_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "yam.yaml").write_text("mjcf: {file: gone.xml}\nurdf: {file: gone.urdf}\n")
    monkeypatch.setenv(OWN_ROBOTS, str(tmp_path))
    scene = SCENE.replace("{mjcf: arm.xml}", "yam").replace("mount: arm.boom", "mount: arm")
    task = load_task(write_bench(tmp_path, scene=scene))
    with pytest.raises(
        SimfoundryError, match=r"task `push` needs robot `arm`, which is not available: no model found: .*"
    ):
        need_robots(task)


def test_control_steps_never_drift_from_their_rate() -> None:
    steps = [physics_steps(k, 15.0, 0.002) for k in range(150)]
    assert sum(steps) == 5000 and set(steps) == {33, 34}  # 10 s to the step
    assert {physics_steps(k, 10.0, 0.002) for k in range(99)} == {50}
    assert physics_steps(7, 1000.0, 0.002) == 1  # never none, though the physics is slower than that
