"""Rules that change an asset part by part: what they keep, and that what they make is sound."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from simfoundry.assets.lathe import checked_profile
from simfoundry.cousins.objects.appearance import color_of, recolor, restuff
from simfoundry.cousins.objects.components import Kind, components
from simfoundry.cousins.objects.geometry import is_radial, lathe_of, resize, taper
from simfoundry.cousins.objects.item import Item, item_of_asset, lowered
from simfoundry.cousins.objects.parts import at, parts_of, rod
from simfoundry.cousins.objects.procedural import draft, rng_of
from simfoundry.cousins.objects.profiles import Profile, flared, raised_foot, swelled, thickened
from simfoundry.cousins.objects.stretch import stretched
from simfoundry.cousins.objects.topology import TOPOLOGY, foot_ring, knobs, loop_handle, remove
from simfoundry.cousins.objects.weigh import weighed
from simfoundry.scene.summary import bounds
from simfoundry.spec.base import Estimate, LatheShape
from simfoundry.spec.cousins import Change
from simfoundry.spec.load import load
from simfoundry.spec.write import to_yaml
from tests.conftest import REPOSITORY

ASSETS = REPOSITORY / "specs" / "assets"
NAMES = sorted(p.name.partition(".")[0] for p in ASSETS.glob("*.asset.yaml"))
CHANGES: tuple[Change, ...] = ("geometry", "topology", "appearance")


def item(name: str) -> Item:
    return item_of_asset(load(ASSETS / f"{name}.asset.yaml"))


def profile(name: str) -> Profile:
    spec = item(name).spec
    key = lathe_of(spec, components(spec)[0])
    assert key is not None
    shape = parts_of(spec)[key].shape
    assert isinstance(shape, LatheShape)
    return Profile.of(shape)


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("cup", {"body": Kind.VESSEL}),
        ("mug", {"body": Kind.VESSEL, "handle": Kind.HANDLE}),
        ("pot", {"body": Kind.VESSEL, "handle": Kind.HANDLE, "handle_2": Kind.HANDLE}),
        ("red_bottle", {"body": Kind.TURNED, "band": Kind.BAND, "cap": Kind.CAP}),
        ("burger", {"body": Kind.STACK}),
        ("grapes", {"body": Kind.BUNCH, "stem": Kind.STEM}),
        ("organizer", {"body": Kind.CRATE, "divider": Kind.DIVIDER, "divider_2": Kind.DIVIDER}),
        ("trash_can", {"body": Kind.VESSEL, "lid": Kind.LID, "lid_handle": Kind.HANDLE}),
        (
            "cabinet",
            {
                "body": Kind.CRATE,
                "drawer": Kind.DRAWER,
                "drawer_handle": Kind.HANDLE,
                "bottom_drawer": Kind.DRAWER,
                "bottom_drawer_handle": Kind.HANDLE,
            },
        ),
    ],
)
def test_components_are_found(name: str, found: dict[str, Kind]) -> None:
    spec = item(name).spec
    assert {c.name: c.kind for c in components(spec)} == found
    assert sorted(k for c in components(spec) for k in c.parts) == sorted(parts_of(spec))


@pytest.mark.parametrize("name", NAMES)
def test_every_draft_is_a_sound_document(name: str) -> None:
    twin = item(name)
    for k in range(4):
        made = draft(twin, CHANGES, (), rng_of(7, name, k))
        text = to_yaml(weighed(made.spec, twin.spec, {}, {}))
        read = load(ASSETS / "draft.asset.yaml", text=text)
        assert not read.errors, (made.changed, read.errors)
        assert read.spec is not None and to_yaml(read.spec) == text
        assert made.changed
        assert lowered(made.spec, ASSETS, name).name == name
        again = draft(twin, CHANGES, (), rng_of(7, name, k))
        assert to_yaml(again.spec) == to_yaml(made.spec)


def test_only_the_components_that_are_named_differ() -> None:
    twin = item("mug")
    for k in range(6):
        made = draft(twin, ("geometry", "appearance"), ("handle",), rng_of(0, "mug", k))
        body = ("body", "body")
        assert parts_of(made.spec)[body] == parts_of(twin.spec)[body]
        assert made.spec != twin.spec


def test_drafts_are_the_same_in_every_process() -> None:
    code = (
        "from tests.cousins.test_objects_rules import CHANGES, draft, item, rng_of, to_yaml\n"
        "print(to_yaml(draft(item('mug'), CHANGES, (), rng_of(1, 'mug', 0)).spec), end='')"
    )
    environment = {**os.environ, "PYTHONHASHSEED": "17"}
    other = subprocess.run(
        [sys.executable, "-c", code], cwd=REPOSITORY, env=environment, capture_output=True, check=True, text=True
    )
    assert other.stdout == to_yaml(draft(item("mug"), CHANGES, (), rng_of(1, "mug", 0)).spec)


# -- profiles -------------------------------------------------------------------------------------------------------

FACTORS = st.floats(0.85, 1.15)


@example("plate", [1.0, 1.0, 1.0, 1.0, 0.875, 1.0])  # a step within the height of a wall that leans far out
@example("plate", [0.85, 1.15, 1.15, 1.0, 0.85, 1.0])  # and one under the edge that joins inside and outside
@given(st.sampled_from(["cup", "bowl", "plate", "mug", "pot"]), st.lists(FACTORS, min_size=2, max_size=6))
def test_a_wall_moves_as_one(name: str, grow: list[float]) -> None:
    old = profile(name)
    new = swelled(old, np.array(grow))
    checked_profile(np.array(new.shape.lathe.profile))
    assert new.is_hollow and new.height == pytest.approx(old.height)
    if name not in ("bowl", "plate"):  # whose rims lean, so that inside and outside end at other heights
        assert new.wall == pytest.approx(old.wall, abs=2e-6)
    assert new.thinnest > 0.5 * old.thinnest
    assert new.radius(new.rim) == pytest.approx(old.radius(old.rim) * grow[-1], abs=1e-9)


@given(st.sampled_from(["cup", "bowl", "plate", "mug", "pot"]), st.floats(0.0, 0.006), st.floats(-0.002, 0.003))
def test_a_lip_and_a_thicker_wall_leave_it_hollow_and_closed(name: str, out: float, more: float) -> None:
    old = profile(name)
    lipped = flared(old, out, 0.2 * old.height)
    assert lipped.radius(lipped.rim) == pytest.approx(old.radius(old.rim) + out)
    assert lipped.radius(old.foot + 0.3 * old.height) == pytest.approx(old.radius(old.foot + 0.3 * old.height))
    thick = thickened(old, more)
    assert thick.wall == pytest.approx(max(old.wall + more, 0.0015))
    assert (thick.outer == old.outer).all()
    footed = raised_foot(old, 0.005, 0.004)
    assert footed.height == pytest.approx(old.height + 0.005) and footed.depth == pytest.approx(old.depth)
    for made in (lipped, thick, footed):
        checked_profile(np.array(made.shape.lathe.profile))


# -- what hangs together stays together -------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_a_handle_stays_on_the_wall_that_moves(seed: int) -> None:
    spec = item("mug").spec
    made = taper(spec, components(spec)[0], np.random.default_rng(seed))
    assert made is not None
    parts = parts_of(made[0])
    shape = parts["body", "body"].shape
    assert isinstance(shape, LatheShape)
    wall = Profile.of(shape)
    for name in ("upper", "lower"):
        part, size = parts["body", name], rod(parts["body", name])
        assert size is not None and is_radial(part)
        inner = float(np.hypot(*at(part)[:2])) - size[1] / 2
        outside = float(wall.radius(at(part)[2]))
        assert outside - wall.wall < inner < outside + 2e-6  # its end is in the wall, and not in the cavity
        grip = float(np.hypot(*at(parts["body", "grip"])[:2]))
        assert inner + size[1] == pytest.approx(grip, abs=2e-3)


def test_a_stretched_cabinet_still_fits_together() -> None:
    spec = item("cabinet").spec
    f = np.array([1.1, 0.9, 1.15])
    made = stretched(spec, f)
    before, after = (bounds(lowered(s, ASSETS, "cabinet")) for s in (spec, made))
    assert np.allclose(after[0], before[0] * f, atol=2e-3) and np.allclose(after[1], before[1] * f, atol=2e-3)
    assert made.joints["drawer"].limits == pytest.approx((0.0, 0.16 * 1.1))
    assert made.joints["drawer"].pose.xyz == pytest.approx((0.0, 0.0, 0.108 * 1.15))


def test_a_round_thing_stays_round_and_a_ball_a_ball() -> None:
    cup = stretched(item("cup").spec, np.array([1.2, 1.0, 0.9]))
    low, high = bounds(lowered(cup, ASSETS, "cup"))
    assert (high - low)[0] == pytest.approx((high - low)[1])
    ball = stretched(item("baseball").spec, np.array([1.2, 1.0, 1.0]))
    low, high = bounds(lowered(ball, ASSETS, "baseball"))
    assert np.ptp(high - low) < 1e-9


def test_of_two_handles_both_change_and_none_goes() -> None:
    spec = item("pot").spec
    handle = next(c for c in components(spec) if c.kind is Kind.HANDLE)
    assert remove(spec, handle, np.random.default_rng(0)) is None
    for k in range(8):
        made = draft(item("pot"), ("geometry",), ("handle", "handle_2"), rng_of(0, "pot", k)).spec
        left, right = (parts_of(made)["body", f"handle_{side}"] for side in ("left", "right"))
        assert left.shape == right.shape != parts_of(spec)["body", "handle_left"].shape
        assert at(left)[1] == pytest.approx(-at(right)[1])


def test_topology_adds_and_removes_parts() -> None:
    rng = np.random.default_rng(0)
    cup, mug, cabinet = (item(name).spec for name in ("cup", "mug", "cabinet"))
    looped = loop_handle(cup, components(cup)[0], rng)
    assert looped is not None and components(looped[0])[1].kind is Kind.HANDLE
    assert loop_handle(mug, components(mug)[0], rng) is None  # it has one
    assert loop_handle(item("plate").spec, components(item("plate").spec)[0], rng) is None  # no plate has
    bare = remove(mug, components(mug)[1], rng)
    assert bare is not None and [c.kind for c in components(bare[0])] == [Kind.VESSEL]
    bar = next(c for c in components(cabinet) if c.name == "drawer_handle")
    knobbed = knobs(cabinet, bar, rng)
    assert knobbed is not None and any(c.kind is Kind.KNOB and c.link == "drawer" for c in components(knobbed[0]))
    footed = foot_ring(mug, components(mug)[0], rng)
    assert footed is None  # what has a handle keeps its foot
    assert {rule.__name__ for rule, _ in TOPOLOGY} >= {"remove", "mirror", "loop_handle", "knobs", "feet"}


def test_resizing_keeps_a_handle_where_it_is_held_on() -> None:
    spec = item("mug").spec
    handle = components(spec)[1]
    made = resize(spec, handle, np.random.default_rng(3))
    assert made is not None
    for name in ("upper", "lower"):
        before, after = parts_of(spec)["body", name], parts_of(made[0])["body", name]
        ends = [float(at(p)[0]) - (rod(p) or (0, 0))[1] / 2 - (rod(p) or (0, 0))[0] for p in (before, after)]
        assert ends[0] == pytest.approx(ends[1], abs=2e-3)


# -- looks and masses -------------------------------------------------------------------------------------------------


def test_a_color_goes_to_all_that_had_it() -> None:
    spec = item("burger").spec
    made = recolor(spec, components(spec)[0], np.random.default_rng(0))
    assert made is not None
    assert color_of(made[0], ("body", "bun")) == color_of(made[0], ("body", "top")) != color_of(spec, ("body", "bun"))
    assert color_of(made[0], ("body", "patty")) == color_of(spec, ("body", "patty"))


def test_another_material_weighs_by_its_own_density() -> None:
    spec = item("bowl").spec
    made = restuff(spec, components(spec)[0], np.random.default_rng(1))
    assert made is not None
    (name,) = made[0].materials
    assert name != "ceramic"
    heavy = weighed(made[0], spec, {}, {}).links["body"].mass
    light = weighed(spec, spec, {}, {}).links["body"].mass
    assert isinstance(heavy, Estimate) and isinstance(light, Estimate) and heavy.range is not None
    share = (made[0].materials[name].density or 0) / 2300
    assert heavy.value / light.value == pytest.approx(share, rel=0.01)
    assert heavy.range[0] <= heavy.value <= heavy.range[1]
    thing = lowered(weighed(spec, spec, {}, {}), ASSETS, "bowl")
    assert thing.links[0].mass == pytest.approx(lowered(spec, ASSETS, "bowl").links[0].mass, rel=0.01)


def test_a_given_mass_grows_with_the_volume() -> None:
    spec = item("baseball").spec
    mass = weighed(stretched(spec, np.full(3, 1.05)), spec, {}, {}).links["body"].mass
    assert isinstance(mass, Estimate) and mass.value == pytest.approx(0.145 * 1.05**3, rel=0.01)
