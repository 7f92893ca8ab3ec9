"""Changes as data: what :func:`diff` finds turns the one document into the other, exactly."""

from __future__ import annotations

import copy
import json
import random
from typing import Annotated, Any, get_args, get_origin

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simfoundry.spec.change.diff.changes import (
    BESIDE,
    SECTIONS,
    Add,
    Remove,
    Rename,
    Reorder,
    Set,
    diff,
    expression,
    same,
    to_json,
)
from simfoundry.spec.change.diff.words import describe
from simfoundry.spec.models.base import Model, Name, PartName
from simfoundry.spec.models.kinds import KINDS, model_of
from simfoundry.spec.models.types import REFERENCES
from simfoundry.spec.yaml.write import to_data
from tests.spec.change.changing import ChangeError, apply, from_json
from tests.spec.strategies import ASSETS, SCENES

NAMES = ("cup", "mug", "bowl", "plate", "desk", "tray", "box_1", "box_2")
SHAPES: tuple[Any, ...] = ({"box": (0.1, 0.1, 0.2)}, {"sphere": 0.04}, {"cylinder": {"radius": 0.03, "height": 0.1}})


def _expression(rng: random.Random, depth: int = 0) -> Any:
    if depth < 2 and rng.random() < 0.3:
        kind = rng.choice(("all", "any", "not"))
        inner = [_expression(rng, depth + 1) for _ in range(rng.randint(0, 3))]
        return {kind: tuple(inner)} if kind != "not" else {"not": _expression(rng, depth + 1)}
    return rng.choice(("OnTop({}, {})", "Inside({},{})", "Open({}.door)", "At({}, 0.1, 0.2)")).format(
        rng.choice(NAMES), rng.choice(NAMES)
    )


def _object(rng: random.Random) -> dict[str, Any]:
    out: dict[str, Any] = {"shape": rng.choice(SHAPES), "material": rng.choice(("wood", "tin", "oak"))}
    if rng.random() < 0.5:
        out["pose"] = {"xyz": (round(rng.random(), 2), 0, 0.1)} | rng.choice(({}, {"yaw_deg": 30}))
    else:
        out["place"] = {rng.choice(("on", "inside", "left_of")): rng.choice(NAMES)}
    if rng.random() < 0.3:
        out["joints"] = {rng.choice(NAMES): rng.choice((0, 0.5, {"deg": 10}))}
    return out | rng.choice(({}, {"mass": 0.2}, {"mass": {"value": 0.2, "by": "vlm"}}, {"fixed": True}, {"fixed": 1}))


def _document(rng: random.Random) -> dict[str, Any]:
    def some(make: Any) -> dict[str, Any]:
        return {name: make(rng) for name in rng.sample(NAMES, rng.randint(0, 5))}

    out: dict[str, Any] = {
        "simfoundry": "scene/1",
        "materials": {m: {"density": rng.choice((700, 900.0))} for m in rng.sample(("wood", "tin", "oak"), 2)},
        "objects": some(_object),
        "cameras": some(lambda r: {"fx": r.choice((600, 610)), "mount": f"{r.choice(NAMES)}.hand"}),
        "viewpoint": rng.choice(NAMES),
        "relations": tuple(_expression(rng) for _ in range(rng.randint(0, 4))),
        "goal": _expression(rng),
        "reset": {"objects": some(lambda r: {"x": (0, 0.1), "y": (r.choice((1, 2)), 3)})},
        "start": {"joints": some(lambda r: {"drawer": 0.0}), "place": some(lambda r: {"on": r.choice(NAMES)})},
        "allow": {"SF402": {rng.choice(NAMES): "why"}},
    }
    keys = rng.sample(list(out), rng.randint(1, len(out)))
    return {key: out[key] for key in keys}


def _mutated(data: Any, rng: random.Random) -> Any:
    """A copy with a few members renamed, removed, swapped or changed, anywhere."""
    tree = copy.deepcopy(data)
    for _ in range(rng.randint(1, 5)):
        place, up = tree, tree
        while isinstance(place, dict) and place and rng.random() < 0.75:
            up, place = place, place[rng.choice(list(place))]
        mapping = place if isinstance(place, dict) and place else up
        if not mapping:
            continue
        key = rng.choice(list(mapping))
        match rng.randrange(4):
            case 0:
                mapping[rng.choice(NAMES)] = mapping.pop(key)
            case 1:
                del mapping[key]
            case 2:
                mapping[key] = mapping.pop(key)
            case 3:
                mapping[key] = rng.choice((None, True, 1, 1.5, "cup", (), ("OnTop(cup, mug)",), {"cup": {}}))
    return tree


