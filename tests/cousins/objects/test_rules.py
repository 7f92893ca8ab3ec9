"""Rules that change an asset part by part: what they keep, and that what they make is sound."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from simfoundry.assets import mass
from simfoundry.assets.mesh import open_edges, weld
from simfoundry.assets.solids import checked_profile
from simfoundry.cousins.objects.appearance import change_material, color_of, recolor
from simfoundry.cousins.objects.components import Kind, components, parts_of
from simfoundry.cousins.objects.geometry import reshape, resize, stretched, taper
from simfoundry.cousins.objects.item import ObjectAsset, alone, item_of, item_of_asset, lowered
from simfoundry.cousins.objects.meshes import COLLIDERS, FORMS, swept
from simfoundry.cousins.objects.parts import at, axis_of, is_radial, rod
from simfoundry.cousins.objects.procedural import draft, rng_of
from simfoundry.cousins.objects.profiles import Profile, flared, raised_foot, swelled, thickened
from simfoundry.cousins.objects.skins import PATTERNS, skinned
from simfoundry.cousins.objects.topology import TOPOLOGY, foot_ring, knobs, loop_handle, remove
from simfoundry.cousins.objects.variants import weighed
from simfoundry.geometry.cavity import cavity
from simfoundry.geometry.frames import frozen_array
from simfoundry.geometry.shapes import Mesh
from simfoundry.predicates.judging.bodies import Bodies
from simfoundry.runtime.files import write_atomically
from simfoundry.scene.model import Scene
from simfoundry.scene.object_shapes import bounds
from simfoundry.spec.load import load
from simfoundry.spec.models.base import Estimate
from simfoundry.spec.models.cousins import Change
from simfoundry.spec.models.shapes import LatheShape
from simfoundry.spec.yaml.write import to_yaml
from tests.conftest import REPOSITORY
from tests.scenes import checker_png

ASSETS = REPOSITORY / "specs" / "assets"
NAMES = sorted(p.name.partition(".")[0] for p in ASSETS.glob("*.asset.yaml"))
CHANGES: tuple[Change, ...] = ("geometry", "topology", "appearance")


def item(name: str) -> ObjectAsset:
    return item_of_asset(load(ASSETS / f"{name}.asset.yaml"))


def read_mesh_bytes(obj: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of an OBJ."""
    rows = [line.split() for line in obj.decode().splitlines()]
    vertices = np.array([row[1:] for row in rows if row[0] == "v"], float)
    faces = np.array([[c.partition("/")[0] for c in row[1:]] for row in rows if row[0] == "f"], int) - 1
    return vertices, faces.astype(np.int32)


def profile(name: str) -> Profile:
    spec = item(name).spec
    lathe = components(spec)[0].lathe(spec)
    assert lathe is not None
    return lathe[1]


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


@pytest.mark.parametrize("numbers", [range(1), pytest.param(range(1, 6), marks=pytest.mark.slow)], ids=["one", "more"])
@pytest.mark.parametrize("name", NAMES)
def test_every_draft_is_a_sound_document(name: str, numbers: range, tmp_path: Path) -> None:
    twin = item(name)
    for k in numbers:
        made = draft(twin, CHANGES, (), rng_of(7, name, k))
        text = to_yaml(weighed(made.spec, twin.spec, {}, {}))
        for file, data in made.files.items():
            write_atomically(tmp_path / file, data)
        read = load(tmp_path / "draft.asset.yaml", text=text)
        assert not read.errors, (made.changed, read.errors)
        assert read.spec is not None and to_yaml(read.spec) == text
        assert made.changed
        assert lowered(made.spec, tmp_path, name).name == name
        again = draft(twin, CHANGES, (), rng_of(7, name, k))
        assert to_yaml(again.spec) == to_yaml(made.spec) and again.files == made.files


def test_only_the_components_that_are_named_differ() -> None:
    twin = item("mug")
    for k in range(6):
        made = draft(twin, ("geometry", "appearance"), ("handle",), rng_of(0, "mug", k))
        body = ("body", "body")
        assert parts_of(made.spec)[body] == parts_of(twin.spec)[body]
        assert made.spec != twin.spec


