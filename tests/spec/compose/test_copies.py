"""Templates, repeated objects, and exceptions for single copies."""

from __future__ import annotations

from pathlib import Path

import pytest

import simfoundry as sf
from simfoundry.scene.lower import lower
from simfoundry.spec.change.flatten import flatten
from simfoundry.spec.load import load
from simfoundry.spec.models.scene import SceneSpec
from tests.spec.compose.documents import DESK, loaded, messages, spec_of, written

CUP = "shape: {sphere: 0.03}, mass: 0.2"


def positions(spec: SceneSpec) -> dict[str, tuple[float, ...]]:
    """Where the copies of `cup` are, or are placed."""
    cups = {name: item for name, item in spec.objects.items() if name.startswith("cup")}
    return {
        n: (i.place.xy or i.place.local_xy or i.place.offset or ()) if i.place else i.pose.xyz for n, i in cups.items()
    }


@pytest.mark.parametrize(
    ("where", "repeat", "expected"),
    [
        ("pose: {xyz: [1, 2, 3]}", "{count: 2, step: 0.1}", {"cup_1": (1, 2, 3), "cup_2": (1.1, 2, 3)}),
        ("pose: {xyz: [1, 2, 3]}", "{count: 2, step: [0, 0.2]}", {"cup_1": (1, 2, 3), "cup_2": (1, 2.2, 3)}),
        (
            "pose: {yaw_deg: 30}",
            "{count: [2, 2], step: [0.1, 0.2]}",
            {"cup_1_1": (0, 0, 0), "cup_1_2": (0, 0.2, 0), "cup_2_1": (0.1, 0, 0), "cup_2_2": (0.1, 0.2, 0)},
        ),
        ("pose: {}", "{count: [2], step: [[0, 0, 0.1]]}", {"cup_1": (0, 0, 0), "cup_2": (0, 0, 0.1)}),
        ("place: {on: desk, xy: [0.1, 0.1]}", "{count: 2, step: 0.2}", {"cup_1": (0.1, 0.1), "cup_2": (0.3, 0.1)}),
        ("place: {on: desk}", "{count: 3, step: 0.2}", {"cup_1": (-0.2, 0), "cup_2": (), "cup_3": (0.2, 0)}),
        ("place: {on: desk, left_of: post}", "{count: 2, step: 0.2}", {"cup_1": (), "cup_2": (0.2, 0)}),
    ],
)
def test_copies_stand_in_rows_and_grids(
    tmp_path: Path, where: str, repeat: str, expected: dict[str, tuple[float, ...]]
) -> None:
    body = f"objects:\n{DESK}  post: {{{CUP}, pose: {{xyz: [9, 9, 9]}}}}\n  cup: {{{CUP}, {where}, repeat: {repeat}}}\n"
    assert positions(spec_of(tmp_path, body)) == expected


def test_a_stack_stands_on_itself(tmp_path: Path) -> None:
    cup = f"{{{CUP}, place: {{on: desk, xy: [0.1, 0], yaw_deg: 20}}, repeat: {{count: 2, step: 0.2, stack: 2}}}}"
    objects = spec_of(tmp_path, f"objects:\n{DESK}  cup: {cup}\n").objects
    places = {name: item.place for name, item in objects.items() if item.place is not None}
    assert {name: place.on for name, place in places.items()} == {
        "cup_1_1": "desk", "cup_1_2": "cup_1_1", "cup_2_1": "desk", "cup_2_2": "cup_2_1",
    }  # fmt: skip
    assert places["cup_2_1"].xy == (0.3, 0) and {place.yaw_deg for place in places.values()} == {20}


def test_objects_repeat_together(tmp_path: Path) -> None:
    body = f"""\
objects:
{DESK}  plate: {{{CUP}, place: {{on: desk}}, repeat: {{count: [2, 2], step: [0.3, 0.3]}}}}
  cup: {{{CUP}, place: {{on: plate}}, repeat: plate}}
  plate_2_2: null
relations: [OnTop(cup, plate), OnTop(plate, desk)]
no_contact: [[cup, plate], [plate, plate]]
"""
    spec = spec_of(tmp_path, body)
    cups = {name: item.place.on for name, item in spec.objects.items() if item.place and name.startswith("cup")}
    assert cups == {"cup_1_1": "plate_1_1", "cup_1_2": "plate_1_2", "cup_2_1": "plate_2_1"}
    assert spec.relations == tuple(
        [f"OnTop(cup_{k}, plate_{k})" for k in ("1_1", "1_2", "2_1")]
        + [f"OnTop(plate_{k}, desk)" for k in ("1_1", "1_2", "2_1")]
    )
    assert spec.no_contact[:3] == (("cup_1_1", "plate_1_1"), ("cup_1_2", "plate_1_2"), ("cup_2_1", "plate_2_1"))
    assert set(spec.no_contact[3:]) == {
        ("plate_1_1", "plate_1_2"), ("plate_1_1", "plate_2_1"), ("plate_1_2", "plate_2_1"),
    }  # fmt: skip


