"""Definitions, references and symbols, over standard input and output."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

from tests.editor.client import Message, Server
from tests.language_server.conftest import DESK
from tests.language_server.test_server import TASK

CABINET = """\
simfoundry: asset/1
name: cabinet
materials: {oak: {density: 700, friction: 0.5}}
links:
  body: {shape: {box: [0.4, 0.4, 0.4]}, material: oak}
  tray: {shape: {box: [0.3, 0.3, 0.1]}, material: oak}
joints:
  drawer: {type: prismatic, parent: body, child: tray, axis: [1, 0, 0], range: [0, 0.2]}
"""
SCENE = DESK + "  cabinet: {asset: cabinet.asset.yaml, place: {on: desk, left_of: mug}}\n"
OVERLAY = "simfoundry: scene/1\nextends: desk.scene.yaml\nname: heavy\nobjects:\n  mug: {mass: 0.5}\n"
OPEN = TASK.replace("goal: LeftOf(mug, desk)", "goal: {all: [Open(cabinet.drawer), 'LeftOf(mug, cabinet)']}")


def make(server: Server, project: Path) -> dict[str, Path]:
    texts = {"cabinet.asset": CABINET, "desk.scene": SCENE, "heavy.scene": OVERLAY, "open.task": OPEN}
    paths = {name: project / f"{name}.yaml" for name in texts}
    for name, path in paths.items():
        path.write_text(texts[name])
    for name in ("desk.scene", "open.task"):
        server.open(paths[name], texts[name])
    return paths


def spot(path: Path, words: str, at: str) -> Message:
    """The position at which ``at`` starts in the first line that contains ``words``."""
    line, text = next((k, text) for k, text in enumerate(path.read_text().splitlines()) if words in text)
    position = {"line": line, "character": text.index(at, text.index(words))}
    return {"textDocument": {"uri": path.as_uri()}, "position": position}


def places(locations: list[Message]) -> list[tuple[str, int, int]]:
    """The files, lines and columns of locations."""
    starts = [(one["uri"].rpartition("/")[2], one["range"]["start"]) for one in locations]
    return sorted((name, start["line"], start["character"]) for name, start in starts)


def test_definitions_across_documents(server: Server, project: Path) -> None:
    paths = make(server, project)
    task = paths["open.task"]
    found = server.ask("textDocument/definition", **spot(task, "LeftOf", "mug"))
    assert places(found) == [("desk.scene.yaml", 6, 2)]
    found = server.ask("textDocument/definition", **spot(task, "Open", "drawer"))
    assert places(found) == [("cabinet.asset.yaml", 7, 2)]
    found = server.ask("textDocument/definition", **spot(task, "instruction", "Lift"))
    assert found == []
    found = server.ask("textDocument/definition", **spot(paths["desk.scene"], "asset:", "cabinet.asset"))
    assert places(found) == [("cabinet.asset.yaml", 0, 0)]


def test_references_across_documents(server: Server, project: Path) -> None:
    scene = make(server, project)["desk.scene"]
    mug = spot(scene, "  mug:", "mug")
    found = server.ask("textDocument/references", **mug, context={"includeDeclaration": True})
    assert places(found) == [
        ("desk.scene.yaml", 6, 2),
        ("desk.scene.yaml", 7, 66),
        ("heavy.scene.yaml", 4, 2),
        ("open.task.yaml", 4, 43),
    ]
    without = server.ask("textDocument/references", **mug, context={"includeDeclaration": False})
    assert len(without) == 3
    highlights = server.ask("textDocument/documentHighlight", **mug)
    assert [(one["range"]["start"]["line"], one["kind"]) for one in highlights] == [(6, 3), (7, 2)]


def test_symbols_of_the_project(server: Server, project: Path) -> None:
    make(server, project)
    found = server.ask("workspace/symbol", query="drw")
    here = [one for one in found if project.name in one["location"]["uri"]]
    assert [(one["name"], one["containerName"]) for one in here] == [("drawer", "joint in cabinet.asset.yaml")]


def applied(edit: Message) -> dict[str, str]:
    """The texts after an edit of files on disk."""
    texts = {}
    for change in edit["documentChanges"]:
        path = Path(unquote(urlsplit(change["textDocument"]["uri"]).path))
        lines = path.read_text().split("\n")
        for one in sorted(change["edits"], key=lambda one: one["range"]["start"]["character"], reverse=True):
            start, end = one["range"]["start"], one["range"]["end"]
            row = lines[start["line"]]
            lines[start["line"]] = row[: start["character"]] + one["newText"] + row[end["character"] :]
        texts[path.name] = "\n".join(lines)
    return texts


def test_rename_across_documents(server: Server, project: Path) -> None:
    paths = make(server, project)
    drawer = spot(paths["open.task"], "Open", "drawer")
    ready = server.ask("textDocument/prepareRename", **drawer)
    assert ready["placeholder"] == "drawer" and ready["range"]["start"] == drawer["position"]
    assert applied(server.ask("textDocument/rename", **drawer, newName="tray_slide")) == {
        "cabinet.asset.yaml": CABINET.replace("  drawer:", "  tray_slide:"),
        "open.task.yaml": OPEN.replace("cabinet.drawer", "cabinet.tray_slide"),
    }
    mug = spot(paths["desk.scene"], "  mug:", "mug")
    assert applied(server.ask("textDocument/rename", **mug, newName="cup")) == {
        "desk.scene.yaml": SCENE.replace("mug", "cup"),
        "heavy.scene.yaml": OVERLAY.replace("mug", "cup"),
        "open.task.yaml": OPEN.replace("LeftOf(mug", "LeftOf(cup"),
    }


def test_renames_that_are_refused(server: Server, project: Path) -> None:
    paths = make(server, project)
    mug = spot(paths["desk.scene"], "  mug:", "mug")
    for name, reason in {"desk": "desk.scene.yaml:6:3", "My Mug": "name", "world": "world"}.items():
        with pytest.raises(RuntimeError, match=reason):
            server.ask("textDocument/rename", **mug, newName=name)
    nothing = spot(paths["open.task"], "instruction", "Lift")
    assert server.ask("textDocument/prepareRename", **nothing) is None
    server.change(paths["open.task"], OPEN + "subtasks: {")
    with pytest.raises(RuntimeError, match=r"open\.task\.yaml"):
        server.ask("textDocument/rename", **mug, newName="cup")
