"""What the server shows, driven over standard input and output."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simfoundry.language_server.display.markdown import code_span, escaped, plain_text
from simfoundry.spec.change.format import format_text
from tests.editor.client import Message, Server, started
from tests.language_server.conftest import COMMAND, DESK

SCENE = """\
simfoundry: scene/1
name: desk
# The gap between two mugs,
# which several objects use.
parameters: {gap: 0.12}
materials:
  oak: {density: 700, friction: 0.5, color: [0.6, 0.4, 0.2]}
  clay: {density: 2000, friction: 0.32, color: "#ff2010"}
objects:
  desk: {shape: {box: [1, 1, 0.1]}, material: oak, fixed: true, pose: {xyz: [0, 0, -0.05]}}
  mug:
    shape: {cylinder: {radius: 0.04, height: 0.1}}
    material: clay
    place: {on: desk, xy: [0.1, 0]}
  cup:
    shape: {box: [0.05, 0.05, 0.05]}
    mass: 0.2
    repeat: {count: 3, step: $gap}
    place: {on: desk, left_of: mug}
cameras:
  front: {size: [64, 48], fov_deg: 40, pose: {xyz: [-1, 0, 0.5], look_at: [0, 0, 0]}}
relations: [OnTop(mug, desk)]
"""
RECIPE = """\
simfoundry: cousins/1
name: a
twin: desk.scene.yaml
scene: {anchor: desk, objects: {mug: [LeftOf]}}
"""
ALL = {"start": {"line": 0, "character": 0}, "end": {"line": 99, "character": 0}}


class Shown:
    """A document that is open in a server."""

    def __init__(self, server: Server, path: Path, text: str = SCENE) -> None:
        self.server, self.path, self.text = server, path, text
        server.open(path, text)
        self.found = server.diagnostics(path)

    def ask(self, method: str, **params: Any) -> Any:
        """The answer to a request about the document."""
        return self.server.ask_about(f"textDocument/{method}", self.path, **params)

    def hover(self, words: str, within: int = 0) -> str:
        """What is shown for the place where some words begin, moved by some characters."""
        before = self.text[: self.text.index(words) + within]
        return self.server.hover(self.path, before.count("\n"), len(before) - before.rfind("\n") - 1)

    def covered(self, within: Message) -> str:
        """The text of a range."""
        start, end = (self.offset(within[key]) for key in ("start", "end"))
        return self.text[start:end]

    def offset(self, position: Message) -> int:
        """The offset of a position; the texts here are in ASCII."""
        lines = self.text.splitlines(keepends=True)
        return sum(map(len, lines[: position["line"]])) + int(position["character"])


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """A running server whose editor shows pictures in hovers."""
    with started(COMMAND, tmp_path_factory.mktemp("shown").resolve(), options={"hoverPictures": True}) as running:
        yield running


@pytest.fixture
def desk(server: Server, project: Path) -> Iterator[Shown]:
    shown = Shown(server, project / "desk.scene.yaml")
    assert shown.found == []
    yield shown
    server.close(shown.path)


# -- hover ------------------------------------------------------------------------------------------------------------


def test_an_object_is_shown_with_its_mass_size_pose_and_picture(desk: Shown) -> None:
    text = desk.hover("mug:")
    assert "**mug** · cylinder · material `clay`" in text
    assert "1.005 kg  (2000 kg/m³ (clay) × 502.7 cm³)" in text  # 2000 * pi * 0.04^2 * 0.1
    assert "8 × 8 × 10 cm" in text and "[0.1, 0, 0.0501] m" in text
    assert re.search(r"rests on +desk", text)
    assert "0.00124, 0.00124, 0.000804 kg m²" in text  # m (3 r^2 + h^2) / 12 and m r^2 / 2
    picture = re.search(r"!\[mug\]\(data:image/png;base64,(.*)\)", text)
    assert picture is not None and len(picture[1]) < 27_000
    assert _share(_decoded(picture[1]), (1.0, 0.125, 0.063)) > 0.05


@pytest.mark.parametrize(
    ("words", "within", "expected"),
    [
        ("density: 700", 0, "**density** · number > 0\n\nDensity [kg/m^3]."),
        ("fov_deg", 3, "Vertical field of view [deg]"),
        ("40, pose", 1, "40° = 0.6981 rad"),
        ("material: clay", 11, "on oak       μ = 0.4, slides above 21.8°"),
        ("OnTop", 2, "At the start: **true**"),
        ("mug, desk)]", 1, "**mug** · cylinder"),
        ("$gap", 1, "**$gap** = 0.12"),
        ("front:", 2, "sees         desk, mug, cup_1, cup_2, cup_3"),
        ("cup:", 1, "The first of 3 copies, `cup_1`."),
        ("on: desk, left_of", 5, "**desk** · box · material `oak` · fixed"),
    ],
)
def test_hover(desk: Shown, words: str, within: int, expected: str) -> None:
    assert expected in desk.hover(words, within)


def test_hover_goes_on_while_the_text_is_broken(desk: Shown) -> None:
    desk.text = desk.text.replace("relations: [OnTop(mug, desk)]", "relations: [OnTop(mug, desk)\nx: {")
    desk.server.change(desk.path, desk.text)
    assert "1.005 kg" in desk.hover("mug:")
    names = [symbol["name"] for symbol in desk.ask("documentSymbol")]
    assert "objects" in names and "materials" in names
    assert desk.hover("x: {") == ""
    assert "Relations that should hold" in desk.hover("relations", 3)  # in the part that has changed
    assert desk.ask("formatting", options={"tabSize": 2, "insertSpaces": True}) == []


def test_hover_in_a_task_an_asset_and_a_recipe(server: Server, project: Path) -> None:
    (project / "desk.scene.yaml").write_text(DESK)
    asset = (
        "simfoundry: asset/1\nname: lid\nlinks:\n  base: {density: 500, parts: {a: {shape: {box: [0.1, 0.1, 0.1]}}}}\n"
    )
    asset += "  door: {density: 500, parts: {a: {shape: {box: [0.1, 0.1, 0.1]}}}}\n"
    asset += "joints:\n  hinge: {type: revolute, parent: base, child: door, axis: [0, 0, 1], limits_deg: [0, 90]}\n"
    lid = Shown(server, project / "lid.asset.yaml", asset)
    assert re.search(r"mass +0.5 kg  \(500 kg/m³ × 1 l\)", lid.hover("door:"))
    assert "0° to 90° (1.571 rad)" in lid.hover("hinge:")
    task = "simfoundry: task/1\nname: lift\nscene: desk.scene.yaml\ninstruction: Lift it.\ngoal: Lifted(mug)\n"
    lift = Shown(server, project / "lift.task.yaml", task)
    assert re.search(r"mass +0.3 kg  \(given\)", lift.hover("mug)"))
    assert "objects  desk, mug" in lift.hover("desk.scene.yaml")
    cousins = Shown(server, project / "a.cousins.yaml", RECIPE)
    assert "**desk** · box" in cousins.hover("desk, obj", 1)
    assert "0.3 kg" in cousins.hover("mug:", 1)


def test_an_editor_without_markdown_sees_plain_text() -> None:
    assert plain_text("**mug** · `clay`\n\n```text\nmass  1 kg\n```") == "mug · clay\n\nmass  1 kg"
    assert plain_text(f"**{escaped('2*$a*3')}** = 6") == "2*$a*3 = 6"


def test_what_is_shown_of_a_file_cannot_be_a_link(server: Server, project: Path) -> None:
    name = "](command:evil) <b>`*.png"
    (project / name).write_bytes(b"no image")
    text = DESK.replace("density: 700", f"density: 700, texture: '{name}'")
    shown = Shown(server, project / "a.scene.yaml", text).hover("](command")
    assert re.search(r"(?<!\\)[\[\]()<>`]", shown) is None and "evil" in shown
    assert code_span("a`[b](command:c)`\n\nd") == "`a'[b](command:c)' d`"


@pytest.mark.parametrize("value", ["x" * 200_000, "(" * 100_000 + "x", "a" + " " * 100_000 + "b"])
@pytest.mark.parametrize("place", ["name: {}\n", "relations:\n  - {}\n", "a: [{}]\n"])
def test_long_lines_do_not_stop_the_server(server: Server, project: Path, place: str, value: str) -> None:
    text = "simfoundry: scene/1\n" + place.format(value)  # with time that grows as the square, each took minutes
    shown = Shown(server, project / "a.scene.yaml", text)
    for offset in (text.index(value) + len(value) // 2, text.index(value) + len(value)):
        position = {"line": text.count("\n", 0, offset), "character": offset - text.rindex("\n", 0, offset) - 1}
        for method in ("hover", "completion", "signatureHelp"):
            shown.ask(method, position=position)
    shown.ask("semanticTokens/full")


# -- structure --------------------------------------------------------------------------------------------------------


def test_symbols_folding_and_selections(desk: Shown) -> None:
    symbols = {symbol["name"]: symbol for symbol in desk.ask("documentSymbol")}
    inside = {child["name"]: child for child in symbols["objects"]["children"]}
    assert list(inside) == ["desk", "mug", "cup"] and inside["mug"]["detail"] == "cylinder"
    assert desk.covered(inside["mug"]["range"]).startswith("mug:\n") and inside["mug"]["range"]["end"]["line"] == 13
    assert [one["name"] for one in symbols["relations"]["children"]] == ["OnTop(mug, desk)"]
    folds = {(one["startLine"], one["endLine"]): one.get("kind") for one in desk.ask("foldingRange")}
    assert folds[2, 3] == "comment" and {(5, 7), (8, 18), (10, 13), (14, 18)} <= folds.keys()
    (found,) = desk.ask("selectionRange", positions=[{"line": 13, "character": 18}])
    ranges = []
    while found:
        ranges.append(desk.covered(found["range"]))
        found = found.get("parent")
    assert ranges[:4] == ["desk", "on: desk", "{on: desk, xy: [0.1, 0]}", "place: {on: desk, xy: [0.1, 0]}"]
    assert ranges[-1] == SCENE


def test_links_lead_to_files_of_the_project(server: Server, project: Path) -> None:
    (project / "base.scene.yaml").write_text(DESK)
    text = "simfoundry: scene/1\nname: a\nextends: base.scene.yaml\n"
    text += "materials: {oak: {texture: /etc/hostname}}\nbackground: {mesh: ../missing.glb}\n"
    shown = Shown(server, project / "a.scene.yaml", text)
    (link,) = shown.ask("documentLink")
    assert shown.covered(link["range"]) == "base.scene.yaml"
    assert link["target"] == (project / "base.scene.yaml").as_uri()


def test_formatting_changes_only_what_differs(server: Server, project: Path) -> None:
    text = DESK.replace("density: 700", "density:   700.0").replace("objects:", "\n\n\nobjects:")
    for newline in ("\n", "\r\n"):
        shown = Shown(server, project / "desk.scene.yaml", text.replace("\n", newline))
        edits = shown.ask("formatting", options={"tabSize": 2, "insertSpaces": True})
        after = shown.text
        for edit in reversed(edits):
            start, end = (shown.offset(edit["range"][key]) for key in ("start", "end"))
            after = after[:start] + edit["newText"] + after[end:]
        assert after.replace("\r\n", "\n") == format_text(text)
        assert sum(len(shown.covered(edit["range"])) for edit in edits) < len(text) / 3  # one line is reordered
        server.close(shown.path)


# -- decorations ------------------------------------------------------------------------------------------------------


def test_hints_show_resolved_values(desk: Shown) -> None:
    hints = {desk.text[: desk.offset(one["position"])].splitlines()[-1].strip(): one["label"]
             for one in desk.ask("inlayHint", range=ALL)}  # fmt: skip
    assert hints == {
        "material: clay": "1.01 kg",
        "place: {on: desk, xy: [0.1, 0]}": "z 0.0501",
        "repeat: {count: 3, step: $gap": "= 0.12",
        "repeat: {count: 3, step: $gap}": "3 copies",
        "place: {on: desk, left_of: mug}": "z 0.0251",
    }
    few = desk.ask("inlayHint", range={"start": {"line": 12, "character": 0}, "end": {"line": 12, "character": 30}})
    assert [one["label"] for one in few] == ["1.01 kg"]


def test_names_and_predicates_are_tokens(desk: Shown) -> None:
    legend = desk.server.capabilities["semanticTokensProvider"]["legend"]["tokenTypes"]
    data = desk.ask("semanticTokens/full")["data"]
    found, line, column = list[tuple[int, str, str, int]](), 0, 0
    for k in range(0, len(data), 5):
        down, right, length, kind, modifiers = data[k : k + 5]
        line, column = line + down, right + (column if down == 0 else 0)
        word = desk.text.splitlines()[line][column : column + length]
        found.append((line, word, legend[kind], modifiers))
    assert found[:3] == [(4, "gap", "parameter", 1), (6, "oak", "type", 1), (7, "clay", "type", 1)]
    assert (12, "clay", "type", 0) in found and (13, "desk", "variable", 0) in found
    assert (17, "$gap", "parameter", 0) in found
    assert found[-3:] == [(21, "OnTop", "function", 0), (21, "mug", "variable", 0), (21, "desk", "variable", 0)]


def test_colors_keep_their_spelling(desk: Shown) -> None:
    rows, hexadecimal = desk.ask("documentColor")
    assert desk.covered(rows["range"]) == "[0.6, 0.4, 0.2]" and rows["color"]["green"] == 0.4
    assert desk.covered(hexadecimal["range"]) == '"#ff2010"' and hexadecimal["color"]["red"] == 1
    picked = {"red": 0, "green": 0.5, "blue": 1, "alpha": 1}
    labels = [
        [one["label"] for one in desk.ask("colorPresentation", range=color["range"], color=picked)]
        for color in (rows, hexadecimal)
    ]
    assert labels == [["[0, 0.5, 1]", '"#0080ff"'], ['"#0080ff"', "[0, 0.5, 1]"]]


# -- pictures ---------------------------------------------------------------------------------------------------------


def _decoded(text: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(base64.b64decode(text))).convert("RGB"), dtype=np.float64) / 255


def _share(image: np.ndarray[Any, np.dtype[np.float64]], color: tuple[float, float, float]) -> float:
    """The share of the pixels whose hue is that of a color; shading changes only the brightness."""
    wanted = np.array(color) / np.linalg.norm(color)
    length = np.linalg.norm(image, axis=2)
    return float(((image @ wanted > 0.97 * length) & (length > 0.1)).mean())


def test_the_preview_follows_the_text(desk: Shown) -> None:
    uri = desk.path.as_uri()
    first = desk.server.ask("simfoundry/preview", uri=uri, width=160, height=120)
    assert (first["version"], first["message"], first["width"], first["height"]) == (1, None, 160, 120)
    assert _share(_decoded(first["png"]), (1.0, 0.125, 0.063)) > 0.01
    desk.server.change(desk.path, desk.text.replace('"#ff2010"', '"#1020ff"'))
    changed = desk.server.notice("simfoundry/previewChanged")
    assert changed["uri"] == uri and changed["version"] > 1
    second = desk.server.ask("simfoundry/preview", uri=uri, width=160, height=120)
    image = _decoded(second["png"])
    assert second["version"] == changed["version"]
    assert _share(image, (0.063, 0.125, 1.0)) > 0.01 and _share(image, (1.0, 0.125, 0.063)) == 0
    desk.server.change(desk.path, desk.text.replace("on: desk", "on: dsk"))
    third = desk.server.ask("simfoundry/preview", uri=uri, width=160, height=120)
    assert third["png"] == second["png"] and "earlier text" in third["message"]


def test_the_preview_is_seen_from_where_it_is_asked(desk: Shown) -> None:
    uri = desk.path.as_uri()
    above = desk.server.ask("simfoundry/preview", uri=uri, elevation_deg=500, distance=3, width=99999, height=4)
    assert (above["width"], above["height"], above["distance"]) == (1920, 16, 3)
    assert above["elevation_deg"] < 90
    odd = desk.server.ask("simfoundry/preview", uri=uri, azimuth_deg="x", distance=None, width=True, height=[1])
    assert (odd["width"], odd["height"]) == (640, 480) and odd["png"]


def test_assets_tasks_and_recipes_have_a_preview(server: Server, project: Path) -> None:
    (project / "desk.scene.yaml").write_text(DESK)
    texts = {
        "cube.asset.yaml": "simfoundry: asset/1\nname: cube\nlinks:\n  base: {density: 9, color: [0, 1, 0],"
        " parts: {a: {shape: {box: [0.1, 0.1, 0.1]}}}}\n",
        "lift.task.yaml": "simfoundry: task/1\nname: lift\nscene: desk.scene.yaml\ninstruction: Lift it.\n"
        "goal: Lifted(mug)\nstart: {place: {mug: {on: desk, xy: [0.2, 0.2]}}}\n",
        "a.cousins.yaml": RECIPE,
    }
    for name, text in texts.items():
        shown = Shown(server, project / name, text)
        answer = server.ask("simfoundry/preview", uri=shown.path.as_uri(), width=80, height=60)
        assert answer["png"] and answer["message"] is None, name
        if name.startswith("cube"):
            assert _share(_decoded(answer["png"]), (0.0, 1.0, 0.0)) > 0.1


def test_a_document_with_errors_has_no_preview_yet(server: Server, project: Path) -> None:
    shown = Shown(server, project / "bad.scene.yaml", DESK.replace("on: desk", "on: dsk"))
    answer = server.ask("simfoundry/preview", uri=shown.path.as_uri())
    assert answer["png"] is None and answer["message"].endswith("has errors.")
    answer = server.ask("simfoundry/preview", uri="file:///nowhere/a.scene.yaml")
    assert answer["png"] is None