def test_an_entry_with_the_name_of_a_copy_changes_this_copy(tmp_path: Path) -> None:
    body = f"""\
templates: {{red: {{color: [1, 0, 0]}}, dish: {{{CUP}, like: red, friction: 0.4}}}}
objects:
  cup_3: null
  cup: {{like: dish, friction: null, repeat: {{count: 3, step: 0.2}}}}
  cup_2: {{mass: 0.5, color: null, pose: {{rpy_deg: [0, 10, 0]}}}}
"""
    objects = spec_of(tmp_path, body).objects
    assert list(objects) == ["cup_1", "cup_2"]
    assert (objects["cup_1"].mass, objects["cup_1"].color, objects["cup_1"].friction) == (0.2, (1, 0, 0), None)
    assert (objects["cup_2"].mass, objects["cup_2"].color) == (0.5, None)
    assert objects["cup_2"].pose.xyz == (0.2, 0, 0) and objects["cup_2"].pose.rpy_deg == (0, 10, 0)


def test_overlays_change_templates_repeats_and_copies(tmp_path: Path) -> None:
    base = f"""\
parameters: {{gap: 0.2}}
templates: {{dish: {{{CUP}, color: [1, 0, 0]}}}}
objects:
  cup: {{like: dish, repeat: {{count: 3, step: $gap}}}}
  cup_2: {{mass: 0.5}}
  bowl: {{like: dish}}
"""
    written(tmp_path, base, "base.scene.yaml")
    head = "simfoundry: scene/1\nextends: base.scene.yaml\nname: b\n"
    overlay = (
        "parameters: {gap: 0.3}\ntemplates: {dish: {mass: 0.3}}\nobjects: {cup: {repeat: {count: 4}}, cup_4: null}\n"
    )
    spec = spec_of(tmp_path, head + overlay)
    assert {n: (o.mass, o.pose.xyz[0]) for n, o in spec.objects.items()} == {
        "cup_1": (0.3, 0), "cup_2": (0.5, 0.3), "cup_3": (0.3, 0.6), "bowl": (0.3, 0),
    }  # fmt: skip
    objects = spec_of(tmp_path, head + "objects: {cup_2: null, bowl: {color: null}}\n").objects
    assert list(objects) == ["cup_1", "cup_3", "bowl"] and objects["bowl"].color is None
    assert messages(tmp_path, head + "objects: {cup_9: null, bowl: {scale: null}}\n") == [
        "4:18 SF201 `cup` has no copy called `cup_9`",
        "4:31 SF201 `scale` cannot be removed: neither a base nor anything reused here contains it",
    ]


def test_what_is_wrong_in_copies_is_said_once_where_it_was_written(tmp_path: Path) -> None:
    body = f"""\
templates: {{dish: {{{CUP}, colr: [1, 0, 0]}}}}
objects:
{DESK}  cup: {{like: dish, place: {{on: dek}}, repeat: {{count: 12, step: 0.2}}}}
  mug: {{like: dsh}}
  jug: {{{CUP}, repeat: {{count: 0}}}}
  can: {{{CUP}, repeat: {{count: [2, 2], step: 0.1}}}}
  pot: {{{CUP}, repeat: jugg}}
relations: [OnTop(cup, dek)]
"""
    assert messages(tmp_path, body) == [
        "3:54 SF101 unknown key `colr` (and 12 more like it)",
        "7:15 SF201 no template is called `dsh`",
        "8:59 SF104 expected a number greater than or equal to 1, found `0`",
        "9:73 SF107 a grid needs one step for each direction, such as `step: [0.1, 0.12]`",
        "10:51 SF201 no object is called `jugg`",
        "11:24 SF201 no object is called `dek` (and 11 more like it)",
    ]


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("templates: {a: {like: b}, b: {like: a}}\nobjects: {c: {like: a}}\n", "SF207 `a` is like `b` is like `a`"),
        (f"objects: {{a: {{{CUP}, repeat: b}}, b: {{{CUP}, repeat: a}}}}\n", "SF207 `a` repeats with itself"),
        (f"objects: {{a: {{{CUP}, repeat: b}}, b: {{{CUP}}}}}\n", "SF201 `b` is not repeated"),
        (f"objects: {{a: {{{CUP}, repeat: {{count: [100, 100, 100]}}}}}}\n", "SF107 a grid needs one step"),
        (
            f"objects: {{a: {{{CUP}, repeat: {{count: 10000, stack: 10000}}}}}}\n",
            "SF104 the object has",
        ),
        (f"objects: {{a: {{{CUP}, repeat: {{count: 20000}}}}}}\n", "SF104"),
        (
            "objects:\n" + "".join(f"  a{k}: {{{CUP}, repeat: {{count: 9000}}}}\n" for k in range(4)),
            "SF005 with the copies of `a",
        ),
        (
            f"objects: {{a: {{{CUP}, repeat: {{count: 200, step: 0.1}}}}}}\nno_contact: [[a, a]]\n",
            "SF005 with the copies of `a`, this stands for more than 10000 items",
        ),
        (
            "templates: {" + "".join(f"t{k}: {{like: t{k + 1}}}, " for k in range(99)) + "t99: {}}\n"
            f"objects: {{a: {{{CUP}, like: t0}}}}\n",
            "SF005 the chain of `like` has more than 32 templates",
        ),
    ],
)
def test_cycles_and_too_many_copies_are_refused(tmp_path: Path, body: str, said: str) -> None:
    assert any(said in message for message in messages(tmp_path, body))