def _check(a: Any, b: Any) -> None:
    before = copy.deepcopy(a)
    changes = diff(a, b)
    assert same(apply(changes, a), b), changes
    assert same(a, before)
    assert not diff(b, b)
    again = [from_json(json.loads(json.dumps(to_json(c)))) for c in changes]
    assert same([to_json(c) for c in again], [to_json(c) for c in changes])
    assert same(apply(again, a), b)


@pytest.mark.slow  # 2 s
def test_changes_make_the_one_document_the_other() -> None:
    """1,200 pairs: unrelated documents, and documents of which one was made from the other."""
    rng = random.Random(7)
    kinds = set()
    for _ in range(600):
        a = _document(rng)
        for b in (_document(rng), _mutated(a, rng)):
            _check(a, b)
            kinds |= {type(c) for c in diff(a, b)}
    assert kinds == {Set, Add, Remove, Rename, Reorder}


@given(st.tuples(SCENES, SCENES) | st.tuples(ASSETS, ASSETS) | st.tuples(SCENES, ASSETS))
@pytest.mark.slow  # 3 s
def test_changes_between_random_valid_documents(pair: tuple[Model, Model]) -> None:
    _check(*map(to_data, pair))


ANY = st.recursive(
    st.none() | st.booleans() | st.integers(-2, 2) | st.floats() | st.sampled_from(("", "a", "OnTop(a, b)")),
    lambda inner: (
        st.dictionaries(st.sampled_from((*SECTIONS, "relations", "all", "not", "a", "b")), inner, max_size=4)
        | st.lists(inner, max_size=3).map(tuple)
    ),
    max_leaves=12,
)


@given(ANY, ANY)
def test_changes_between_any_data(a: Any, b: Any) -> None:
    """Also what no document may hold: the texts of unsound documents are compared too."""
    _check(a, b)


def _scene(**sections: Any) -> dict[str, Any]:
    return {"simfoundry": "scene/1", "name": "s", **sections}


CUP = {"shape": {"cylinder": {"radius": 0.04, "height": 0.1}}, "material": "ceramic", "mass": 0.2, "fixed": True}


def test_a_rename_takes_its_references_along() -> None:
    a = _scene(
        viewpoint="left",
        materials={"ceramic": {"density": 2400}},
        objects={"cup": CUP, "lid": {"shape": {"sphere": 0.1}, "place": {"on": "cup", "left_of": "cup"}}},
        cameras={"left": {"fx": 600, "mount": "arm.hand"}},
        robots={"arm": {"model": "franka"}, "other": {"model": "yam", "joints": "home"}},
        relations=("OnTop(cup, desk)", "Closed(cup.lid)", "OnTop(cupboard, cup)"),
        goal={"all": ("Grasped(cup)", {"not": "At(cup, 0.1, 0.2)"})},
        reset={"objects": {"cup": {"x": (0, 1)}}},
        start={"joints": {"cup": {"lid": 0}}, "place": {"cup": {"on": "desk"}}, "pose": {"cup": {}}},
        allow={"SF402": {"cup": "it is a model", "objects.cup.mass": "it is"}, "SF401": {"ceramic": "for later"}},
        no_contact=(("cup", "lid"), ("desk", "cup.base")),
        scene={"anchor": "cup", "objects": {"cup": ("LeftOf",)}},
        task={"objects": ("lid", "cup")},
    )
    text = json.dumps(a)
    for old, new in (("cup", "dish"), ("ceramic", "china"), ("left", "front"), ("arm", "franka_arm")):
        for quoted in (f'"{old}"', f"({old},", f"({old}.", f"({old})", f" {old})", f'"{old}.', f".{old}."):
            text = text.replace(quoted, quoted.replace(old, new))
    text = text.replace('"front_of"', '"left_of"')
    b = from_json({"kind": "set", "path": (), "old": None, "new": json.loads(text)}).new  # type: ignore[union-attr]
    assert set(diff(a, b)) == {
        Rename(("materials",), "ceramic", "china"),
        Rename(("objects",), "cup", "dish"),
        Rename(("cameras",), "left", "front"),
        Rename(("robots",), "arm", "franka_arm"),
    }
    _check(a, b)


