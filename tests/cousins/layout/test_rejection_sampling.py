"""Places: exact against an independent test of overlaps, and uniform over all that is allowed, as a bias is not."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from simfoundry.cousins.layout.propose import Layout, propose, scatter
from simfoundry.cousins.layout.rejection_sampling import Clear, Occupancy, Region, find, rectangles_meet
from simfoundry.cousins.layout.supports import Outline, Support, support_of
from simfoundry.cousins.layout.twin import Twin
from simfoundry.cousins.layout.twin_objects import Solids
from simfoundry.geometry.frames import IDENTITY, Pose, quat_from_rpy
from simfoundry.geometry.shapes import Box, Cylinder, Geometry
from simfoundry.scene.model import Collider, Link, SceneObject
from simfoundry.scene.object_shapes import hulls
from simfoundry.spec.models.cousins import SceneAxis
from tests.cousins.conftest import twin_of

sizes = st.floats(0.01, 0.3)
turns = st.floats(-math.pi, math.pi)


def thing(name: str, *geometry: Geometry) -> SceneObject:
    colliders = tuple(Collider(f"part{k}", g, 0.5, 0.0) for k, g in enumerate(geometry))
    return SceneObject(name, "", False, IDENTITY, (Link("base", 1.0, np.zeros(3), np.eye(3), (), colliders),))


def box(*size: float) -> SceneObject:
    return thing("box", Box(np.array(size)))


def table(side_x: float, side_y: float) -> Support:
    found = support_of("table", hulls(box(side_x, side_y, 0.02)))
    assert found is not None and found.plane is None and found.plain
    return found


def rectangle(x: float, y: float, a: float, b: float, turn: float) -> shapely.Polygon:
    corners = np.array([[a, b], [-a, b], [-a, -b], [a, -b]]) @ [
        [math.cos(turn), math.sin(turn)],
        [-math.sin(turn), math.cos(turn)],
    ]
    return shapely.Polygon(corners + [x, y])


@given(sizes, sizes, turns, sizes, sizes, turns, st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_rectangles_meet_as_polygons_do(
    a: float, b: float, s: float, c: float, d: float, t: float, x: float, y: float
) -> None:
    one, other = rectangle(0, 0, a, b, s), rectangle(x, y, c, d, t)
    met = rectangles_meet(
        np.array([x + 1j * y]), np.exp([1j * s]), complex(a, b), np.exp([1j * t]), complex(c, d), 0.0
    )[0]
    deep = one.intersection(other).area
    if deep > 1e-9:
        assert met
    elif one.distance(other) > 1e-9:
        assert not met


@given(sizes, sizes, sizes, turns)
def test_the_outline_of_a_box_is_its_rectangle(a: float, b: float, c: float, yaw: float) -> None:
    turned = SceneObject("b", "", False, Pose.of(q=quat_from_rpy(0, 0, yaw)), box(a, b, c).links)
    outline = Outline.of(hulls(turned))
    assert outline.boxy and outline.low == pytest.approx(-c / 2) and outline.high == pytest.approx(c / 2)
    assert sorted((2 * outline.half.real, 2 * outline.half.imag)) == pytest.approx(sorted((a, b)), rel=1e-6)
    assert outline.area == pytest.approx(a * b, rel=1e-6) and outline.width == pytest.approx(min(a, b), rel=1e-6)
    side = outline.turn * np.exp(-1j * yaw)
    assert min(abs(side.real), abs(side.imag)) < 1e-6


def test_what_is_not_one_flat_box_is_not_taken_for_one() -> None:
    tilted = SceneObject("b", "", False, Pose.of(q=quat_from_rpy(0.1, 0, 0)), box(0.1, 0.1, 0.1).links)
    assert not Outline.of(hulls(tilted)).boxy
    assert not Outline.of(hulls(thing("can", Cylinder(0.05, 0.1)))).boxy


def test_real_parts_let_a_thing_stand_where_rectangles_overlap() -> None:
    """A stick may stand in the corner of an L: bounds meet, parts do not."""
    arms = [Collider("x", Box(np.array([0.4, 0.04, 0.1])), 0.5, 0, Pose.of((0.2, 0, 0))),
            Collider("y", Box(np.array([0.04, 0.4, 0.1])), 0.5, 0, Pose.of((0, 0.2, 0)))]  # fmt: skip
    corner = SceneObject("l", "", False, IDENTITY, (Link("base", 1.0, np.zeros(3), np.eye(3), (), tuple(arms)),))
    stick = SceneObject("stick", "", False, IDENTITY, box(0.04, 0.04, 0.1).links)
    solids = Solids((corner, stick), {})
    for x, y, gap in ((0.2, 0.2, 0.16), (0.1, 0.05, 0.01), (0.03, 0.3, -0.01)):
        solids.put("stick", Pose.of((x, y, 0)))
        assert solids.distance("l", "stick", 1.0) == pytest.approx(gap, abs=1e-6)
        assert solids.meet("l", "stick", 0.0) == (gap < 0)
        assert solids.meet("l", "stick", 0.02) == (gap < 0.02)


# -- evenly over all that is allowed ---------------------------------------------------------------------------------


def places(region: Region, outline: Outline, there: Occupancy, count: int, clear: Clear | None = None) -> np.ndarray:
    rng = np.random.default_rng(7)
    found = [find(outline, region, there, rng, 0.0, clear=clear).spot for _ in range(count)]
    assert None not in found
    return np.array(found)


def ring() -> tuple[Region, Outline, Occupancy]:
    """A disk on a square table around a square pillar: allowed is the square less the pillar made round by the disk."""
    outline = Outline.of(hulls(thing("coin", Cylinder(0.05, 0.01))))
    there = Occupancy()
    there.add("pillar", Outline.of(hulls(box(0.4, 0.4, 0.1))), 0.0, 0.0, 0.05, 0.3)
    support = table(1.0, 1.0)
    region = Region(*support.bounds, (-math.pi, math.pi), support, 0.006)
    return region, outline, there


def pvalue(spots: np.ndarray, allowed: shapely.Polygon, cells: int = 8) -> float:
    """Chi-square over the cells of a grid, each expected by how much of it is allowed."""
    low_x, low_y, high_x, high_y = allowed.bounds
    xs, ys = np.linspace(low_x, high_x, cells + 1), np.linspace(low_y, high_y, cells + 1)
    counts = np.histogram2d(spots[:, 0], spots[:, 1], (xs, ys))[0].ravel()
    areas = np.array([allowed.intersection(shapely.box(xs[i], ys[j], xs[i + 1], ys[j + 1])).area
                      for i in range(cells) for j in range(cells)])  # fmt: skip
    assert counts[areas == 0].sum() == 0 and counts.sum() == len(spots)
    kept = areas > areas.max() / 20
    expected = areas[kept] / areas[kept].sum() * counts[kept].sum()
    return float(stats.chisquare(counts[kept], expected).pvalue)


def free_of_pillar(reach: float) -> shapely.Polygon:
    """Where the middle of the coin may be: its bounding square, turned anyhow, is tested exactly by its real disk."""
    inner = shapely.box(-0.5 + reach, -0.5 + reach, 0.5 - reach, 0.5 - reach)
    return inner.difference(rectangle(0, 0, 0.2, 0.2, 0.3).buffer(reach, quad_segs=64))


def disk_clear(x: float, y: float, yaw: float, met: tuple[int, ...]) -> bool:
    del yaw, met
    return bool(rectangle(0, 0, 0.2, 0.2, 0.3).distance(shapely.Point(x, y)) > 0.05)


def test_places_are_uniform_over_the_region_that_is_allowed() -> None:
    region, outline, there = ring()
    spots = places(region, outline, there, 4000, disk_clear)
    assert pvalue(spots, free_of_pillar(0.05)) > 1e-3
    turned = stats.kstest(spots[:, 2], stats.uniform(-math.pi, 2 * math.pi).cdf)
    assert turned.pvalue > 1e-3


def test_a_biased_sampler_fails_the_test() -> None:
    """Pushed off the pillar to the nearest free place, as a sampler that repairs instead of rejecting would do."""
    region, _, _ = ring()
    rng = np.random.default_rng(7)
    spots = rng.uniform(region.low + 0.05, region.high - 0.05, (4000, 2))
    pillar = rectangle(0, 0, 0.2, 0.2, 0.3).buffer(0.0501, quad_segs=64)
    pushed = [shapely.line_interpolate_point(pillar.exterior, pillar.exterior.project(p)) if pillar.contains(p) else p
              for p in map(shapely.Point, spots)]  # fmt: skip
    assert pvalue(np.array([[p.x, p.y] for p in pushed]), free_of_pillar(0.05)) < 1e-9


SQUARE = """\
simfoundry: scene/1
name: square
materials: {wood: {density: 600, friction: 0.5}}
objects:
  table: {fixed: true, shape: {box: [1, 1, 0.04]}, material: wood, pose: {xyz: [0, 0, -0.02]}}
  post: {shape: {box: [0.2, 0.2, 0.1]}, material: wood, pose: {xyz: [-0.1, 0.05, 0.05]}}
  brick: {shape: {box: [0.1, 0.06, 0.05]}, material: wood, pose: {xyz: [0.3, 0.3, 0.025]}}
