"""Findings that carry what to write instead, and documents in which this is written."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.spec.change.fixes import corrections, fix_documents
from simfoundry.spec.diagnostics import Diagnostic, most_similar
from simfoundry.spec.load import load

SCENE = """\
simfoundry: scene/1
name: desk   # the name
materials: {oak: {density: 700}}
objects:
  desk: {fixed: true, shape: {box: [1, 1, 0.1]}, material: oak, pose: {xyz: [0, 0, -0.05]}}

  cup_1: {shape: {sphere: 0.04}, mass: 0.3, place: {on: desk}}   # a cup
  jar: {shape: {sphere: 0.05}, mass: 0.3, place: {on: desk, left_of: cup_1}}
robots:
  arm: {model: franka_panda}
relations: [OnTop(cup_1,desk), "LeftOf(jar, cup_1)"]
"""


def written(folder: Path, text: str, name: str = "desk.scene.yaml") -> Path:
    (folder / "simfoundry.yaml").touch()
    (folder / name).write_text(text, newline="")
    return folder / name


def findings(path: Path) -> list[Diagnostic]:
    return load(path).all_findings()


def underlined(path: Path, finding: Diagnostic) -> str:
    line = path.read_text().splitlines()[finding.line - 1]
    return line[finding.column - 1 : finding.end_column - 1]


def test_as_it_is_the_scene_is_sound(tmp_path: Path) -> None:
    assert findings(written(tmp_path, SCENE)) == []


@pytest.mark.parametrize(
    ("old", "new", "word", "fix", "certain"),
    [
        ("OnTop(cup_1,desk)", "OnTop(cup_1,dsk)", "dsk", "desk", True),
        ("OnTop(cup_1,desk)", "OnTpo(cup_1,desk)", "OnTpo", "OnTop", True),
        ("OnTop(cup_1,desk)", "OnTop( cup_1 ,Desk)", "Desk", "desk", True),
        ("LeftOf(jar, cup_1)", "LeftOf(jra, cup_1)", "jra", "jar", True),
        ("LeftOf(jar, cup_1)", "LeftOf(jar, cup_2)", "cup_2", "cup_1", False),
        ("material: oak", "material: oka", "oka", "oak", True),
        ("material: oak", 'material: "oka"', "oka", "oak", True),
        ("materials: {", "material: {", "material", "materials", True),
        ("fixed: true", "fixed: yes", "yes", "true", True),
        ("sphere: 0.04", "sphere: 4 cm", "4 cm", "0.04", True),
        ("mass: 0.3, place: {on: desk}", 'mass: "0.3", place: {on: desk}', '"0.3"', "0.3", True),
        ("model: franka_panda", "model: franka_pnda", "franka_pnda", "franka_panda", True),
        ("density: 700", "weight: 700", "weight", None, False),
        ("mass: 0.3, place: {on: desk}", "mass: 0.3, mas: 1, place: {on: desk}", "mas", None, False),
        ("scene/1", "scen/1", "scen/1", "scene/1", True),
    ],
)
def test_the_wrong_word_is_marked_with_its_correction(
    old: str, new: str, word: str, fix: str | None, certain: bool, tmp_path: Path
) -> None:
    path = written(tmp_path, SCENE.replace(old, new, 1))
    found = next(d for d in findings(path) if underlined(path, d) == word == d.word)
    assert [(f.text, f.certain) for f in found.fixes] == ([(fix, certain)] if fix else [])


def test_a_word_in_a_base_is_marked_there_and_not_where_it_was_rewritten(tmp_path: Path) -> None:
    base = written(tmp_path, SCENE.replace("on: desk, left_of", "on: dsek, left_of"))
    over = written(tmp_path, "simfoundry: scene/1\nname: over\nextends: desk.scene.yaml\n", "over.scene.yaml")
    room = "simfoundry: scene/1\nname: room\ninclude: {left: {scene: desk.scene.yaml}}\n"
    (direct,), (inherited,) = findings(base), findings(over)
    assert direct.word == inherited.word == underlined(base, direct) == "dsek" and direct.fixes == inherited.fixes
    (included,) = findings(written(tmp_path, room, "room.scene.yaml"))
    assert Path(included.file).name == "desk.scene.yaml" and underlined(base, included) == "dsek"


def test_copies_share_one_mark(tmp_path: Path) -> None:
    cup = "cup_1: {shape: {sphere: 0.04}, mass: 0.3, place: {on: desk}}"
    path = written(tmp_path, SCENE.replace(cup, cup.replace("desk}}", "dsek}, repeat: {count: 3, step: 0.1}}")))
    found = [d for d in findings(path) if d.word == "dsek"]
    assert len(found) == 1 and "2 more like it" in found[0].message and found[0].fixes[0].text == "desk"


def test_a_name_with_another_number_is_not_certainly_a_slip() -> None:
    close = most_similar("cup_3", ["cup_1", "cup_2"])
    assert close is not None and not close.certain
    for slip in ("mugg", "mgu", "mu", "mog", "mu_g"):
        close = most_similar(slip, ["mug", "bowl"])
        assert close is not None and (close.text, close.certain) == ("mug", True)
    far = most_similar("objcts", ["robots", "cameras"])
    assert far is not None and not far.certain


@pytest.mark.parametrize(
    ("word", "choices"),
    [
        ("cup_111", ["cup_1_11", "cup_11_1"]),
        ("cup_11", ["cup_1_1"]),
        ("arm_l", ["arm_r"]),
        ("kitchen_cabinet_upper_drawer", ["kitchen_cabinet_lower_drawer"]),
    ],
)
def test_another_member_of_a_family_is_not_certainly_meant(word: str, choices: list[str]) -> None:
    close = most_similar(word, choices)
    assert close is not None and close.text in choices and not close.certain


def test_what_is_certain_is_corrected_and_nothing_else(tmp_path: Path) -> None:
    slips = [
        ("OnTop", "OnTpo"),
        ("density", "densty"),
        ("on: desk, left_of", "on: dsek, left_of"),
        ("scene/1", "scne/1"),
    ]
    text = SCENE.replace("\n", "\r\n")
    for old, new in slips:
        assert text.count(old)
        text = text.replace(old, new, 1)
    path = written(tmp_path, text)
    fixed = fix_documents([path])
    assert fixed.texts == {path: (text, SCENE.replace("\n", "\r\n"))} and len(fixed.done) == len(slips)
    assert path.read_bytes().decode() == text, "fixing writes nothing"


def test_the_same_slip_in_a_base_does_not_hinder_the_correction(tmp_path: Path) -> None:
    written(tmp_path, SCENE.replace("fixed: true", "fixd: true"))
    text = "simfoundry: scene/1\nname: over\nextends: desk.scene.yaml\nobjects: {desk: {fixd: true}}\n"
    over = written(tmp_path, text, "over.scene.yaml")
    assert fix_documents([over]).texts == {over: (text, text.replace("fixd", "fixed"))}


def test_two_slips_for_one_key_do_not_hinder_other_corrections(tmp_path: Path) -> None:
    text = SCENE.replace("mass: 0.3,", "mas: 0.3, mss: 0.4,", 1)
    path = written(tmp_path, text.replace("fixed: true", "fixd: true"))
    assert [after for _, after in fix_documents([path]).texts.values()] == [text]


def test_a_stray_word_does_not_become_a_key(tmp_path: Path) -> None:
    path = written(tmp_path, SCENE.replace("# the name", "# the\nname_of_this"))
    assert "name_of_this" in {d.word for d in findings(path)} and fix_documents([path]).texts == {}


def test_documents_that_were_not_given_are_left_alone(tmp_path: Path) -> None:
    written(tmp_path, SCENE.replace("OnTop", "OnTpo"))
    over = written(tmp_path, "simfoundry: scene/1\nname: over\nextends: desk.scene.yaml\n", "over.scene.yaml")
    assert fix_documents([over]).texts == {}


def test_a_missing_colon_is_added_before_what_comes_to_light(tmp_path: Path) -> None:
    path = written(tmp_path, SCENE.replace("robots:", "robots").replace("fixed: true", "fixd: true"))
    ((_, after),) = fix_documents([path]).texts.values()
    assert after == SCENE


@pytest.mark.parametrize(
    ("old", "new", "code", "title", "line"),
    [
        ("{oak: {density: 700}}", "{oak: {density: 700}, ash: {density: 600}}", "SF401", "remove `ash`",
         "materials: {oak: {density: 700}}"),
        ("{oak: {density: 700}}", "{oak: {density: 70000}}", "SF402", "allow SF402 for `oak`",
         "  SF402: {oak: say why this is intended}"),
        ("name: desk   # the name\n", "", "SF102", "add `name`", "name: name"),
        ("mass: 0.3, place: {on: desk}", "place: {on: desk}", "SF108", "give `cup_1` a density",
         "  cup_1: {shape: {sphere: 0.04}, density: 1000, place: {on: desk}}   # a cup"),
    ],
)  # fmt: skip
def test_corrections_of_data_change_one_entry(
    old: str, new: str, code: str, title: str, line: str, tmp_path: Path
) -> None:
    text = SCENE.replace(old, new, 1)
    path = written(tmp_path, text)
    loaded = load(path)
    found = next(d for d in loaded.all_findings() if d.code == code)
    made = {each.title: each.text for each in corrections(text, loaded.source, found)}
    assert line in made[title].splitlines() and len(set(made[title].splitlines()) - set(text.splitlines())) <= 2
    path.write_text(made[title])
    assert code not in [d.code for d in findings(path)]