def test_drafts_are_the_same_in_every_process() -> None:
    code = (
        "from tests.cousins.objects.test_rules import CHANGES, draft, item, rng_of, to_yaml\n"
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


def test_of_two_handles_both_change_alike() -> None:
    for k in range(4):
        made = draft(item("pot"), ("geometry",), ("handle", "handle_2"), rng_of(0, "pot", k)).spec
        parts = parts_of(made)
        left, right = ([p for key, p in parts.items() if key[1].startswith(f"{n}_")] for n in ("handle", "handle_2"))
        left = [p for p in left if p not in right]
        tubes = [p for p in left + right if p.use == "collision"]
        assert len(tubes) == 2 * COLLIDERS
        one, other = (np.array(sorted(size for p in side if (size := rod(p)) is not None)) for side in (left, right))
        assert np.allclose(one, other, atol=1e-6)
        assert sum(float(at(p)[1]) for p in tubes) == pytest.approx(0.0, abs=1e-4)


def test_no_rule_takes_the_handle_of_a_mug() -> None:
    """A mug without a handle is a cup, and no mug."""
    for k in range(12):
        made = draft(item("mug"), CHANGES, (), rng_of(3, "mug", k))
        assert any("handle" in name for _, name in parts_of(made.spec)), made.changed


def test_topology_adds_and_removes_parts() -> None:
    rng = np.random.default_rng(0)
    cup, mug, cabinet = (item(name).spec for name in ("cup", "mug", "cabinet"))
    looped = loop_handle(cup, components(cup)[0], rng)
    assert looped is not None and components(looped[0])[1].kind is Kind.HANDLE
    assert loop_handle(mug, components(mug)[0], rng) is None  # it has one
    assert loop_handle(item("plate").spec, components(item("plate").spec)[0], rng) is None  # no plate has
    organizer = item("organizer").spec
    divider = next(c for c in components(organizer) if c.kind is Kind.DIVIDER)
    bare = remove(organizer, divider, rng)
    assert bare is not None and sum(c.kind is Kind.DIVIDER for c in components(bare[0])) == 1
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


# -- silhouettes, handles and patterns --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["cup", "mug", "pot", "bowl", "plate"])
def test_other_silhouettes_are_hollow_with_an_even_wall(name: str) -> None:
    spec = item(name).spec
    body, old = components(spec)[0], profile(name)
    words, sharp = set(), 0
    for seed in range(40):
        edit = reshape(spec, body, np.random.default_rng(seed))
        if edit is None:
            sharp += 1
            continue
        lathe = body.lathe(edit[0])
        assert lathe is not None
        shape = parts_of(edit[0])[lathe[0]].shape
        assert isinstance(shape, LatheShape)
        checked_profile(np.array(shape.lathe.profile))
        new = lathe[1]
        assert new.is_hollow and 0.7 * old.height < new.height < 1.6 * old.height
        assert new.thinnest > 0.45 * old.thinnest and new.thinnest > 0.0008
        words.add(edit[1].partition(",")[0])
    assert len(words) >= 4 and sharp <= 2, words


def test_every_form_of_a_handle_is_a_closed_tube_that_stays_out_of_the_cup() -> None:
    spec = item("mug").spec
    wall = profile("mug")
    said = set()
    for seed in range(30):
        made, files, words = swept(spec, (), np.random.default_rng(seed))
        said.add(words)
        (mesh,) = (read_mesh_bytes(data) for name, data in files.items() if name.endswith(".obj"))
        assert open_edges(mesh[1]) == 0 and mass.mesh(*mesh).volume > 1e-6
        off = np.hypot(mesh[0][:, 0], mesh[0][:, 1])
        assert off.min() > 0.04 - wall.wall and off.max() > 0.06  # it ends in the wall, and fingers fit through
        for part in (p for p in parts_of(made).values() if p.use == "collision"):
            size = rod(part)
            assert size is not None
            ends = at(part) + np.outer([-0.5, 0.5], size[1] * axis_of(part))
            assert np.hypot(*ends[:, :2].T).min() - size[0] > 0.04 - wall.wall
        assert {c.kind for c in components(made)} == {Kind.VESSEL, Kind.HANDLE}
    assert len(said) == len(FORMS)


@pytest.mark.parametrize("k", [7, 10])  # square loops, in which a few cells are walled on most sides
def test_the_cavity_of_another_mug_is_that_of_its_body(k: int, tmp_path: Path) -> None:
    made = draft(item("mug"), CHANGES, (), rng_of(11, "mug", k))
    for file, data in made.files.items():
        write_atomically(tmp_path / file, data)
    mug = lowered(made.spec, tmp_path, "mug")
    form = Bodies(Scene("mug", frozen_array([0.0, 0.0, -9.81]), (mug,)))["mug"].forms[0]
    assert form is not None
    hole = cavity(form)
    assert hole is not None and np.abs(hole.middle[:2]).max() < hole.cell, made.changed


@pytest.mark.parametrize("name", sorted(PATTERNS))
def test_patterns_vary_and_close_around(name: str) -> None:
    u, v = np.meshgrid(np.linspace(0, 1, 65), np.linspace(1, 0, 64))
    field = PATTERNS[name](u, v, np.random.default_rng(1))
    assert field.shape == u.shape and np.ptp(np.clip(field, 0, 1)) > 0.2
    if name != "print":  # a label has a left and a right
        assert np.abs(np.clip(field[:, 0], 0, 1) - np.clip(field[:, -1], 0, 1)).mean() < 0.05


@pytest.mark.parametrize("name", ["mug", "plate", "cube", "marker", "baseball", "cabinet"])
def test_a_pattern_is_a_closed_skin_of_the_same_size_and_weighs_nothing(name: str, tmp_path: Path) -> None:
    spec = item(name).spec
    made, files, words = skinned(spec, (), np.random.default_rng(2))
    assert words and any(file.endswith(".png") for file in files)
    for file, data in files.items():
        write_atomically(tmp_path / file, data)
    before, after = (lowered(s, tmp_path, name) for s in (spec, made))
    assert np.allclose(bounds(before), bounds(after), atol=2e-4)
    assert [link.mass for link in after.links] == pytest.approx([link.mass for link in before.links])
    assert [len(link.colliders) for link in after.links] == [len(link.colliders) for link in before.links]
    for link in after.links:
        for mesh in (v.geometry for v in link.visuals if isinstance(v.geometry, Mesh) and v.geometry.texture):
            corners, faces = weld(mesh.vertices, mesh.faces)
            assert open_edges(faces) == 0 and mass.mesh(corners, faces).volume > 0


# -- looks and masses -------------------------------------------------------------------------------------------------


def test_a_color_goes_to_all_that_had_it() -> None:
    spec = item("burger").spec
    made = recolor(spec, components(spec)[0], np.random.default_rng(0))
    assert made is not None
    assert color_of(made[0], ("body", "bun")) == color_of(made[0], ("body", "top")) != color_of(spec, ("body", "bun"))
    assert color_of(made[0], ("body", "patty")) == color_of(spec, ("body", "patty"))


def test_another_material_weighs_by_its_own_density() -> None:
    spec = item("bowl").spec
    made = change_material(spec, components(spec)[0], np.random.default_rng(1))
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


def test_new_shapes_are_stretched_and_keep_their_textures(tmp_path: Path) -> None:
    """A compound becomes the parts of a link, and an image is named after its content."""
    scene = Path(__file__).parents[2] / "scene" / "new_shapes.scene.yaml"
    (tmp_path / "oak.png").write_bytes(checker_png())
    text = scene.read_text().replace('color: "#c8a070"', "texture: oak.png")
    (tmp_path / "new_shapes.scene.yaml").write_text(text)
    loaded = load(tmp_path / "new_shapes.scene.yaml")
    for name, size in {"bin": (0.6, 0.2, 0.06), "egg": (0.12, 0.06, 0.02), "party_hat": None, "hammer": None}.items():
        item = item_of(loaded, name)
        factor = np.array([2.0, 1.0, 0.5])
        low, high = bounds(alone(replace(item, spec=stretched(item.spec, factor))))
        if size is not None:
            assert high - low == pytest.approx(size)
        else:  # x and y grow alike, because the shapes are round
            twin = np.subtract(*reversed(bounds(alone(item))))
            assert high - low != pytest.approx(twin)
    hammer = item_of(loaded, "hammer")
    assert list(hammer.spec.links["body"].parts) == ["handle", "head"]
    (texture,) = (m.texture for m in hammer.spec.materials.values() if m.texture is not None)
    assert texture in hammer.files and texture.startswith("oak_") and len(texture) == len("oak_01234567.png")
