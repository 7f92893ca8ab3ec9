"""What completion offers, and the texts that it leads to."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest
from lsprotocol import types

from simfoundry.language_server.analysis import Analysis, analyzed
from simfoundry.language_server.completion.complete import MAX_OFFERS, complete, signature
from simfoundry.language_server.positions import Lines
from simfoundry.spec.load import load
from simfoundry.spec.models.kinds import is_document
from simfoundry.spec.open_documents import OpenDocuments
from simfoundry.spec.yaml.text import parse
from tests.conftest import REPOSITORY
from tests.editor.client import Server
from tests.language_server.completing import analysis, ask, inserted, names, tokens
from tests.language_server.conftest import DESK

DOCUMENTS = sorted(path for path in (REPOSITORY / "specs").rglob("*.yaml") if is_document(path))
CABINET = REPOSITORY / "specs" / "assets" / "cabinet.asset.yaml"

ROOM = """\
simfoundry: scene/1
name: room
parameters: {gap: 0.2}
templates:
  plate: {shape: {cylinder: {radius: 0.1, height: 0.01}}, mass: 0.3}
materials:
  oak: {density: 700, friction: 0.5}
objects:
  desk: {shape: {box: [1, 1, 0.1]}, material: oak, fixed: true, pose: {xyz: [0, 0, -0.05]}}
  cabinet: {asset: cabinet.asset.yaml, fixed: true, pose: {xyz: [1, 0, 0]}}
  cup: {shape: {sphere: 0.03}, mass: 0.1, place: {on: desk}, repeat: {count: 2, step: 0.2}}
robots:
  arm: {model: demo_arm}
cameras:
  front: {size: [640, 480], fov_deg: 45, pose: {xyz: [1, 0, 1], look_at: [0, 0, 0]}}
frames:
  corner: {xyz: [0.4, 0.4, 0]}
