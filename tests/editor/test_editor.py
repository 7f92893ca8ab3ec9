"""What a person sees in an editor: the real language server, driven as an editor drives it."""

from __future__ import annotations

import itertools
import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from simfoundry.spec.editor.reference import example
from simfoundry.spec.models.kinds import KINDS, is_document
from simfoundry.spec.models.predicate import built_in_predicates
from simfoundry.spec.models.robot_file import robot_names
from tests.conftest import REPOSITORY
from tests.editor.client import Message, Server

SCENE = "simfoundry: scene/1\nname: a\n"
OVERLAY = SCENE + "extends: b.scene.yaml\n"
OBJECT = SCENE + "objects:\n  cup:\n    "
TASK = "simfoundry: task/1\nname: a\nscene: a.scene.yaml\ninstruction: Do it.\n"
ASSET = "simfoundry: asset/1\nname: a\n"
COUSINS = "simfoundry: cousins/1\nname: a\ntwin: a.scene.yaml\n"

Ask = Callable[[str], Any]
_count = itertools.count()


class Editor:
    """A server, and documents with a ``|`` where the cursor stands."""

    def __init__(self, server: Server, folder: Path) -> None:
        self.server, self.folder = server, folder

    def open(self, text: str) -> tuple[Path, int, int]:
        """Open a text under a name of its own; the line and column of its cursor."""
        kind = re.search(r"simfoundry: (\w+)/1", text)
        name = kind[1] if kind else "scene"
        text = f"# yaml-language-server: $schema=schemas/{name}.schema.json#/$defs/Editor\n{text}"
        before, cursor, after = text.partition("|")
        path = self.folder / f"t{next(_count)}.{name}.yaml"
        self.server.open(path, before + after)
        line = before.count("\n") if cursor else 0
        return path, line, len(before) - before.rfind("\n") - 1

    def offered(self, text: str) -> dict[str, Message]:
        """What completion offers at the cursor, by label."""
        path, line, character = self.open(text)
        return {item["label"]: item for item in self.server.completions(path, line, character)}

    def hover(self, text: str) -> str:
        """What is shown at the cursor, without its source line and escapes."""
        path, line, character = self.open(text)
        shown = self.server.hover(path, line, character)
        return re.sub(r"\n*Source: \[.*\Z", "", re.sub(r"\\([\\`*_{}\[\]#+!])", r"\1", shown))

    def problems(self, text: str) -> list[tuple[str, str]]:
        """Each diagnostic with the text that it underlines."""
        path, _, _ = self.open(text)
        return [(_underlined(text, found), found["message"]) for found in self.server.diagnostics(path)]


def _underlined(text: str, found: Message) -> str:
    start, end = found["range"]["start"], found["range"]["end"]
    line: str = text.splitlines()[start["line"] - 1]  # without the line that names the schema
    return line[start["character"] : end["character"] if start["line"] == end["line"] else None]


@pytest.fixture
def editor(server: Server, project: Path) -> Editor:
    return Editor(server, project)


def _words(item: Message) -> str:
    said = item.get("documentation", "")
    return str(said["value"] if isinstance(said, dict) else said)


def keys(kind: str, part: str) -> set[str]:
    """The keys of a part, as its schema has them."""
    schema = json.loads((REPOSITORY / "schemas" / f"{kind}.schema.json").read_text())
    return set(schema["$defs"][part]["properties"])


# -- completion -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "kind", "part"),
    [
        ("|", "scene", "Document"),
        (f"{OBJECT}|", "scene", "ObjectSpec"),
        (f"{OBJECT}shape:\n      |", "scene", "Shape"),
        (f"{OBJECT}pose:\n      |", "scene", "PoseSpec"),
        (f"{OBJECT}place:\n      |", "scene", "Place"),
        (f"{SCENE}robots:\n  arm:\n    |", "scene", "RobotSpec"),
        (f"{SCENE}cameras:\n  front:\n    |", "scene", "CameraSpec"),
        (f"{SCENE}materials:\n  wood:\n    |", "scene", "Material"),
        (f"{OVERLAY}objects:\n  cup:\n    |", "scene", "ObjectSpec"),
        (f"{OVERLAY}objects:\n  cup:\n    pose:\n      |", "scene", "PoseSpec"),
        (f"{TASK}subtasks:\n  pick:\n    |", "task", "Subtask"),
        (f"{TASK}reset:\n  |", "task", "Reset"),
        (f"{ASSET}joints:\n  slide:\n    |", "asset", "JointSpec"),
        (f"{COUSINS}distractors:\n  |", "cousins", "DistractorAxis"),
    ],
)
def test_keys_are_offered_with_their_words(editor: Editor, text: str, kind: str, part: str) -> None:
    offered = editor.offered(text)
    assert keys(kind, part) <= set(offered)
    assert [label for label, item in offered.items() if not _words(item)] == []