"""


@pytest.fixture(scope="module")
def square(tmp_path_factory: pytest.TempPathFactory) -> Twin:
    return twin_of(SQUARE, tmp_path_factory.mktemp("square"))


def test_proposals_are_uniform_where_the_asked_predicate_allows(square: Twin) -> None:
    """Behind the post at a fixed turn: off its far side by what the predicate asks, at most 0.25 m, on the table."""
    asked = SceneAxis(anchor="post", objects={"brick": ("Behind",)}, gap=(0.03, 0.25), yaw_deg=(0, 0))
    spots = []
    for k in range(1500):
        layout = propose(square, asked, np.random.default_rng([3, k]))
        assert isinstance(layout, Layout)
        spots.append(layout.poses["brick"].p[:2])
    around = shapely.box(-0.1 - 0.1 - 0.05, 0.05 - 0.1 - 0.03, -0.1 + 0.1 + 0.05, 0.05 + 0.1 + 0.03)
    near = around.buffer(0.25, quad_segs=64).difference(around.buffer(0.03, quad_segs=64))
    allowed = near.intersection(shapely.box(-0.45, -0.47, 0.45, 0.47)).intersection(shapely.box(0.0, -1, 1, 1))
    assert pvalue(np.array(spots), allowed, 6) > 1e-3


def test_things_placed_together_are_as_uniform_as_one_after_another(tmp_path: Path) -> None:
    """Two boxes: the first anywhere, the second wherever the first is not; judged against rejection done plainly."""
    twin = twin_of(SQUARE.replace("[1, 1, 0.04]", "[0.4, 0.4, 0.04]").replace("[0.3, 0.3", "[0.1, -0.1"), tmp_path)
    rng = np.random.default_rng(5)
    off = []
    for k in range(1500):
        layout = scatter(twin, ["post", "brick"], np.random.default_rng([9, k]))
        assert isinstance(layout, Layout)
        off.append(np.linalg.norm(layout.poses["post"].p[:2] - layout.poses["brick"].p[:2]))
    plain: list[float] = []
    support = shapely.box(-0.2, -0.2, 0.2, 0.2)
    while len(plain) < 1500:
        large = small = None
        while large is None:
            x, y, t = rng.uniform((-0.2, -0.2, -math.pi), (0.2, 0.2, math.pi))
            large = rectangle(x, y, 0.1, 0.1, t) if support.covers(rectangle(x, y, 0.1, 0.1, t)) else None
        for _ in range(4000):
            u, v, t = rng.uniform((-0.2, -0.2, -math.pi), (0.2, 0.2, math.pi))
            small = rectangle(u, v, 0.05, 0.03, t)
            if support.covers(small) and not rectangles_touch(large, small):
                plain.append(math.hypot(u - x, v - y))
                break
    assert stats.ks_2samp(off, plain).pvalue > 1e-3


def rectangles_touch(a: shapely.Polygon, b: shapely.Polygon) -> bool:
    return bool(a.distance(b) < 0.002)


def test_nothing_overlaps_among_many(tmp_path: Path) -> None:
    """Forty boxes and cans on a table: pairwise at least the gap apart, by an independent measure, and all on it."""
    rng = np.random.default_rng(1)
    rows = SQUARE.splitlines()[:5]
    for k in range(40):
        a, b, c = rng.uniform(0.03, 0.09, 3).round(3)
        shape = f"{{box: [{a}, {b}, {c}]}}" if k % 3 else f"{{cylinder: {{radius: {a / 2:.4f}, height: {c}}}}}"
        x, y = -0.45 + 0.1 * (k % 10), -0.4 + 0.2 * (k // 10)
        rows.append(f"  t{k}: {{shape: {shape}, material: wood, pose: {{xyz: [{x:.2f}, {y:.2f}, {c / 2:.4f}]}}}}")
    twin = twin_of("\n".join(rows) + "\n", tmp_path)
    names = [f"t{k}" for k in range(40)]
    for seed in range(3):
        layout = scatter(twin, names, np.random.default_rng(seed))
        assert isinstance(layout, Layout) and set(layout.poses) == set(names)
        shadows = [Outline.of(twin.shape(n, layout.poses[n])) for n in names]
        polygons = [shapely.Polygon(s.corners) for s in shadows]
        assert all(shapely.box(-0.5, -0.5, 0.5, 0.5).covers(p) for p in polygons)
        for i, one in enumerate(polygons):
            assert all(one.distance(other) >= 0.0019 for other in polygons[:i])