"""
TASK = "simfoundry: task/1\nname: tidy\nscene: room.scene.yaml\ninstruction: Tidy up.\ngoal: Open(cabinet)\n"
HEAD = "simfoundry: scene/1\nname: room\n"


@pytest.fixture
def room(project: Path) -> Path:
    """A scene with one of each, and a task in it."""
    (project / "cabinet.asset.yaml").write_text(CABINET.read_text(encoding="utf-8"), encoding="utf-8")
    (project / "meshes").mkdir()
    (project / "meshes" / "mug.obj").touch()
    (project / "room.scene.yaml").write_text(ROOM, encoding="utf-8")
    (project / "tidy.task.yaml").write_text(TASK, encoding="utf-8")
    return project / "room.scene.yaml"


def known(path: Path) -> Analysis:
    return analyzed(path, Lines(path.read_text(encoding="utf-8")), 1, OpenDocuments())


def split(text: str) -> tuple[str, int]:
    before, _, after = text.partition("|")
    return before + after, len(before)


def offered(path: Path, text: str) -> dict[str, types.CompletionItem]:
    """What is offered at the ``|`` in a text, by label."""
    text, offset = split(text)
    return {item.label: item for item in ask(path, text, offset, known(path) if path.exists() else None)}


@pytest.mark.parametrize("path", Random(3).sample(DOCUMENTS, 12), ids=lambda path: path.name)
def test_what_was_removed_is_offered_and_what_is_offered_can_be_read(path: Path) -> None:
    text, random = path.read_text(encoding="utf-8"), Random(path.name)
    listed = list(tokens(text))
    for token in random.sample(listed, min(25, len(listed))):
        without = text[: token.start] + text[token.end :]
        items = ask(path, without, token.start, analysis(path))
        assert any(token.text in names(item) for item in items), (token, [item.label for item in items])
        for item in items if len(items) < 12 else random.sample(items, 6):
            parse(inserted(without, item))
        kept = text[: token.start + 1] + text[token.end :]
        assert any(token.text in names(item) for item in ask(path, kept, token.start + 1, analysis(path))), token


def test_accepted_members_make_a_valid_scene(room: Path) -> None:
    text = HEAD + "materials:\n  oak: {density: 700}\n|"
    for label in ("objects", "cameras", "lights", "robots"):
        text, offset = split(text)
        item = offered(room, text[:offset] + "|" + text[offset:])[label]
        text = inserted(text, item).replace("on: table", "xy: [0, 0], on: ground") + "\n|"
    text = text.replace("|", "").replace("objects:\n", "objects:\n  ground: {shape: {box: [9, 9, 1]}, mass: 1}\n")
    found = load(room, text=text)
    assert [finding.message for finding in found.errors] == []


@pytest.mark.parametrize(
    ("text", "first", "absent"),
    [
        ("objects:\n  mug:\n    mass: 1\n    |", ["like", "repeat"], ["mass", "density"]),
        ("objects:\n  mug: {shape: {box: [1, 1, 1]}, |}", ["like"], ["shape", "asset"]),
        ("objects:\n  mug: {shape: {|}}", ["box", "sphere"], ["mass"]),
        ("cameras:\n  front:\n    |", ["size", "pose"], ["shape"]),
        ("materials:\n  oak:\n    de|", ["density"], ["friction"]),
        ("gra|", ["gravity"], ["objects"]),
    ],
)
def test_keys(room: Path, text: str, first: list[str], absent: list[str]) -> None:
    found = list(offered(room, HEAD + text))
    assert found[: len(first)] == first or first == [label for label in found if label in first]
    assert not set(absent) & set(found)


@pytest.mark.parametrize(
    ("text", "labels", "absent"),
    [
        ("objects:\n  mug: {place: {on: |}}", ["desk", "cup_1", "cabinet.drawer"], ["arm", "mug"]),
        ("objects:\n  desk: {place: {on: |}}", ["cabinet"], ["desk"]),
        ("objects:\n  mug: {place: {on: cabinet.|}}", ["cabinet.drawer", "cabinet.handle"], ["desk"]),
        ("objects:\n  mug: {material: |}", ["oak"], ["desk"]),
        ("objects:\n  mug:\n    like: |", ["plate"], ["desk"]),
        ("objects:\n  mug: {repeat: |}", ["cup"], ["desk"]),
        ("objects:\n  mug: {pose: {xyz: [0, $|, 0]}}", ["$gap"], ["desk"]),
        ("objects:\n  mug: {pose: {xyz: [0, 2 * |, 0]}}", ["$gap"], ["desk"]),
        ("objects:\n  cabinet: {joints: {|}}", ["drawer", "bottom_drawer"], ["desk"]),
        ("objects:\n  mug: {asset: |}", ["cabinet.asset.yaml", "meshes/mug.obj"], ["room.scene.yaml"]),
        ("objects:\n  mug: {asset: meshes/|}", ["meshes/mug.obj"], []),
        ("cameras:\n  wrist: {mount: arm.|}", ["arm.hand"], ["desk"]),
        ("cameras:\n  wrist: {pose: {frame: |}}", ["corner", "desk"], ["front"]),
        ("viewpoint: |", ["front", "arm"], ["desk"]),
        ("robots:\n  arm: {model: |}", ["demo_arm", "franka_panda"], ["arm"]),
        ("robots:\n  arm: {joints: {|}}", ["joint1"], []),
        ("relations:\n  - |", ["OnTop(object, object)"], ["desk"]),
        ("relations:\n  |", ["OnTop(object, object)"], ["desk"]),
        ("relations: [OnTop(cup_1, |)]", ["desk", "cabinet.drawer"], ["cup_1", "arm"]),
        ("relations:\n  - Open(|", ["cabinet", "cabinet.drawer"], ["desk"]),
        ("relations:\n  - Grasped(cup_1, |", ["arm"], ["desk"]),
        ("relations:\n  - At(cup_1, |", ["0"], ["desk"]),
        ("objects:\n  mug: {collision: |}", ["auto", "hull", "none"], ["exact"]),
        ("objects:\n  mug: {fixed: |}", ["true", "false"], []),
        ("materials:\n  oak: {density: |}", ["650"], []),
        ("materials:\n  oak: {color: |}", ['"#8c8f94"'], []),
        ("allow:\n  |", ["SF402"], ["SF201"]),
        ("allow: {SF402: {|}}", ["desk", "oak"], []),
        ("no_contact:\n  - [desk, |]", ["cabinet.drawer"], ["arm"]),
    ],
)
def test_values(room: Path, text: str, labels: list[str], absent: list[str]) -> None:
    found = offered(room, HEAD + text)
    assert set(labels) <= set(found), list(found)
    assert not set(absent) & set(found)


@pytest.mark.parametrize(
    ("text", "labels", "absent"),
    [
        ("goal: |", ["OnTop(object, object)"], []),
        ("goal:\n  |", ["OnTop(object, object)", "all", "not"], []),
        ("goal:\n  all:\n    - OnTop(|", ["cup_1", "desk"], ["arm"]),
        ("goal: Touching(|", ["arm", "desk"], []),
        ("scene: |", ["room.scene.yaml"], ["cabinet.asset.yaml"]),
        ("robots: [|]", ["arm"], ["desk"]),
        ("reset:\n  objects:\n    |", ["cup_1"], ["desk"]),
        ("start: {joints: {|}}", ["cabinet"], ["cup_1"]),
        ("start: {joints: {cabinet: {|}}}", ["drawer"], ["cup_1"]),
    ],
)
def test_names_of_the_scene_of_a_task(room: Path, text: str, labels: list[str], absent: list[str]) -> None:
    head = "simfoundry: task/1\nname: tidy\ninstruction: Tidy up.\n"
    found = offered(room.with_name("tidy.task.yaml"), head + text)
    assert set(labels) <= set(found), list(found)
    assert not set(absent) & set(found)


def test_items_have_kinds_and_details(room: Path) -> None:
    found = offered(room, HEAD + "objects:\n  mug: {place: {on: |}}")
    assert found["desk"].detail == "box 1 × 1 × 0.1 m, fixed"
    assert found["cabinet.drawer"].detail == "link"
    assert found["desk"].kind == types.CompletionItemKind.Variable
    joints = offered(room, HEAD + "objects:\n  cabinet: {joints: {|}}")
    assert joints["drawer"].detail == "prismatic joint, 0 to 0.16 m"
    keys = offered(room, HEAD + "materials:\n  oak:\n    |")
    assert keys["friction"].detail == "default: 0.5"
    assert isinstance(keys["density"].documentation, types.MarkupContent)
    assert keys["density"].documentation.value == "Density [kg/m^3]."
    camera = offered(room, HEAD + "cameras:\n  front: {|}")
    assert camera["size"].detail == "required"


def test_names_that_are_not_analyzed_yet(room: Path) -> None:
    text, offset = split(
        ROOM.replace("objects:\n", "objects:\n  shelf: {mass: 1}\n") + "viewpoint: {\nrelations: [OnTop(|"
    )
    assert "shelf" in [item.label for item in ask(room, text, offset, known(room))]
    assert "shelf" in [item.label for item in ask(room, text, offset, None)]


def test_an_empty_file_offers_a_whole_document(project: Path) -> None:
    for name in ("desk.scene.yaml", "mug.asset.yaml", "capture.yaml", "lift.task.yaml", "other.yaml"):
        found = offered(project / name, "|")
        whole = [item for label, item in found.items() if label.startswith("new ")]
        assert whole
        for item in whole:
            assert parse(inserted("", item)).data["simfoundry"].endswith("/1")


def test_near_files_are_offered_in_a_project_of_many_folders(room: Path) -> None:
    for k in range(500):
        (room.parent / "aside" / f"folder_{k}").mkdir(parents=True)
    inner = room.parent / "z" / "scenes"
    (inner / "meshes").mkdir(parents=True)
    (inner / "meshes" / "near.obj").touch()
    found = list(offered(inner / "new.scene.yaml", HEAD + "objects:\n  mug: {asset: |}"))
    assert found[0] == "meshes/near.obj"
    outside = offered(room, HEAD + "objects:\n  mug: {asset: ../|}")
    assert not [label for label in outside if label.startswith("../")]


def test_a_wrong_indentation_is_corrected(room: Path) -> None:
    text, offset = split(HEAD + "objects:\n  mug:\n    mass: 1\n      |")
    item = {item.label: item for item in ask(room, text, offset, None)}["friction"]
    assert inserted(text, item).endswith("    mass: 1\n    friction: 0.5")


def test_a_key_with_a_value_is_only_renamed(room: Path) -> None:
    text, offset = split(HEAD + "objects:\n  mug:\n    mas|: 1\n")
    item = {item.label: item for item in ask(room, text, offset, None)}["mass"]
    assert inserted(text, item) == HEAD + "objects:\n  mug:\n    mass: 1\n"


def test_predicates_in_brackets_are_quoted(room: Path) -> None:
    text, offset = split(HEAD + "relations: [|]\n")
    item = {item.label: item for item in ask(room, text, offset, None)}["OnTop(object, object)"]
    assert inserted(text, item) == HEAD + 'relations: ["OnTop(object, object)"]\n'


def test_many_names_are_offered_in_parts(room: Path) -> None:
    text = HEAD + "objects:\n" + "".join(f"  box_{k}: {{shape: {{sphere: 1}}, mass: 1}}\n" for k in range(1000))
    lines = Lines(f"{text}relations: [OnTop(box_99")
    listed = complete(room, lines, lines.position(len(text) + 18), None)
    assert listed.is_incomplete and len(listed.items) == MAX_OFFERS
    listed = complete(room, lines, lines.position(len(lines.text)), None)
    assert not listed.is_incomplete and {"box_99", "box_990"} <= {item.label for item in listed.items}


def test_no_broken_text_is_an_error(room: Path) -> None:
    random = Random(11)
    paths = [room, *Random(5).sample(DOCUMENTS, 6)]
    for path in paths:
        text, last = path.read_text(encoding="utf-8"), known(path)
        for _ in range(60):
            start, size = random.randrange(len(text)), random.randrange(30)
            noise = "".join(random.choices("{}[]:,-\"'#\n |>&*($ab.é😀", k=random.randrange(6)))
            broken = text[:start] + noise + text[start + size :]
            lines = Lines(broken)
            position = lines.position(start + random.randrange(len(noise) + 1))
            complete(path, lines, position, random.choice([last, None]))
            signature(lines, position)


def test_signatures() -> None:
    lines = Lines("goal: OnTop(cup, ")
    shown = signature(lines, lines.position(len(lines.text)))
    assert shown is not None and shown.active_parameter == 1
    (information,) = shown.signatures
    assert information.label == "OnTop(object, object)"
    assert information.parameters is not None
    assert [information.label[slice(*each.label)] for each in information.parameters] == ["object", "object"]
    assert signature(Lines("goal: OnTop"), types.Position(0, 8)) is None
    assert signature(Lines("goal: Nothing(a"), types.Position(0, 15)) is None


def test_the_server_completes(server: Server, project: Path) -> None:
    path = project / "desk.scene.yaml"
    server.open(path, DESK)
    assert server.diagnostics(path) == []
    text = DESK.replace("on: desk", "on: ")  # also offered before this text is checked
    server.change(path, text)
    column = text.splitlines()[6].index("on: ") + 4
    found = {item["label"]: item for item in server.completions(path, 6, column)}
    assert "desk" in found and "mug" not in found
    assert found["desk"]["textEdit"]["newText"] == "desk"
    server.change(path, DESK + "relations: [OnTop(mug, ")
    answer = server.ask(
        "textDocument/signatureHelp",
        textDocument={"uri": path.as_uri()},
        position={"line": 7, "character": len("relations: [OnTop(mug, ")},
    )
    assert answer["activeParameter"] == 1