def test_keys_of_a_task_are_offered_and_those_written_are_not(editor: Editor) -> None:
    offered = editor.offered(f"{TASK}|")
    whole = "task"  # what is needed, at once
    assert set(offered) - {whole} == keys("task", "Document") - {"simfoundry", "name", "scene", "instruction"}
    assert all(_words(item) for item in offered.values())


@pytest.mark.parametrize(
    ("text", "first"),
    [
        (f"{OBJECT}shape: {{b|}}", {"box", "sphere", "cylinder", "capsule", "prism", "lathe"}),
        (f"{OBJECT}pose: {{xyz: [0, 0, 0], y|}}", {"yaw_deg", "rpy_deg", "quat_wxyz"}),
        (f"{SCENE}objects:\n  cup: {{fixed: true, m|}}", {"mass", "material"}),
    ],
)
def test_keys_are_offered_inside_braces_once_a_letter_stands(editor: Editor, text: str, first: set[str]) -> None:
    offered = editor.offered(text)
    assert first <= set(offered) and all(_words(item) for item in offered.values())


@pytest.mark.parametrize(
    ("text", "values"),
    [
        (f"{OBJECT}collision: |", {"auto", "hull", "decompose", "none"}),
        (f"{OBJECT}fixed: |", {"true", "false"}),
        (f"{SCENE}lights:\n  sky: {{type: |}}", {"distant", "point", "dome"}),
        (f"{ASSET}joints:\n  slide:\n    type: |", {"fixed", "revolute", "prismatic", "continuous"}),
        (f"{COUSINS}scene:\n  objects:\n    cup: [|]", {"LeftOf", "RightOf", "InFrontOf", "Behind", "OnTop"}),
        (f"{SCENE}robots:\n  arm: {{model: |}}", set(robot_names())),
        (f"{OVERLAY}objects:\n  cup:\n    mass: |", {"null"}),
        (f"{OVERLAY}objects:\n  cup: |", {"null"}),
    ],
)
def test_values_are_offered_each_with_its_own_words(editor: Editor, text: str, values: set[str]) -> None:
    offered = editor.offered(text)
    assert values <= set(offered)
    words = [_words(offered[value]) for value in values]
    assert all(words) and len(set(words)) == len(words)
    assert all(offered[value]["insertText"] == value for value in values)


@pytest.mark.parametrize(
    "text",
    [
        f"{SCENE}relations:\n  - |",
        f"{SCENE}relations: [|]",
        f"{TASK}goal: |",
        f"{TASK}goal:\n  all:\n    - |",
        f"{TASK}goal: OnTop(a, b)\nsubtasks:\n  pick:\n    goal: |",
    ],
)
def test_predicates_are_offered_with_their_meaning(editor: Editor, text: str) -> None:
    offered = editor.offered(text)
    for name, predicate in built_in_predicates().items():
        (label,) = (label for label in offered if label.startswith(f"{name}("))
        assert predicate.meaning[1:] in _words(offered[label])
        assert re.fullmatch(rf"{name}\((\$\{{\d:[a-z.]+\}}(, )?)+\)", offered[label]["insertText"])


def test_a_key_brings_a_first_value_in_the_canonical_form(editor: Editor) -> None:
    offered = editor.offered(f"{OBJECT}|")
    assert offered["pose"]["insertText"] == "pose: {xyz: [${1:0}, ${2:0}, ${3:0}]}"
    assert offered["scale"]["insertText"] == "scale: ${1:1}"
    assert "null" not in offered and not any("null" in item["insertText"] for item in offered.values())


