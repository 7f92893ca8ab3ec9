"""Mass properties against closed forms, against another implementation, and against the laws they obey."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from simfoundry.assets import mass
from tests.assets.meshes import Array, Faces, blob, block, rotation

SEEDS = range(6)


def revolved(profile: list[tuple[float, float]], sides: int = 720) -> tuple[Array, Faces]:
    """A closed surface of revolution about z of a profile of (radius, z) from bottom to top, its ends on the axis."""
    angles = np.arange(sides) * 2 * math.pi / sides
    inner = profile[1:-1]
    rings = [np.column_stack([r * np.cos(angles), r * np.sin(angles), np.full(sides, z)]) for r, z in inner]
    vertices = np.concatenate([*rings, [[0, 0, profile[0][1]], [0, 0, profile[-1][1]]]])
    k = np.arange(sides)
    n = (k + 1) % sides
    bottom, top = len(vertices) - 2, len(vertices) - 1
    last = (len(inner) - 1) * sides
    faces = [
        np.column_stack([np.full(sides, bottom), n, k]),
        np.column_stack([np.full(sides, top), last + k, last + n]),
    ]
    for ring in range(len(inner) - 1):
        a, b = ring * sides, (ring + 1) * sides
        faces += [np.column_stack([a + k, a + n, b + n]), np.column_stack([a + k, b + n, b + k])]
    return vertices, np.concatenate(faces).astype(np.int32)


def assert_same(found: mass.SolidMoments, expected: mass.SolidMoments, rtol: float) -> None:
    assert_allclose(found.volume, expected.volume, rtol=rtol)
    assert_allclose(found.com, expected.com, atol=1e-9)
    assert_allclose(found.inertia, expected.inertia, rtol=rtol, atol=rtol * float(np.trace(expected.inertia)))


def test_box_is_its_mesh() -> None:
    size = (0.3, 0.5, 0.7)
    assert_same(mass.mesh(*block(size)), mass.box(np.array(size)), 1e-12)
    assert_allclose(mass.box(np.array(size)).inertia[0, 0], 0.105 * (0.25 + 0.49) / 12)


def test_round_shapes_are_their_fine_meshes() -> None:
    r, h = 0.04, 0.15
    arc = [(r * math.sin(t), -r * math.cos(t)) for t in np.linspace(0, math.pi, 361)]
    assert_same(mass.mesh(*revolved(arc)), mass.sphere(r), 1e-4)
    tube = [(0.0, -h / 2), (r, -h / 2), (r, h / 2), (0.0, h / 2)]
    assert_same(mass.mesh(*revolved(tube)), mass.cylinder(r, h), 1e-4)
    half = len(arc) // 2 + 1
    pill = [(x, z - h / 2) for x, z in arc[:half]] + [(x, z + h / 2) for x, z in arc[half - 1 :]]
    assert_same(mass.mesh(*revolved(pill)), mass.capsule(r, h), 1e-4)


def test_a_body_of_revolution_is_exact() -> None:
    """Against closed forms of a frustum and of a mug (a cylinder less another), and a fine mesh far from z = 0."""
    low, high, height = 0.03, 0.05, 0.1
    frustum = mass.revolution(np.array([(0.0, 0.0), (low, 0.0), (high, height), (0.0, height)]))
    assert_allclose(frustum.volume, math.pi * height / 3 * (low**2 + low * high + high**2), rtol=1e-14)
    lever = (low**2 + 2 * low * high + 3 * high**2) / (4 * (low**2 + low * high + high**2))
    assert_allclose(frustum.com, [0, 0, height * lever], rtol=1e-14)
    outer, inner = mass.cylinder(0.05, 0.1), mass.cylinder(0.045, 0.09)  # a floor of 1 cm
    hollow = inner.moved(np.eye(3), np.array([0.0, 0.0, 0.005]))
    expected = mass.combine([(1.0, outer), (-1.0, hollow)])
    mug = [(0, 0.05), (0.0, -0.04), (0.045, -0.04), (0.045, 0.05), (0.05, 0.05), (0.05, -0.05), (0.0, -0.05)][1:]
    found = mass.revolution(np.array(mug))
    assert found.volume == pytest.approx(expected[0], rel=1e-12)
    assert_allclose(found.com, expected[1], rtol=1e-12, atol=1e-18)
    assert_allclose(found.inertia, expected[2], rtol=1e-12, atol=1e-18)
    vase = [(0.0, 9.0), (0.04, 9.0), (0.06, 9.07), (0.03, 9.15), (0.02, 9.15), (0.05, 9.07), (0.03, 9.01), (0.0, 9.01)]
    for way in (1, -1):
        assert_same(mass.revolution(np.array(vase[::way])), mass.mesh(*revolved(vase)), 3e-5)


def test_capsule_without_height_is_a_sphere_and_a_long_one_a_cylinder() -> None:
    assert_same(mass.capsule(0.1, 1e-12), mass.sphere(0.1), 1e-9)
    long, tube = mass.capsule(0.001, 10.0), mass.cylinder(0.001, 10.0)
    assert_allclose(long.inertia[0, 0], tube.inertia[0, 0], rtol=1e-3)


@pytest.mark.parametrize("seed", SEEDS)
def test_random_meshes_agree_with_trimesh(seed: int) -> None:
    import trimesh

    vertices, faces = blob(np.random.default_rng(seed))
    other = trimesh.Trimesh(vertices, faces, process=False)
    assert other.is_watertight and other.volume > 0
    solid = mass.mesh(vertices, faces)
    assert_allclose(solid.volume, other.volume, rtol=1e-9)
    assert_allclose(solid.com, other.center_mass, atol=1e-9)
    assert_allclose(solid.inertia, other.moment_inertia, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
def test_moving_the_mesh_moves_the_solid(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vertices, faces = blob(rng)
    R_AB, p = rotation(rng), rng.uniform(-2, 2, 3)
    moved = mass.mesh(vertices @ R_AB.T + p, faces)
    assert_same(mass.mesh(vertices, faces).moved(R_AB, p), moved, 1e-9)


def test_far_from_the_origin_nothing_is_lost() -> None:
    vertices, faces = block((0.02, 0.03, 0.05))
    far = mass.mesh(vertices + np.array([100.0, -200.0, 300.0]), faces)
    assert_allclose(far.inertia, mass.box(np.array([0.02, 0.03, 0.05])).inertia, rtol=1e-8, atol=1e-18)


def test_an_inside_out_mesh_has_negative_volume_and_the_same_center() -> None:
    vertices, faces = blob(np.random.default_rng(7))
    solid, turned = mass.mesh(vertices, faces), mass.mesh(vertices, faces[:, ::-1])
    assert_allclose(turned.volume, -solid.volume)
    assert_allclose(turned.com, solid.com, atol=1e-12)


def test_a_cavity_is_not_filled() -> None:
    outer, inner = block((0.2, 0.2, 0.2)), block((0.1, 0.1, 0.1), (0.02, 0.0, 0.0))
    vertices = np.concatenate([outer[0], inner[0]])
    faces = np.concatenate([outer[1], inner[1][:, ::-1] + 8]).astype(np.int32)
    solid = mass.mesh(vertices, faces)
    assert_allclose(solid.volume, 0.008 - 0.001)
    assert_allclose(solid.com, [-0.02 * 0.001 / 0.007, 0, 0], atol=1e-12)


def test_two_halves_combine_to_the_whole() -> None:
    rng = np.random.default_rng(3)
    R_AB, p = rotation(rng), np.array([0.3, -0.2, 0.1])
    half = np.array([0.1, 0.3, 0.2])
    low = mass.box(half).moved(np.eye(3), np.array([-0.05, 0, 0])).moved(R_AB, p)
    high = mass.box(half).moved(np.eye(3), np.array([0.05, 0, 0])).moved(R_AB, p)
    whole = mass.box(np.array([0.2, 0.3, 0.2])).moved(R_AB, p)
    m, com, inertia = mass.combine([(700.0, low), (700.0, high)])
    assert_allclose(m, 700 * whole.volume)
    assert_allclose(com, whole.com)
    assert_allclose(inertia, 700 * whole.inertia, atol=1e-12)


def test_the_heavier_part_draws_the_center() -> None:
    a, b = mass.sphere(0.1), mass.sphere(0.1).moved(np.eye(3), np.array([1.0, 0, 0]))
    m, com, inertia = mass.combine([(3000.0, a), (1000.0, b)])
    v = 4 / 3 * math.pi * 1e-3
    assert_allclose(m, 4000 * v)
    assert_allclose(com, [0.25, 0, 0])
    assert_allclose(
        inertia[1, 1], 4000 * v * 0.4 * 0.01 + 3000 * 1000 / 4000 * v
    )  # reduced mass times distance squared


def test_masses_are_summed_exactly() -> None:
    """Python 3.12 sums floats in another way than 3.11; the same scene gives the same bytes in both."""
    unit = mass.SolidMoments(1.0, np.zeros(3), np.eye(3))
    for densities in ([0.1] * 10, [1e16, 1.0, 1.0], [0.3, 0.2, 0.1, 1e-17]):
        assert mass.combine([(d, unit) for d in densities])[0] == math.fsum(densities)
