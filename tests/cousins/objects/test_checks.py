"""Checks of candidates: each refuses what it is for, with numbers, and passes the twin."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from simfoundry.cousins.objects.checks import Needs, ObjectBaseline, faults, needs_of
from simfoundry.cousins.objects.components import each, parts_of, with_parts
from simfoundry.cousins.objects.geometry import stretched
from simfoundry.cousins.objects.item import lowered
from simfoundry.cousins.objects.parts import shaped
from simfoundry.cousins.objects.retrieval import COLOR, SHAPE, likeness
from simfoundry.scene.lower import lower
from simfoundry.scene.model import SceneObject
from simfoundry.spec.load import load_kind
from simfoundry.spec.models.asset import AssetSpec, LinkSpec, PartSpec
from simfoundry.spec.models.base import Material, PoseSpec
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.shapes import BoxShape, CylinderShape, LatheShape, Round, SphereShape
from simfoundry.spec.models.task import TaskSpec
from tests.conftest import REPOSITORY
from tests.cousins.objects.test_rules import ASSETS, item


@cache
def needs(task: str, name: str) -> Needs:
    loaded = load_kind(REPOSITORY / "specs" / "tasks" / f"{task}.task.yaml", "task/1")
    assert isinstance(loaded.spec, TaskSpec)
    scene = loaded.used(loaded.spec.scene)
    assert scene is not None and isinstance(scene.spec, SceneSpec)
    return needs_of(name, scene.spec, lower(scene), [loaded.spec])


@cache
def twin(task: str, name: str, asset: str) -> ObjectBaseline:
    return ObjectBaseline.of(lowered(item(asset).spec, ASSETS, name), needs(task, name))


def thing(spec: AssetSpec, name: str) -> SceneObject:
    return lowered(spec, ASSETS, name)


def first(spec: AssetSpec, name: str, of: ObjectBaseline, category: str) -> tuple[str, str]:
    reason = next(faults(thing(spec, name), of, category), None)
    return ("", "") if reason is None else (reason.code, reason.text)


def test_what_a_task_asks_of_its_things() -> None:
    cup, bowl = needs("cup_in_bowl", "cup"), needs("cup_in_bowl", "bowl")
    assert [str(c) for c in cup.rests] == ["Inside(cup, bowl)"] == [str(c) for c in bowl.rests]
    assert (cup.opening, bowl.opening) == (0.085, None)
    cabinet = needs("store_marker", "cabinet")
    assert [str(c) for c in cabinet.rests] == ["Inside(marker, cabinet.drawer)"]
    assert cabinet.joints == ("drawer", "bottom_drawer")


def test_the_twin_passes_its_own_checks() -> None:
    bowl = twin("cup_in_bowl", "bowl", "bowl")
    assert not bowl.lacks and len(bowl.needs.rests) == 1
    assert first(item("bowl").spec, "bowl", bowl, "bowl") == ("", "")


def test_a_bowl_that_is_too_shallow_holds_no_cup() -> None:
    shallow = stretched(item("bowl").spec, np.array([1.0, 1.0, 0.4]))
    code, text = first(shallow, "bowl", twin("cup_in_bowl", "bowl", "bowl"), "bowl")
    assert code == "affordance" and text.startswith("Inside(cup, bowl) no longer holds: ")


def test_a_bowl_that_is_filled_holds_nothing() -> None:
    solid = LatheShape.model_validate({"lathe": {"profile": ((0.0, 0.0), (0.046, 0.0), (0.08, 0.055), (0.0, 0.055))}})
    spec = item("bowl").spec.model_copy(update={"materials": {"ceramic": Material(density=800, friction=0.35)}})
    filled = each(spec, lambda _, part: shaped(part, solid))
    code, text = first(filled, "bowl", twin("cup_in_bowl", "bowl", "bowl"), "bowl")
    assert code == "affordance" and "bowl" in text


def test_what_must_be_taken_fits_the_gripper() -> None:
    cube = twin("clear_table", "cube", "cube")
    wide = stretched(item("cube").spec, np.full(3, 1.8))
    assert first(wide, "cube", cube, "cube") == (
        "grip",
        "it is 9.0 cm wide at its narrowest, but the gripper only opens to 8.5 cm",
    )


def test_sizes_and_masses_are_those_of_their_kind() -> None:
    cube = twin("clear_table", "cube", "cube")
    tiny = stretched(item("cube").spec, np.full(3, 0.3))
    assert first(tiny, "cube", cube, "cube") == (
        "size",
        "it is 1.5 cm long, but objects of its kind are 2.0 cm to 12.0 cm",
    )
    lead = item("cube").spec.model_copy(update={"materials": {"wood": Material(density=11_000)}})
    assert first(lead, "cube", cube, "cube")[0] == "mass"
    assert first(tiny, "cube", cube, "gadget")[0] == "size"  # of a kind that nothing is known of, by the twin


def test_a_thing_that_topples_does_not_stand() -> None:
    thin = AssetSpec(
        simfoundry="asset/1",
        name="cube",
        materials={"wood": Material(density=650)},
        links={
            "body": LinkSpec(
                material="wood",
                parts={
                    "stick": PartSpec(
                        shape=CylinderShape(cylinder=Round(radius=0.004, height=0.1)), pose=PoseSpec(xyz=(0, 0, 0.05))
                    ),
                    "head": PartSpec(shape=BoxShape(box=(0.05, 0.05, 0.02)), pose=PoseSpec(xyz=(0.02, 0.0, 0.11))),
                },
            )
        },
    )
    code, text = first(thin, "cube", twin("clear_table", "cube", "cube"), "cube")
    assert code == "stands" and text.startswith("on a table, it ")


def test_a_drawer_that_jams_is_refused() -> None:
    spec = item("cabinet").spec
    parts = parts_of(spec)
    block = PartSpec(shape=BoxShape(box=(0.03, 0.03, 0.03)), pose=PoseSpec(xyz=(0.0, 0.0, 0.03)), material="wood")
    jammed = with_parts(spec, {**parts, ("body", "block"): block})  # within the lower drawer
    code, text = first(jammed, "cabinet", twin("store_marker", "cabinet", "cabinet"), "drawer_cabinet")
    assert code == "joint" and "overlap by" in text
    short = spec.model_copy(
        update={"joints": {n: j.model_copy(update={"limits": (0.0, 0.05)}) for n, j in spec.joints.items()}}
    )
    code, text = first(short, "cabinet", twin("store_marker", "cabinet", "cabinet"), "drawer_cabinet")
    assert (code, text) == ("joint", "`drawer` has a range of 0.050, compared to 0.160 in the twin")


def test_likeness_tells_apart_and_only_that() -> None:
    bowl = item("bowl").spec
    one = likeness(thing(bowl, "bowl"))
    noise = one.apart(likeness(thing(bowl, "bowl"), seed=1))
    assert noise.size == 0 and noise.color == pytest.approx(0, abs=1e-6) and 0 < noise.shape < SHAPE / 2
    assert one.apart(likeness(thing(bowl, "bowl"))).distance == pytest.approx(0, abs=1e-6)
    red = bowl.model_copy(update={"links": {"body": bowl.links["body"].model_copy(update={"color": (0.1, 0.2, 0.8)})}})
    painted = one.apart(likeness(thing(red, "bowl")))
    assert painted.size == painted.shape == 0 and painted.color > COLOR and painted.distance > 1
    tall = one.apart(likeness(thing(stretched(bowl, np.array([1.0, 1.0, 1.1])), "bowl")))
    assert tall.size == pytest.approx(math.log(1.1), abs=1e-6)
    ball = each(bowl, lambda _, part: shaped(part, SphereShape(sphere=0.05)))
    assert one.apart(likeness(thing(ball, "bowl"))).shape > SHAPE
