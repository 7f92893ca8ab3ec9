"""`capture --tasks N` ends in tasks that pass `simfoundry check`; a person's edits of them survive."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from simfoundry.capture.findings import FEW_TASKS
from simfoundry.capture.outputs.output_folder import PreviousOutput
from simfoundry.capture.tasks import SceneTasks, TaskRequest, write_tasks
from simfoundry.errors import SimfoundryError
from tests.cli.command import run

COLOR = np.zeros((4, 6, 3), np.uint8)


def found(scene: Path, count: int, picture: bytes) -> SceneTasks:
    """Two tasks at most."""
    assert scene.name == "two.scene.yaml" and picture.startswith(b"\x89PNG")
    names = ["a", "b"][:count]
    return SceneTasks({f"{n}.task.yaml": b"new" for n in names}, {n: f"Do {n}." for n in names})


def test_tasks_are_written_beside_the_scene_and_edits_are_kept(tmp_path: Path) -> None:
    last = tmp_path / "last"
    last.mkdir()
    (last / "a.task.yaml").write_text("mine")
    previous = PreviousOutput(last, kept=("masks.png",), edited=("a.task.yaml", "two.scene.yaml"))
    out = tmp_path / "out"
    written = write_tasks(TaskRequest(2, found), out / "two.scene.yaml", COLOR, previous, lambda stage, share: None)
    assert written.instructions == {"a": "Do a.", "b": "Do b."} and not written.findings
    assert written.edited == ("a.task.yaml",)
    assert [(out / f"{n}.task.yaml").read_text() for n in "ab"] == ["mine", "new"]


def test_too_few_tasks_are_a_finding(tmp_path: Path) -> None:
    def refused(*_: object) -> SceneTasks:
        raise SimfoundryError("the scene does\nnot come to rest")

    scene, previous = tmp_path / "two.scene.yaml", PreviousOutput(tmp_path / "none")
    for find, message in (
        (found, "2 of 5 requested tasks were found"),
        (refused, "0 of 5 requested tasks were found; the scene does not come to rest"),
    ):
        written = write_tasks(TaskRequest(5, find), scene, COLOR, previous, lambda stage, share: None)
        assert [(f.code, f.message) for f in written.findings] == [(FEW_TASKS, message)]
    nothing = write_tasks(None, scene, COLOR, previous, lambda stage, share: None)
    assert nothing.to_json() == {} and not nothing.findings


@pytest.mark.slow  # 4 s: two runs, and the search for tasks
def test_a_capture_ends_in_tasks(folder: Path) -> None:
    out = folder / "out"
    done = run("capture", folder / "capture", "-o", out, "--tasks", "1", "--json")
    assert done.code in (0, 1) and list(done.json["tasks"]) == [p.name.split(".")[0] for p in out.glob("*.task.yaml")]
    codes = {f["code"] for f in done.json["findings"]}
    assert len(done.json["tasks"]) == 1 and FEW_TASKS not in codes
    (task,) = out.glob("*.task.yaml")
    assert run("check", task).code == 0 and "scene: capture.scene.yaml" in task.read_text()
    assert f"<li>{task.name.split('.')[0]}: " in (out / "report.html").read_text()
    task.write_text(f"{task.read_text()}# mine\n")
    for _ in range(2):
        again = run("capture", folder / "capture", "-o", out, "--tasks", "50", "--json")
        assert again.code == 1 and task.read_text().endswith("# mine\n")
        assert FEW_TASKS in {f["code"] for f in again.json["findings"]}
        assert task.name in json.loads((out / "report.json").read_text())["edited"]


@pytest.mark.slow  # 3 s: a run, and the search for tasks
def test_a_model_proposes_tasks_and_affordances_fill_up(folder: Path) -> None:
    pytest.importorskip("pydantic_ai", reason="the extra `vlm` is not installed")
    from pydantic_ai.models.test import TestModel

    from simfoundry.cousins.tasks.scene_tasks import task_request
    from simfoundry.models.vlm import Vlm

    (scene,) = (folder / "out").glob("*.scene.yaml")
    boxes = [name for name in ("green_box", "red_box", "blue_box") if f"{name}:" in scene.read_text()]
    goal = {"state": "OnTop", "group": boxes[0], "other_group": boxes[1]}
    told = {"task_name": "pile", "instruction": "Make a pile.", "goal_predicates_all": [goal]}
    impossible = {"task_name": "fly", "goal_predicates_all": [goal | {"other_group": "moon"}]}
    vlm = Vlm(TestModel(custom_output_args={"tasks": [told, impossible]}), mode="tool")
    picture = (folder / "capture" / "color.png").read_bytes()
    made = task_request(2, vlm=vlm).find(scene, 2, picture)
    assert next(iter(made.documents)) == "pile.task.yaml" and len(made.documents) == 2 and not made.problems
    assert made.instructions["pile"] == "Make a pile." and "fly" not in made.instructions
    broken = Vlm(TestModel(custom_output_args={"tasks": 3}), mode="tool")
    less = task_request(1, vlm=broken).find(scene, 1, picture)
    assert len(less.documents) == 1 and "the model for tasks failed" in less.problems[0]
