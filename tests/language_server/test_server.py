"""The server, driven over standard input and output."""

from __future__ import annotations

from pathlib import Path

from tests.editor.client import Server
from tests.language_server.conftest import DESK

TASK = """\
simfoundry: task/1
name: lift
scene: desk.scene.yaml
instruction: Lift the mug.
goal: LeftOf(mug, desk)
allow: {SF442: no robot yet}
"""


def codes(found: list[dict[str, object]]) -> list[object]:
    return [diagnostic["code"] for diagnostic in found]


def test_findings_follow_the_text(server: Server, project: Path) -> None:
    path = project / "desk.scene.yaml"
    server.open(path, DESK)
    assert server.diagnostics(path) == []
    server.change(path, DESK.replace("on: desk", "on: dsk"))
    (finding,) = server.diagnostics(path)
    assert finding["code"] == "SF201" and "did you mean `desk`?" in finding["message"]
    assert finding["range"] == {"start": {"line": 6, "character": 79}, "end": {"line": 6, "character": 82}}
    server.change(path, DESK.replace("on: desk", "on: desk, z: 1"))
    assert codes(server.diagnostics(path)) == ["SF101"]
    server.change(path, DESK.replace("{on: desk}", "{on: desk"))
    assert codes(server.diagnostics(path)) == ["SF002"]
    server.change(path, DESK)
    assert server.diagnostics(path) == []


def test_lints_run_while_typing(server: Server, project: Path) -> None:
    path = project / "desk.scene.yaml"
    server.open(path, DESK + "relations: [LeftOf(mug, desk)]\n")
    assert codes(server.diagnostics(path)) == ["SF406"]


def test_parts_of_a_text_change(server: Server, project: Path) -> None:
    path = project / "desk.scene.yaml"
    server.open(path, "# 😀 é\n" + DESK)
    assert server.diagnostics(path) == []
    at = {"line": 0, "character": 4}  # behind the emoji, which has two code units
    server.change(path, " {", start=at, end=at)
    assert server.diagnostics(path) == []
    server.change(path, "x", start={"line": 1, "character": 0}, end={"line": 1, "character": 10})
    assert codes(server.diagnostics(path)) == ["SF006"]


def test_a_task_follows_its_scene(server: Server, project: Path) -> None:
    scene, task = project / "desk.scene.yaml", project / "lift.task.yaml"
    scene.write_text(DESK)
    server.open(task, TASK)
    assert server.diagnostics(task) == []
    server.open(scene, DESK)
    assert server.diagnostics(scene) == []
    server.change(scene, DESK.replace("mug:", "cup:"))
    assert server.diagnostics(scene) == []
    assert server.last_diagnostics(task, "SF201")[0]["message"].startswith("no object is called `mug`")
    server.close(scene)  # without saving
    assert server.last_diagnostics(task) == []


def test_other_yaml_is_left_alone(server: Server, project: Path) -> None:
    other, ours = project / "compose.yaml", project / "desk.scene.yaml"
    server.open(other, "services: {web: {image: x}}\n")
    server.open(ours, DESK)
    assert server.diagnostics(ours) == []
    assert other.as_uri() not in [uri for uri, queue in server.published.items() if not queue.empty()]


def test_documents_that_are_not_open_follow_too(server: Server, project: Path) -> None:
    scene, task = project / "desk.scene.yaml", project / "lift.task.yaml"
    scene.write_text(DESK)
    task.write_text(TASK)
    server.open(scene, DESK.replace("mug:", "cup:"))
    assert server.diagnostics(scene) == []
    assert server.last_diagnostics(task, "SF201")[0]["range"]["start"] == {"line": 4, "character": 13}
    server.close(scene)
    assert server.last_diagnostics(task) == []
