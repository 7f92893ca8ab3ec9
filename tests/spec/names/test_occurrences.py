"""Where names are defined and used in one document and across the documents of a project."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.spec.names.mentions import document_names
from simfoundry.spec.names.project import Occurrence, ProjectNames
from simfoundry.spec.yaml.text import Document, parse
from tests.spec.names.projects import DESK, FILES, names_in, write_project


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_project(tmp_path_factory.mktemp("project"))


@pytest.fixture(scope="module")
def names(folder: Path) -> ProjectNames:
    return names_in(folder)


def _shown(occurrences: tuple[Occurrence, ...]) -> list[str]:
    return [f"{Path(o.file).name.partition('.')[0]}:{o.line}:{o.column}" for o in occurrences]


def test_every_name_of_a_project_has_a_meaning_and_its_exact_range(names: ProjectNames) -> None:
    found = [o for file in names.documents for o in names.occurrences(file)]
    assert [o for o in found if o.symbol is None] == []
    for o in found:
        assert names.documents[o.file].index.text[o.start : o.end] == o.name


# A place where a name is used, the name, its kind, and all places that mean the same.
MEANINGS = {
    ("desk.scene.yaml", "look_at: mug"): "object mug desk",
    ("desk.scene.yaml", '"mug"'): "object mug desk",
    ("evening.scene.yaml", "  mug:"): "object mug desk",
    ("hall.scene.yaml", "west_mug"): "include west hall",
    ("lift.task.yaml", "Lifted(mug)"): "object mug desk",
    ("lift.task.yaml", "SF404: {mug"): "object mug desk",
    ("vary.cousins.yaml", "objects: {mug: ["): "object mug desk",
    ("vary.cousins.yaml", "objects: [mug"): "object mug desk",
    ("vary.cousins.yaml", "parameters: {clearance"): "parameter clearance desk",
    ("hall.scene.yaml", "parameters: {clearance"): "parameter clearance desk",
    ("desk.scene.yaml", "$clearance"): "parameter clearance desk",
    ("evening.scene.yaml", "on: cup_1"): "object cup desk",
    ("evening.scene.yaml", "cup_3"): "object cup desk",
    ("lift.task.yaml", "OnTop(cup_1"): "object cup desk",
    ("desk.scene.yaml", "repeat: cup"): "object cup desk",
    ("desk.scene.yaml", "variant: big"): "variant big desk",
    ("evening.scene.yaml", "{big: "): "variant big desk",
    ("lift.task.yaml", "Open(commode.slide"): "joint slide cabinet",
    ("desk.scene.yaml", "joints: {slide"): "joint slide cabinet",
    ("lift.task.yaml", "slide: 0.05, pan"): "joint pan cabinet",
    ("lift.task.yaml", "Inside(coin, commode.tray"): "link tray cabinet",
    ("desk.scene.yaml", "inside: commode.tray"): "link tray cabinet",
    ("cabinet.asset.yaml", "parent: trunk, child: tray"): "link tray cabinet",
    ("cabinet.asset.yaml", "mimic: {joint: slide"): "joint slide cabinet",
    ("cabinet.asset.yaml", "site: tip"): "site tip cabinet",
    ("evening.scene.yaml", "&stuff wood"): "material wood desk",
    ("pi.policy.yaml", "camera: portrait"): "camera portrait desk",
    ("desk.scene.yaml", "viewpoint: portrait"): "camera portrait desk",
    ("desk.scene.yaml", "seen_from: portrait"): "camera portrait desk",
    ("hall.scene.yaml", "frame: east"): "include east hall",
    ("lift.task.yaml", "frame: corner"): "frame corner desk",
    ("desk.scene.yaml", "like: jug"): "template jug desk",
    ("hall_late.scene.yaml", "west_mug"): "include west hall",
    ("hall_late.scene.yaml", "_mug"): "object mug desk",
    ("hall_late.scene.yaml", "joint1: west_commode.slide"): "joint slide cabinet",
    ("hall_late.scene.yaml", "objname: west_commode.tray"): "link tray cabinet",
    ("hall_late.scene.yaml", "parameters: {clearance"): "parameter clearance desk",
    ("lift.task.yaml", "robots: [arm"): "robot arm desk",
    ("lift.task.yaml", "Grasped(mug, arm"): "robot arm desk",
    ("desk.scene.yaml", "mount: arm"): "robot arm desk",
    ("vary.cousins.yaml", "object.mug"): "object mug desk",
    ("vary.cousins.yaml", "commode.slide"): "joint slide cabinet",
    ("vary.cousins.yaml", '"light.lamp'): "light lamp desk",
    ("vary.cousins.yaml", "robot.arm"): "robot arm desk",
    ("vary.cousins.yaml", "choose: [wood"): "material wood desk",
}


@pytest.mark.parametrize(("place", "meaning"), MEANINGS.items(), ids=[" ".join(place) for place in MEANINGS])
def test_a_name_means_what_is_defined(names: ProjectNames, folder: Path, place: tuple[str, str], meaning: str) -> None:
    file, context = place
    text = FILES[file]
    name = meaning.split()[1]
    found = names.at(folder / file, text.index(context) + context.rindex(name))
    assert found is not None
    assert found.symbol is not None
    assert f"{found.symbol.kind} {found.symbol.name} {Path(found.symbol.file).name.partition('.')[0]}" == meaning
    assert [d.file for d in names.definitions(found.symbol)] == [found.symbol.file]


def test_the_prefix_and_the_rest_of_an_included_name_are_two_names(names: ProjectNames, folder: Path) -> None:
    start = FILES["sort.task.yaml"].index("west_mug")
    found = [names.at(folder / "sort.task.yaml", start + k) for k in (0, 3, 5, 7)]
    assert [o.name if o is not None else "" for o in found] == ["west", "west", "mug", "mug"]


def test_all_uses_of_a_symbol_are_found(names: ProjectNames, folder: Path) -> None:
    (wood,) = names.symbols(folder / "evening.scene.yaml", "wood", ("materials",))
    used = ["desk:12:3", "desk:17:61", "desk:39:59", "desk:41:15", "evening:12:22", "vary:19:36"]
    assert _shown(names.references(wood)) == used


def test_documents_know_what_they_use_and_who_uses_them(names: ProjectNames, folder: Path) -> None:
    used = {Path(file).name for file in names.dependencies(folder / "evening.scene.yaml")}
    users = {Path(file).name for file in names.dependents(folder / "desk.scene.yaml")}
    assert used == {"desk.scene.yaml"}
    assert users == {
        *("evening.scene.yaml", "hall.scene.yaml", "lift.task.yaml"),
        *("lift_late.task.yaml", "sort.task.yaml", "vary.cousins.yaml", "hall_late.scene.yaml"),
    }


def test_a_name_that_nothing_has_is_an_occurrence_without_symbol(tmp_path: Path) -> None:
    text = DESK.replace("right_of: mug", "right_of: mgu").replace("material: clay", "material: cley")
    found = [o for o in names_in(write_project(tmp_path, FILES | {"desk.scene.yaml": text})).occurrences(
        tmp_path / "desk.scene.yaml") if o.symbol is None]  # fmt: skip
    assert [(o.name, o.sections) for o in found] == [("cley", ("materials",)), ("mgu", ("objects",))]


@pytest.mark.parametrize(
    "text",
    [
        "simfoundry: scene/1\r\nobjects:\r\n  mug: {}\r\n  cup: {place: {on: mug}}\r\n",
        "\ufeffsimfoundry: scene/1\nobjects: {mug: {}, cup: {place: {on: mug}}}\n",
        "simfoundry: scene/1\nobjects: {'mug': {}, \"cup\": {place: {on: 'mug'}}}\n",
        "simfoundry: scene/1\nobjects:\n  &m mug: {}\n  cup: {place: {on: &x   mug}}\n",
"simfoundry: scene/1\nobjects:\n  mug: {}\n  cup:\n    place:\n      on: |-  # folded\n        mug\n",
        "simfoundry: scene/1\nobjects: {mug: {}}\nrelations: [OnTop(cup,\n  # under it\n  mug), Upright(mug)]\n",
        "simfoundry: scene/1\nobjects: {mug: {}}\nrelations: [\"OnTop(\\x41, \\\n   mug)\", 'OnTop(''a, mug)']\n",
        "simfoundry: scene/1\nobjects: {mug: {}}\nrelations:\n  - OnTop(cup,\n      mug)\n",
        "simfoundry: scene/1\nobjects: {mug: {}}\nrelations:\n  - >\n    OnTop(cup,\n    mug)\n",
        "simfoundry: scene/1\ndescription: 'x\u2028y'\nobjects: {mug: {}}\nrelations: [Upright(mug)]\n",
        "simfoundry: scene/1\ndescription: \U0001f600\nobjects: {mug: {labels: [\"\U0001f600\"], place: {on: mug}}}\n",
    ],
)  # fmt: skip
def test_ranges_are_exact_however_a_name_is_written(text: str) -> None:
    names = document_names(parse(text), "desk.scene.yaml")
    found = [m for m in names.mentions if m.name == "mug"]
    assert len(found) >= 2
    assert [text[m.start : m.end] for m in found] == ["mug"] * len(found)
    assert text.count("mug") == len(found)
    for m in found:
        line, column = names.index.place(m.start)
        assert names.index.offset(line, column) == m.start


def test_a_document_that_did_not_change_is_not_walked_again(folder: Path) -> None:
    known: dict[Path, Document] = {}

    def reader(path: Path) -> Document:
        if path not in known:
            known[path] = parse(path.read_text(), str(path))
        return known[path]

    first = ProjectNames(folder, [folder / "lift.task.yaml"], reader)
    second = ProjectNames(folder, [folder / "lift.task.yaml"], reader, first.cache)
    assert all(second.documents[file] is names for file, names in first.documents.items())
    assert len(first.documents) == 3
