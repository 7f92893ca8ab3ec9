"""Prisms: convex parts that tile their outline exactly."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from simfoundry.assets import mass
from simfoundry.assets.errors import MeshError
from simfoundry.assets.mesh import open_edges
from simfoundry.assets.solids import checked_outline, convex_outlines, prism_mesh
from tests.assets.meshes import Array


def star(points: int, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    angles = (np.arange(points) + rng.uniform(-0.3, 0.3, points)) * 2 * math.pi / points
    radii = rng.uniform(0.2, 1.0, points)
    return np.column_stack([radii * np.cos(angles), radii * np.sin(angles)]) * [0.4, 0.7] + [0.1, -0.2]


OUTLINES = {
    "triangle": np.array([[0.0, 0.0], [0.3, 0.0], [0.1, 0.2]]),
    "ell": np.array([[0.0, 0.0], [0.3, 0.0], [0.3, 0.1], [0.1, 0.1], [0.1, 0.4], [0.0, 0.4]]),
    "comb": np.array([[0, 0], [5, 0], [5, 2], [4, 2], [4, 1], [3, 1], [3, 2], [2, 2], [2, 1], [1, 1], [1, 2], [0, 2]])
    * 0.01,
    "straight corners": np.array([[0, 0], [1, 0], [2, 0], [2, 1], [2, 2], [1, 2], [0, 2], [0, 1]]) * 0.1,
    "repeated corners": np.array([[0, 0], [2, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2], [0, 0]]) * 0.1,
    **{f"star {k}": star(9 + 3 * k, k) for k in range(6)},
}


def area(polygon: Array) -> float:
    x, y = polygon.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


@pytest.mark.parametrize("name", OUTLINES)
@pytest.mark.parametrize("turned", [False, True])
def test_convex_parts_tile_the_outline(name: str, turned: bool) -> None:
    from shapely.geometry import Polygon
    from shapely.ops import unary_union

    given = OUTLINES[name][::-1] if turned else OUTLINES[name]
    outline = checked_outline(given)
    assert area(outline) == pytest.approx(abs(area(given)), rel=1e-12)
    parts = convex_outlines(outline)
    assert sum(map(area, parts)) == pytest.approx(area(outline), rel=1e-9)
    for part in parts:
        assert Polygon(part).convex_hull.area == pytest.approx(area(part), rel=1e-9)
    union = unary_union([Polygon(p) for p in parts])
    assert union.symmetric_difference(Polygon(given)).area < 1e-9 * area(outline)


@pytest.mark.parametrize("name", OUTLINES)
def test_parts_and_whole_are_closed_and_agree_in_volume(name: str) -> None:
    outline = checked_outline(OUTLINES[name])
    vertices, faces = prism_mesh(outline, 0.05)
    assert open_edges(faces) == 0
    whole = mass.mesh(vertices, faces)
    assert whole.volume == pytest.approx(area(outline) * 0.05, rel=1e-9)
    solids = []
    for part in convex_outlines(outline):
        corners, sides = prism_mesh(part, 0.05)
        assert open_edges(sides) == 0
        solids.append((1.0, mass.mesh(corners, sides)))
    volume, com, inertia = mass.combine(solids)
    assert volume == pytest.approx(whole.volume, rel=1e-9)
    assert_allclose(com, whole.com, atol=1e-9)
    assert_allclose(inertia, whole.inertia, rtol=1e-6, atol=1e-12)


def test_a_convex_outline_is_one_part() -> None:
    angles = np.arange(40) * 2 * math.pi / 40
    outline = checked_outline(np.column_stack([np.cos(angles), 2 * np.sin(angles)]))
    assert len(convex_outlines(outline)) == 1
    assert len(convex_outlines(checked_outline(OUTLINES["ell"]))) == 2


def test_the_largest_outline_takes_no_minutes() -> None:
    parts = convex_outlines(checked_outline(star(512, 1)))
    assert 2 < len(parts) < 510


@pytest.mark.parametrize(
    "corners",
    [
        [[0, 0], [1, 1], [1, 0], [0, 1]],
        [[0, 0], [1, 0], [2, 0]],
        [[0, 0], [0, 0], [0, 0]],
        [[0, 0], [1e-6, 0], [0, 1e-6]],
        [[0, 0], [2, 0], [2, 2], [1, 0], [0, 2]],
    ],
)
def test_an_outline_that_is_none_is_refused(corners: list[list[float]]) -> None:
    with pytest.raises(MeshError) as caught:
        checked_outline(np.array(corners, dtype=np.float64))
    assert caught.value.code == "SF301"
