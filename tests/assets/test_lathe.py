"""Bodies of revolution: how far their convex parts are from them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from simfoundry.assets.convex import Part, hull
from simfoundry.assets.solids import SECTORS, checked_profile, lathe_error, lathe_parts
from tests.assets.meshes import Array

PROFILES = {
    "mug": [(0, -0.05), (0.04, -0.05), (0.04, 0.05), (0.036, 0.05), (0.036, -0.045), (0, -0.045)],
    "bowl": [(0, 0), (0.06, 0), (0.08, 0.05), (0.07, 0.05), (0.05, 0.01), (0, 0.01)],
    "ball": [(round(0.05 * math.sin(t), 9), -0.05 * math.cos(t)) for t in np.linspace(0, math.pi, 13)],
    "top": [(0, 0), (0.01, 0.02), (0.06, 0.03), (0.01, 0.04), (0, 0.09)],
}


def parts_of(profile: Array) -> list[Part]:
    return [hull(points) for points in lathe_parts(profile)]


def measured(profile: Array, seed: int) -> float:
    """The greatest distance between the parts and the body, by many random points on both."""
    from shapely import Polygon, distance, points

    rng = np.random.default_rng(seed)
    body, worst = Polygon(profile), 0.0
    parts = parts_of(profile)
    for corners, faces in parts:
        shares = rng.dirichlet(np.ones(3), (200, len(faces)))
        samples = np.einsum("kfc,fcx->kfx", shares, corners[faces]).reshape(-1, 3)
        worst = max(worst, float(distance(points(np.hypot(*samples[:, :2].T), samples[:, 2]), body).max()))
    ends = np.roll(profile, -1, axis=0)
    on = (profile + rng.random((2000, 1, 1)) * (ends - profile)).reshape(-1, 2)
    on = on[~((profile[:, 0] == 0) & (ends[:, 0] == 0))[np.tile(np.arange(len(profile)), 2000)]]
    turn = rng.uniform(0, 2 * math.pi, len(on))
    surface = np.column_stack([on[:, 0] * np.cos(turn), on[:, 0] * np.sin(turn), on[:, 1]])
    outside = np.full(len(surface), np.inf)
    for corners, faces in parts:
        a, b, c = (corners[faces[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        outside = np.minimum(outside, (surface @ normal.T - np.einsum("ij,ij->i", normal, a)).max(axis=1))
    return max(worst, float(outside.max()))


@pytest.mark.parametrize("name", PROFILES)
def test_the_error_of_the_parts_is_what_random_points_find(name: str) -> None:
    profile = checked_profile(np.array(PROFILES[name]) + 0.0)
    error, found = lathe_error(profile, parts_of(profile)), measured(profile, 0)
    assert found <= 1.03 * error + 1e-9
    assert error <= 1.1 * found + 1e-5


def test_the_error_of_a_ring_is_the_sagitta_of_its_sectors() -> None:
    profile = checked_profile(np.array(PROFILES["mug"]) + 0.0)
    sides = (64 - 2) // 2  # of the floor, more than there are sectors, and at most 24
    assert min(sides, 24) > SECTORS
    assert lathe_error(profile, parts_of(profile)) == pytest.approx(0.04 * (1 - math.cos(math.pi / SECTORS)), rel=0.02)