# -- hover ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"{OBJECT}ma|ss: 0.3", "Mass [kg]."),
        (f"{OBJECT}ma|ss: {{value: 0.3}}", "Mass [kg]."),
        (f"{OBJECT}mass: {{val|ue: 0.3}}", "[kg, or kg/m^3]"),
        (f"{OBJECT}den|sity: 300", "Density [kg/m^3]"),
        (f"{OBJECT}po|se: {{yaw_deg: 10}}", "Pose of the object's frame in the world, or in `frame`."),
        (f"{OBJECT}pose: {{x|yz: [0, 0, 1]}}", "Position [m]; default: [0, 0, 0]."),
        (f"{OBJECT}pose: {{ya|w_deg: 10}}", "Rotation about z [deg]."),
        (f"{OBJECT}pla|ce: {{on: table}}", "Placement from which the pose is computed"),
        (f"{OBJECT}place: {{on: table, left_of: cup, g|ap: 0.05}}", "[m]; default: 0.03."),
        (f"{OBJECT}sha|pe: {{box: [1, 1, 1]}}", "A primitive."),
        (f"{OBJECT}shape: {{bo|x: [1, 1, 1]}}", "Full extents along x, y, z [m]."),
        (f"{OBJECT}shape: {{cyl|inder: {{radius: 1, height: 1}}}}", "Radius and height [m]."),
        (f"{OBJECT}shape: {{cylinder: {{ra|dius: 1, height: 1}}}}", "Radius [m];"),
        (f"{SCENE}gra|vity: [0, 0, -1.6]", "Gravitational acceleration [m/s^2]"),
        (f"{SCENE}objects:\n  cu|p: {{mass: 1}}", "An object in the scene"),
        (f"{SCENE}cameras:\n  front: {{f|x: 600}}", "Focal length in x [px]."),
        (f"{OVERLAY}objects:\n  cup: {{ma|ss: 0.3}}", "Mass [kg]."),
        (f"{OVERLAY}objects:\n  cup: {{po|se: {{yaw_deg: 10}}}}", "Pose of the object's frame in"),
        ("ext|ends: b.scene.yaml\n" + SCENE, "`null` removes"),
        (f"{TASK}goal: OnTop(a, b)\ncontrol|_hz: 15", "Control frequency [Hz]; default: 15."),
        (f"{TASK}goal: OnTop(a, b)\nreset: {{objects: {{cup: {{x|: [0, 1], y: [0, 1]}}}}}}", "in the world [m]"),
        (f"{ASSET}joints:\n  slide: {{lim|its: [0, 0.3]}}", "prismatic joint [m]"),
    ],
)
def test_a_key_shows_its_words_with_the_unit(editor: Editor, text: str, words: str) -> None:
    shown = editor.hover(text)
    before, _, after = text.partition("|")
    key = re.search(r"\w*\Z", before)[0] + re.match(r"\w*", after)[0]  # type: ignore[index]
    assert words in shown
    assert shown.startswith(f"#### {'object' if key == 'cup' else key}\n")


def test_a_choice_shows_what_each_word_means(editor: Editor) -> None:
    shown = editor.hover(f"{OBJECT}coll|ision: hull")
    assert "* `hull`: One convex hull." in shown and "* `none`: No collision." in shown


# -- diagnostics ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "underlined", "message"),
    [
        (f"{OBJECT}mas: 0.3", "mas", "Property mas is not allowed."),
        (f"{OBJECT}shape: {{bxo: [1, 1, 1]}}", "bxo", "Property bxo is not allowed."),
        (f"{OBJECT}pose: {{yaw_dge: 3}}", "yaw_dge", "Property yaw_dge is not allowed."),
        (f"{OBJECT}mass: heavy", "heavy", "Incorrect type. Expected one of number, object."),
        (f"{OBJECT}mass: -1", "-1", "Value is below the exclusive minimum of 0."),
        (f"{OBJECT}friction: low", "low", 'Incorrect type. Expected "number".'),
        (f"{OBJECT}restitution: 1.2", "1.2", "Value is above the maximum of 1."),
        (f"{OBJECT}shape: {{box: [1, 1]}}", "[1, 1]", "Array has too few items. Expected 3 or more."),
        (f"{OBJECT}color: [1, 1]", "[1, 1]", "Array has too few items. Expected 3 or more."),
        (f"{OBJECT}collision: hul", "hul", 'Value is not accepted. Valid values: "auto", "hull", "decompose", "none".'),
        (f"{OBJECT}fixed: yes", "yes", "Value is not accepted. Valid values: false, true."),
        (f"{OBJECT}mass: {{value: 1, rnage: [1, 2]}}", "rnage", "Property rnage is not allowed."),
        (f"{SCENE}objects: {{Cup: {{}}}}", "Cup", "a name starts with a lower-case letter"),
        (f"{SCENE}robots: {{arm: {{model: yam, joints: hmoe}}}}", "hmoe", "expected `home`"),
        (f"{SCENE}relations:\n  - Ontop(cup, desk)", "Ontop(cup, desk)", "expected a predicate"),
        (f"{TASK}goal: Ontop(cup, desk)", "Ontop(cup, desk)", "expected a predicate"),
        (f"{TASK}goal: {{al: [OnTop(cup, desk)]}}", "al", "Property al is not allowed."),
        (f"{OVERLAY}objects: {{cup: {{mas: 0.3}}}}", "mas", "Property mas is not allowed."),
        (f"{OVERLAY}objects: {{cup: {{friction: low}}}}", "low", "Incorrect type. Expected"),
        (f"{OVERLAY}objects: {{cup: {{collision: hul}}}}", "hul", "Value is not accepted."),
        (f"{OVERLAY}objects: {{cup: {{shape: {{sphere: -1}}}}}}", "-1", "Value is below the exclusive minimum of 0."),
        ("simfoundry: scene/1\n", "s", 'Missing property "name".'),
        ("simfoundry: scene/2\nname: a\n", "scene/2", 'Value must be "scene/1".'),
    ],
)
def test_a_slip_is_underlined_alone(editor: Editor, text: str, underlined: str, message: str) -> None:
    ((where, said),) = editor.problems(text)
    assert where == underlined and said.startswith(message)


