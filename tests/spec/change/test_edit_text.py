"""Editing the text of a document: what the edit does not concern stays byte for byte."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simfoundry.spec.change.diff.changes import copied
from simfoundry.spec.change.edit_text import edit_text
from simfoundry.spec.change.flatten import own_data
from simfoundry.spec.change.merge.conflict import ABSENT
from simfoundry.spec.models.kinds import model_of
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.yaml.text import parse

TEXT = """\
simfoundry: scene/1   # odd   spacing
name: desk

# what there is
materials:
  wood:    {density: 700,  friction: 0.5}   # aligned
  ceramic: {density: 2400, friction: 0.35}

objects:
  table:
    shape: {box: [1.4, 0.7, 0.04]}   # full extents
  # my mug
  mug:
    # weighed
    mass: {value: 0.31, range: [0.2, 0.45], source: table}  # estimated
    shape:
        cylinder:
            radius: 0.04   # outside
            height: 0.095
    pose: {xyz: [0.42,0.12,0.0475], yaw_deg: 30}   # here
  # last
  plate: {asset: plate.glb}

relations: [OnTop(mug, table)]   # holds
# the end
"""

Data = dict[str, Any]


def _edited(edit: Callable[[Data], object], text: str = TEXT) -> str:
    data: Data = copied(parse(text).data)
    edit(data)
    return edit_text(text, data, SceneSpec)


def _mug(data: Data) -> Data:
    mug: Data = data["objects"]["mug"]
    return mug


def test_a_value_is_replaced_where_it_stands() -> None:
    edited = _edited(lambda d: _mug(d).update(mass=0.3))
    assert edited == TEXT.replace("{value: 0.31, range: [0.2, 0.45], source: table}", "0.3")


def test_values_in_braces_and_in_blocks_keep_the_layout_around_them() -> None:
    def edit(d: Data) -> None:
        d["materials"]["wood"]["friction"] = 0.7
        _mug(d)["pose"]["xyz"] = (1.0, 2.5, 3.0)
        _mug(d)["shape"]["cylinder"]["radius"] = 0.05

    wanted = TEXT.replace("friction: 0.5}", "friction: 0.7}").replace("[0.42,0.12,0.0475]", "[1, 2.5, 3]")
    assert _edited(edit) == wanted.replace("radius: 0.04 ", "radius: 0.05 ")


def test_new_fields_follow_their_neighbors_in_canonical_order() -> None:
    def edit(d: Data) -> None:
        _mug(d)["category"] = "mug"
        d["materials"]["wood"]["restitution"] = 0.1
        d["gravity"] = (0.0, 0.0, -1.6)

    wanted = TEXT.replace("  mug:\n", "  mug:\n    category: mug\n").replace("0.5}", "0.5, restitution: 0.1}")
    assert _edited(edit) == wanted.replace("name: desk\n", "name: desk\ngravity: [0, 0, -1.6]\n")


def test_a_member_goes_with_the_comments_above_it_and_one_comes_below_its_neighbor() -> None:
    start, end = TEXT.index("  # my mug"), TEXT.index("  # last")
    assert _edited(lambda d: d["objects"].pop("mug")) == TEXT[:start] + TEXT[end:]
    cup = {"shape": {"box": (0.1, 0.1, 0.1)}, "mass": 0.2}
    added = "  cup:\n    shape: {box: [0.1, 0.1, 0.1]}\n    mass: 0.2\n"
    place = TEXT.index("\nrelations")
    assert _edited(lambda d: d["objects"].update(cup=cup)) == TEXT[:place] + added + TEXT[place:]


def test_relations_stay_in_the_form_that_they_have() -> None:
    def more(d: Data) -> None:
        d["relations"] += ("OnTop(plate,table)",)

    assert _edited(more) == TEXT.replace("(mug, table)]", "(mug, table), OnTop(plate, table)]")
    in_quotes = TEXT.replace("OnTop(mug, table)", '"OnTop(mug, table)"')
    assert _edited(more, in_quotes) == in_quotes.replace(')"]', ')", "OnTop(plate, table)"]')
    lines = TEXT.replace("relations: [OnTop(mug, table)]   # holds", "relations:\n  - OnTop(mug, table)  # holds")
    assert _edited(more, lines) == lines.replace("# holds\n", "# holds\n  - OnTop(plate, table)\n")


def test_a_rename_is_one_word_and_its_references() -> None:
    def rename(d: Data) -> None:
        d["objects"] = {("cup" if name == "mug" else name): value for name, value in d["objects"].items()}
        d["relations"] = ("OnTop(cup, table)",)

    assert _edited(rename) == TEXT.replace("  mug:", "  cup:").replace("(mug,", "(cup,")


@pytest.mark.parametrize("newline", ["\r\n", "\n"])
def test_line_ends_and_a_byte_order_mark_stay(newline: str) -> None:
    text = "\ufeff" + TEXT.replace("\n", newline)
    edited = _edited(lambda d: _mug(d).update(category="mug"), text)
    assert edited == text.replace("  mug:" + newline, f"  mug:{newline}    category: mug{newline}")


def test_an_edited_anchor_is_written_out_and_comments_stay() -> None:
    text = TEXT.replace(
        "{asset: plate.glb}", "{asset: plate.glb, pose: &p {yaw_deg: 3}}  # a\n  cup: {asset: c.glb, pose: *p}"
    )
    edited = _edited(lambda d: d["objects"]["plate"]["pose"].update(yaw_deg=4), text)
    assert parse(edited).data["objects"]["cup"]["pose"] == {"yaw_deg": 3}
    assert parse(edited).data["objects"]["plate"]["pose"] == {"yaw_deg": 4}
    assert edited.count("#") == text.count("#")


SPECS = sorted(p for p in Path("specs").rglob("*.yaml") if p.name.count(".") == 2)
VALUES = (0.5, "some text", True, (1.0, 2.0), {"a": 1, "b": {"c": 2.5}}, ("OnTop(a, b)", "Open(c)"))


@given(st.sampled_from(SPECS), st.integers(0, 2**31))
@settings(max_examples=60, deadline=None)
def test_any_edit_of_any_spec_gives_the_data_that_is_wanted(path: Path, seed: int) -> None:
    random, text = Random(seed), path.read_text()
    data: Data = copied(parse(text).data)
    for _ in range(random.randint(1, 4)):
        place = data
        while random.random() < 0.7 and any(isinstance(v, dict) and v for v in place.values()):
            place = random.choice([v for v in place.values() if isinstance(v, dict) and v])
        key = random.choice([k for k in place if k != "simfoundry"] + ["new"])
        if random.random() < 0.3 and len(place) > 1 and key in place:
            del place[key]
        else:
            place[key] = copied(random.choice(VALUES))
    edited = edit_text(text, data, model_of(data["simfoundry"]))
    assert parse(edited).data == {**parse(edited).data, **data}
    assert edited == edit_text(edited, data, model_of(data["simfoundry"]))


def test_an_overlay_says_only_what_it_changes() -> None:
    base: Data = {"objects": {"mug": {"mass": 0.2, "pose": {"xyz": (0, 0, 0)}}, "bowl": {"mass": 1.0}}}
    own: Data = {"objects": {"bowl": {"mass": 2.0}}}
    before: Data = {"objects": {"mug": {"mass": 0.2, "pose": {"xyz": (0, 0, 0)}}, "bowl": {"mass": 2.0}}}
    after = copy.deepcopy(before)
    after["objects"]["mug"]["mass"] = 0.3
    assert own_data(own, before, after, base) == {"objects": {"bowl": {"mass": 2.0}, "mug": {"mass": 0.3}}}
    del after["objects"]["mug"]
    assert own_data(own, before, after, base) == {"objects": {"bowl": {"mass": 2.0}, "mug": None}}
    assert own_data(own, before, before, base) == own
    cup: Data = {"cup": {"mass": 1}}
    assert own_data({"objects": cup}, {"objects": {**base["objects"], **cup}}, base, base) is ABSENT


def test_a_key_that_excluded_another_is_not_followed_by_it() -> None:
    base: Data = {"mug": {"place": {"on": "desk", "xy": (0, 0)}}}
    own: Data = {"mug": {"pose": {"xyz": (0, 0, 1)}}}
    heavier = {"mug": {"pose": {"xyz": (0, 0, 1)}, "mass": 1}}
    assert own_data(own, own, heavier, base) == heavier
    assert own_data(own, own, {"mug": {"mass": 1}}, base) == {"mug": {"mass": 1, "place": None}}
    placed = {"mug": {"place": {"on": "shelf"}}}
    assert own_data(own, own, placed, base) == {"mug": {"place": {"on": "shelf", "xy": None}}}


def test_an_empty_mapping_that_was_set_is_written() -> None:
    assert own_data({"a": {"b": 1}}, {"a": {"b": 1}}, {"a": {}}) == {"a": {}}


def test_members_added_and_removed_together_are_as_if_one_after_the_other() -> None:
    def add(data: Data, *names: str) -> None:
        data["objects"].update({name: {"asset": f"{name}.glb"} for name in names})

    one = _edited(lambda d: add(d, "cup"))
    both = _edited(lambda d: add(d, "cup", "jug"))
    assert both == _edited(lambda d: add(d, "jug"), one) != one
    assert _edited(lambda d: [d["objects"].pop(name) for name in ("cup", "jug")], both) == TEXT
    less = _edited(lambda d: d["objects"].pop("mug"))
    assert _edited(lambda d: [d["objects"].pop(name) for name in ("mug", "plate")]) == _edited(
        lambda d: d["objects"].pop("plate"), less
    )