def test_links_joints_and_variants_take_their_references_along() -> None:
    hinge = {"type": "revolute", "parent": "base", "child": "door", "limits_deg": (0, 90)}
    a = {
        "simfoundry": "asset/1",
        "name": "cabinet",
        "links": {"base": {"mass": 2.5, "parts": {"side": {"mesh": "a.obj"}}}, "door": {"mass": 1.5}},
        "joints": {"hinge": hinge, "bolt": {"type": "continuous", "mimic": {"joint": "hinge", "multiplier": 2}}},
        "no_contact": (("base", "door"),),
    }
    text = json.dumps(a).replace('"door"', '"lid"').replace('"hinge"', '"pin"')
    b = from_json({"kind": "set", "path": (), "old": None, "new": json.loads(text)}).new  # type: ignore[union-attr]
    assert set(diff(a, b)) == {Rename(("links",), "door", "lid"), Rename(("joints",), "hinge", "pin")}
    _check(a, b)

    red, blue = {"color": (1, 0, 0), "mass": 0.1}, {"color": (0, 0, 1), "mass": 0.3}
    cup = {**CUP, "friction": 0.4, "restitution": 0.1, "category": "mug", "collision": "hull"}
    a = _scene(objects={"cup": {**cup, "variant": "red", "variants": {"red": red, "blue": blue}}})
    b = _scene(objects={"dish": {**cup, "variant": "crimson", "variants": {"crimson": red, "blue": blue}}})
    assert set(diff(a, b)) == {
        Rename(("objects",), "cup", "dish"),
        Rename(("objects", "dish", "variants"), "red", "crimson"),
    }
    _check(a, b)


def test_every_name_that_refers_is_known() -> None:
    """A text that must be a name defines a thing, refers to one, or says what something is or comes from."""
    said = {
        "category": "what it is",
        "labels": "what it is",
        "categories": "what they are",
        "exclude_categories": "what they are",
        "components": "what they do",
        "name": "of the document itself",
        "recipe": "of another document",
        "camera": "of another document, the scene that a policy sees",
        "model": "a known robot",
        "library": "a known library",
        "protocol": "a known protocol",
        "together": "a draw that entries share",
        "occludes": "pieces of one image of the capture itself",
        "split": "a split of the dataset itself, of a recipe, or of recorded demonstrations",
        "subtasks": "sub-tasks of recorded demonstrations, when it is a list",
    }
    names = {str(get_args(kind)[1]) for kind in (Name, PartName)}
    found = set()

    def walk(kind: Any, key: str, seen: tuple[Any, ...]) -> None:
        if isinstance(kind, type) and issubclass(kind, Model):
            for name, info in kind.model_fields.items() if kind not in seen else ():
                walk(Annotated[info.annotation, "", *info.metadata], name, (*seen, kind))
        elif get_origin(kind) is dict:
            walk(get_args(kind)[1], key, seen)  # its keys define, or are those of a section
        else:
            if get_origin(kind) is Annotated and {str(m) for m in get_args(kind)[1:]} & names:
                found.add(key)
            for inner in get_args(kind):
                walk(inner, key, seen)

    for kind in KINDS:
        walk(model_of(kind), "", ())
    assert {"no_contact", "joint", "variant", "mount", "anchor"} <= found
    assert found - said.keys() <= {*REFERENCES, *BESIDE}, "a key that names something is not renamed with it"


def test_a_reference_that_did_not_follow_its_rename_is_a_change() -> None:
    a = _scene(objects={"cup": CUP}, relations=("Open(cup.lid)", "Upright(cup)"))
    b = _scene(objects={"dish": CUP}, relations=("Open(dish.lid)", "Upright(cup)"))
    assert diff(a, b) == (
        Rename(("objects",), "cup", "dish"),
        Remove(("relations", "Upright(dish)"), "Upright(dish)"),
        Add(("relations", "Upright(cup)"), "Upright(cup)", 1),
    )


def test_a_renamed_member_may_have_changed_a_little() -> None:
    heavier = {**CUP, "mass": 0.3}
    assert diff(_scene(objects={"cup": CUP}), _scene(objects={"dish": heavier})) == (
        Rename(("objects",), "cup", "dish"),
        Set(("objects", "dish", "mass"), 0.2, 0.3),
    )


@pytest.mark.parametrize(
    "other",
    [
        {**CUP, "shape": {"cylinder": {"radius": 0.05, "height": 0.1}}},  # another shape is another thing
        {**CUP, "mass": 0.3, "material": "tin", "fixed": False},  # 2 of 5 values alike
    ],
)
def test_a_member_that_is_another_thing_was_not_renamed(other: dict[str, Any]) -> None:
    assert [type(c) for c in diff(_scene(objects={"cup": CUP}), _scene(objects={"dish": other}))] == [Remove, Add]


def test_the_best_match_is_the_rename() -> None:
    a = _scene(objects={"cup_1": {**CUP, "mass": 0.1}, "cup_2": {**CUP, "mass": 0.3}})
    b = _scene(objects={"x": {**CUP, "mass": 0.3}, "y": {**CUP, "mass": 0.15}})
    assert [c for c in diff(a, b) if isinstance(c, Rename)] == [
        Rename(("objects",), "cup_2", "x"),
        Rename(("objects",), "cup_1", "y"),
    ]