@pytest.mark.parametrize(
    "text",
    [
        f"{TASK}goal: {{all: [OnTop(a, b), At(a, 0.1, -0.2)]}}\nsubtasks:\n  x: {{goal: OnTop(a, b), instruction: x}}\n"
        "  y: {goal: {not: At(c, 0.1, 0.2)}}\n",
        f"{OVERLAY}objects: {{cup: null, bowl: {{mass: null, shape: {{box: null, sphere: 1}}}}}}\nrelations: null\n",
        f"{SCENE}origin: {{note: 'fitted', capture: a}}\nallow: {{SF402: {{cup: it is hollow}}}}\n",
        f"{SCENE}origin: {{note: fitted (cup, desk), capture: a}}\n",
        f"{SCENE}robots: {{arm: {{model: {{mjcf: a.xml}}, joints: {{joint1: 0.1}}}}}}\n",
    ],
)
def test_what_is_valid_has_no_diagnostic(editor: Editor, text: str) -> None:
    assert editor.problems(text) == []


@pytest.mark.parametrize("kind", KINDS)
def test_the_examples_of_the_reference_have_no_diagnostic(editor: Editor, kind: str) -> None:
    assert editor.problems(example(kind)) == []


SPECS = sorted(path for path in (REPOSITORY / "specs").rglob("*.yaml") if is_document(path))


def test_there_are_specs() -> None:
    assert len(SPECS) > 1


def test_no_spec_of_the_project_has_a_diagnostic(server: Server) -> None:
    """Under the line that names their schema, where they have one: it must lead there."""
    for path in SPECS:
        text = path.read_text(encoding="utf-8")
        named = re.search(r"^# yaml-language-server: \$schema=(\S+)$", text, re.MULTILINE)
        if named is None:
            kind = re.search(r"^simfoundry: (\w+)/", text, re.MULTILINE)
            assert kind is not None
            schema = os.path.relpath(REPOSITORY / "schemas" / f"{kind[1]}.schema.json", path.parent)
            text = f"# yaml-language-server: $schema={schema}#/$defs/Editor\n{text}"
        else:
            file, _, part = named[1].partition("#")
            assert (path.parent / file).is_file() and part == "/$defs/Editor", path
        server.open(path, text)
    found = {str(path): [problem["message"] for problem in server.diagnostics(path)] for path in SPECS}
    assert {path: problems for path, problems in found.items() if problems} == {}


# -- the line that names the schema ---------------------------------------------------------------------------------


def test_the_schema_is_found_from_the_folder_of_the_document(server: Server, project: Path) -> None:
    folder = project / "scenes" / "kitchen"
    text = "# yaml-language-server: $schema={}\n" + SCENE + "mas: 1\n"
    said = {}
    for name, line in {"right": "../../schemas/scene.schema.json", "wrong": "schemas/scene.schema.json"}.items():
        server.open(folder / f"{name}.scene.yaml", text.format(line))
        said[name] = [found["message"] for found in server.diagnostics(folder / f"{name}.scene.yaml")]
    assert said["right"] == ["Property mas is not allowed."]
    assert len(said["wrong"]) == 1 and "Unable to load schema" in said["wrong"][0]
    server.open(folder / "without.scene.yaml", SCENE + "mas: 1\n")
    assert server.diagnostics(folder / "without.scene.yaml") == []


def test_the_server_is_pinned_and_no_registry_is_named() -> None:
    folder = Path(__file__).parent
    lock = (folder / "package-lock.json").read_text()
    packages = {name: entry for name, entry in json.loads(lock)["packages"].items() if name}
    wanted = json.loads((folder / "package.json").read_text())["dependencies"]
    assert all(re.fullmatch(r"\d+\.\d+\.\d+", version) for version in wanted.values())
    assert {name: packages[f"node_modules/{name}"]["version"] for name in wanted} == wanted
    assert all(entry["integrity"].startswith("sha512-") for entry in packages.values())
    assert not any("resolved" in entry for entry in packages.values())