def test_a_flattened_scene_means_the_same(tmp_path: Path) -> None:
    body = f"""\
parameters: {{gap: 0.1}}
templates: {{dish: {{{CUP}}}}}
objects:
{DESK}  cup: {{like: dish, place: {{on: desk}}, repeat: {{count: [3, 2], step: [$gap, 2 * $gap]}}}}
relations: [OnTop(cup, desk)]
"""
    found = loaded(tmp_path, body)
    assert found.spec is not None
    flat = written(tmp_path, flatten(found.spec), "flat.scene.yaml")
    again = load(flat).spec
    assert again is not None and flatten(again) == flat.read_text() and "$" not in flat.read_text()
    assert again.objects == found.spec.objects and again.relations == found.spec.relations  # type: ignore[attr-defined]
    assert not {"parameters", "templates", "repeat"} & {*flat.read_text().replace(":", " ").split()}


def test_removed_members_take_their_relations_along(tmp_path: Path) -> None:
    body = f"""\
objects:
{DESK}  cup: {{{CUP}, repeat: {{count: 3, step: 0.2}}}}
  cup_2: null
relations: [OnTop(cup_2, desk), OnTop(cup_3, desk)]
no_contact: [[cup_2, desk]]
"""
    spec = spec_of(tmp_path, body)
    assert spec.relations == ("OnTop(cup_3, desk)",) and spec.no_contact == ()


def test_entries_beyond_the_copies_are_said_unless_a_base_has_them(tmp_path: Path) -> None:
    base = f"objects:\n  cup: {{{CUP}, repeat: {{count: 3, step: 0.2}}}}\n  cup_3: {{mass: 0.5}}\n"
    assert messages(tmp_path, base.replace("count: 3", "count: 2")) == ["5:10 SF201 `cup` has no copy called `cup_3`"]
    written(tmp_path, base, "base.scene.yaml")
    overlay = "simfoundry: scene/1\nextends: base.scene.yaml\nname: b\nobjects: {cup: {repeat: {count: 2}}}\n"
    assert list(spec_of(tmp_path, overlay).objects) == ["cup_1", "cup_2"]


def test_two_copies_never_share_a_name(tmp_path: Path) -> None:
    grid, row = "{count: [1, 2], step: [0.1, 0.1]}", "{count: 2, step: 0.1}"
    body = f"objects:\n  c: {{{CUP}, repeat: {grid}}}\n  c_1: {{{CUP}, repeat: {row}}}\n"
    assert any("SF213 two copies are both called `c_1_1`" in message for message in messages(tmp_path, body))
    wrong = f"objects:\n  c: {{{CUP}, repeat: {row}}}\n  d: {{{CUP}, place: {{on: c}}}}\n"
    assert any("SF201 `c` is repeated" in message for message in messages(tmp_path, wrong))


def test_python_keeps_the_repeats_of_a_base(tmp_path: Path) -> None:
    base = f"templates: {{t: {{{CUP}}}}}\nobjects:\n{DESK}  cup: {{like: t, repeat: {{count: 2, step: 0.2}}}}\n"
    written(tmp_path, base, "base.scene.yaml")
    path = written(tmp_path, "simfoundry: scene/1\nextends: base.scene.yaml\nname: b\n", "b.scene.yaml")
    document = sf.load(path)
    assert isinstance(document, sf.SceneDocument)
    document.objects["desk"].color = (1, 0, 0)
    document.save()
    assert list(load(path).spec.objects) == ["desk", "cup_1", "cup_2"]  # type: ignore[union-attr]


def test_copies_have_the_category_of_what_is_repeated(tmp_path: Path) -> None:
    path = written(tmp_path, f"objects:\n  cup: {{{CUP}, repeat: {{count: 2, step: 0.2}}}}\n", "cups.scene.yaml")
    assert {item.category for item in lower(load(path)).objects} == {"cup"}
    found = loaded(tmp_path, "include: {left: {scene: cups.scene.yaml}}\n")
    assert {item.category for item in lower(found).objects} == {"cup"}


def test_flattening_keeps_what_variants_inherit(tmp_path: Path) -> None:
    mug = "  mug: {shape: {sphere: 0.03}, mass: 1, friction: 0.9, variants: {big: {mass: 3}}}\n"
    found = loaded(tmp_path, f"objects:\n{mug}")
    assert found.spec is not None and "big: {mass: 3}" in flatten(found.spec)
