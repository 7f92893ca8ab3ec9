"""Code actions in a running server: corrections, rewrites of the same meaning, and all corrections at once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simfoundry.lint.draft import drafted
from simfoundry.spec.load import load_scene
from tests.editor.client import Server

SCENE = """\
simfoundry: scene/1
name: desk
materials: {oak: {density: 700}}
objects:
  desk: {shape: {box: [1, 1, 0.1]}, material: oak, fixed: true, pose: {xyz: [0, 0, -0.05]}}
  mug:
    shape: {cylinder: {radius: 0.04, height: 0.1}}
    mass: 0.3
    place: {on: desk, xy: [0.1, 0.2], yaw_deg: 30}
  can:
    shape: {cylinder: {radius: 0.04, height: 0.1}}
    material: oak
    pose: {xyz: [0.3, 0.2, 0.05], quat_wxyz: [0.9659, 0, 0, 0.2588]}  # turned
"""


def actions(server: Server, path: Path, text: str, word: str, only: str = "") -> dict[str, str]:
    """The texts after each action at a word, by title."""
    server.open(path, text)
    found = server.diagnostics(path)
    before = text[: text.index(word)]
    place = {"line": before.count("\n"), "character": len(before) - before.rfind("\n") - 1}
    context: dict[str, Any] = {"diagnostics": found} | ({"only": [only]} if only else {})
    document = {"uri": path.as_uri()}
    made = server.ask(
        "textDocument/codeAction", textDocument=document, range={"start": place, "end": place}, context=context
    )
    server.close(path)
    out = {}
    for action in made:
        (edit,) = action["edit"]["changes"][path.as_uri()]
        lines = text.splitlines(keepends=True)
        start, end = (
            sum(map(len, lines[: edit["range"][k]["line"]])) + edit["range"][k]["character"] for k in ("start", "end")
        )
        out[action["title"]] = text[:start] + edit["newText"] + text[end:]
    return out


def lowered(path: Path, text: str) -> dict[str, Any]:
    path.write_text(text)
    return dict(drafted(load_scene(path)).scene.by_name)


@pytest.mark.parametrize(
    ("word", "title", "line"),
    [
        ("mass: 0.3", "Write the density, 596.8 kg/m^3", "    density: 596.831"),
        ("place: {on", "Write the pose instead of the place", "    pose: {xyz: [0.1, 0.2, 0.0501], yaw_deg: 30}"),
        ("pose: {xyz: [0.3", "Write the mass, 0.3519 kg", "    mass: 0.351858"),
        ("pose: {xyz: [0.3", "Place it on 'desk' instead of a pose",
         "    place: {on: desk, xy: [0.3, 0.2], yaw_deg: 29.998658}  # turned"),
        ("quat_wxyz", "Normalize the quaternion",
         "    pose: {xyz: [0.3, 0.2, 0.05], quat_wxyz: [0.965929, 0, 0, 0.258808]}  # turned"),
        ("quat_wxyz", "Write the rotation as 'yaw_deg'",
         "    pose: {xyz: [0.3, 0.2, 0.05], yaw_deg: 29.998658}  # turned"),
        ("quat_wxyz", "Write the rotation as 'rpy_deg'",
         "    pose: {xyz: [0.3, 0.2, 0.05], rpy_deg: [0, 0, 29.998658]}  # turned"),
    ],
)  # fmt: skip
def test_rewrites_keep_the_scene(word: str, title: str, line: str, server: Server, project: Path) -> None:
    path = project / "desk.scene.yaml"
    after = actions(server, path, SCENE, word, "refactor")[title]
    assert line in after.splitlines() and len(set(after.splitlines()) ^ set(SCENE.splitlines())) <= 3
    old, new = lowered(path, SCENE), lowered(path, after)
    for name, item in old.items():
        assert np.linalg.norm(item.X_WO.p - new[name].X_WO.p) <= 1.1e-4 and item.X_WO.angle_to(new[name].X_WO) < 2e-4
        assert sum(k.mass for k in new[name].links) == pytest.approx(sum(k.mass for k in item.links), rel=1e-4)


def test_an_object_in_the_air_has_no_place(server: Server, project: Path) -> None:
    text = SCENE.replace("[0.3, 0.2, 0.05]", "[0.3, 0.2, 0.06]")
    made = actions(server, project / "air.scene.yaml", text, "pose: {xyz: [0.3")
    assert made and not any(title.startswith("Place it") for title in made)


def test_suggestions_are_offered_one_by_one_and_all_at_once(server: Server, project: Path) -> None:
    text = SCENE.replace("on: desk", "on: dsek").replace("density", "densty")
    made = actions(server, project / "slip.scene.yaml", text, "dsek")
    assert made["Replace 'dsek' by 'desk'"] == text.replace("dsek", "desk")
    everything = actions(server, project / "slip.scene.yaml", text, "dsek", "source.fixAll")
    assert everything == {"Apply 2 suggestions": SCENE}


def test_a_suggestion_that_would_be_wrong_as_well_is_not_offered(server: Server, project: Path) -> None:
    text = f"{SCENE}relations: [OnTop(mug, mgu)]\n"
    assert actions(server, project / "same.scene.yaml", text, "mgu", "quickfix") == {}


def test_a_warning_can_be_allowed_with_a_reason(server: Server, project: Path) -> None:
    text = SCENE.replace("{oak: {density: 700}}", "{oak: {density: 700}, ash: {density: 600}}")
    made = actions(server, project / "allow.scene.yaml", text, "ash", "quickfix")
    assert made["Remove 'ash'"] == SCENE
    assert "SF401: {ash: say why this is intended}" in made["Allow SF401 for 'ash'"]