def test_equal_members_are_matched_by_their_names() -> None:
    a = _scene(objects={"egg_b": CUP, "egg_a": CUP})
    b = _scene(objects={"white_egg_a": CUP, "white_egg_b": CUP})
    assert {(c.old, c.new) for c in diff(a, b) if isinstance(c, Rename)} == {
        ("egg_b", "white_egg_b"),
        ("egg_a", "white_egg_a"),
    }


def test_many_equal_members_are_renamed_in_their_order() -> None:
    count = 300  # more pairs than are compared one by one
    a = _scene(objects={f"old_{k}": {**CUP, "mass": k + 1.0} for k in range(count)})
    b = _scene(objects={f"new_{k}": {**CUP, "mass": k + 1.0} for k in range(count)})
    assert diff(a, b) == tuple(Rename(("objects",), f"old_{k}", f"new_{k}") for k in range(count))


def test_relations_are_a_set() -> None:
    a, b = _scene(relations=("A(x)", "B(x)", "C(x)")), _scene(relations=("C(x)", "B(x)", "D(x)"))
    assert diff(a, b) == (
        Remove(("relations", "A(x)"), "A(x)"),
        Add(("relations", "D(x)"), "D(x)", 2),
        Reorder(("relations",), ("C(x)", "B(x)", "D(x)")),
    )


def test_pairs_without_contact_are_a_set_of_sets() -> None:
    a = _scene(no_contact=(("cup", "desk"), ("cup", "plate")))
    b = _scene(no_contact=(("plate", "cup"), ("cup", "desk"), ("desk", "plate")))
    assert describe(a, b)[0].lines() == ("no_contact gains desk and plate",)
    assert describe(a, {**a, "no_contact": a["no_contact"][::-1]}) == ()
    _check(a, b)


def test_a_goal_inside_a_goal_is_one_expression() -> None:
    inner = {"any": ("OnTop(cup, plate)", {"not": "Open(box)"})}
    assert expression(inner) == "any(OnTop(cup, plate), not Open(box))"
    a, b = {"goal": {"all": ("A(x)",)}}, {"goal": {"all": ("A(x)", inner)}}
    assert diff(a, b) == (Add(("goal", "all", expression(inner)), inner, 1),)


def test_another_kind_of_shape_is_one_change() -> None:
    a, b = {"shape": {"sphere": 0.1}}, {"shape": {"box": (0.1, 0.1, 0.1)}}
    assert diff(a, b) == (Set(("shape",), {"sphere": 0.1}, {"box": (0.1, 0.1, 0.1)}),)


def test_equal_numbers_are_equal_however_they_are_written() -> None:
    assert diff({"mass": 1}, {"mass": 1.0}) == ()
    assert diff({"fixed": True}, {"fixed": 1}) == (Set(("fixed",), True, 1),)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (Set(("objects", "cup", "mass"), 0.1, 0.3), "`objects.cup.mass` is not what it was when the change was made"),
        (Set(("objects", "mug", "mass"), 0.2, 0.3), "there is no `objects.mug`"),
        (Remove(("objects", "mug"), CUP), "there is no `objects.mug`"),
        (Remove(("objects", "cup"), {}), "`objects.cup` is not what it was when the change was made"),
        (Add(("objects", "cup"), CUP, 0), "`objects.cup` is there already"),
        (Reorder(("name", "x"), ()), "there is no `name.x`"),
        (Reorder(("name",), ()), "`name` has no named members"),
    ],
)
def test_a_change_that_does_not_fit_is_refused(change: Any, message: str) -> None:
    with pytest.raises(ChangeError) as error:
        apply([change], _scene(objects={"cup": CUP}))
    assert str(error.value) == message


@pytest.mark.parametrize("data", [{}, {"kind": "move"}, {"kind": "set", "path": ["a"]}, {"kind": []}])
def test_json_that_is_no_change_is_refused(data: dict[str, Any]) -> None:
    with pytest.raises(ChangeError):
        from_json(data)


def test_every_section_of_the_models_is_known() -> None:
    """A mapping from names to models holds things with identity, so its members can be renamed."""
    import typing

    found, seen = set(), set()

    def walk(kind: Any, key: str) -> None:
        if isinstance(kind, type) and issubclass(kind, Model):
            if kind not in seen:
                seen.add(kind)
                for name, info in kind.model_fields.items():
                    walk(info.annotation, name)
        elif typing.get_origin(kind) is dict:
            value = typing.get_args(kind)[1]
            if isinstance(value, type) and issubclass(value, Model):
                found.add(key)
            walk(value, key)
        else:
            for inner in typing.get_args(kind):
                walk(inner, key)

    for kind in KINDS:
        walk(model_of(kind), "")
    assert found and found - {"conflicts"} <= set(SECTIONS)  # the members of `conflicts` are called by paths
