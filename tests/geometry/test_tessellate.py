"""The triangles of a primitive are its surface: closed, outward, and of its volume."""

from __future__ import annotations

import math

import numpy as np
import pytest

from simfoundry.geometry.frames import frozen_array
from simfoundry.geometry.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Geometry, Mesh, Sphere, tessellate

SHAPES: list[tuple[Geometry, float]] = [
    (Box(frozen_array([0.3, 0.2, 0.1])), 0.3 * 0.2 * 0.1),
    (Sphere(0.07), 4 / 3 * math.pi * 0.07**3),
    (Cylinder(0.05, 0.2), math.pi * 0.05**2 * 0.2),
    (Capsule(0.04, 0.15), math.pi * 0.04**2 * 0.15 + 4 / 3 * math.pi * 0.04**3),
    (Capsule(0.04, 0.0), 4 / 3 * math.pi * 0.04**3),
    (Ellipsoid(frozen_array([0.05, 0.07, 0.02])), 4 / 3 * math.pi * 0.05 * 0.07 * 0.02),
    (Cone(0.05, 0.2), math.pi * 0.05**2 * 0.2 / 3),
]
IDS = ["box", "sphere", "cylinder", "capsule", "capsule without a middle", "ellipsoid", "cone"]


@pytest.mark.parametrize("geometry", [shape for shape, _ in SHAPES], ids=IDS)
def test_every_edge_is_shared_by_two_faces_that_run_it_in_opposite_directions(geometry: Geometry) -> None:
    faces = tessellate(geometry, 24).faces
    directed = [(int(a), int(b)) for face in faces for a, b in zip(face, np.roll(face, -1), strict=True)]
    assert len(set(directed)) == len(directed)
    assert {(b, a) for a, b in directed} == set(directed)


@pytest.mark.parametrize(("geometry", "volume"), SHAPES, ids=IDS)
def test_signed_volume_is_positive_and_approaches_the_true_one(geometry: Geometry, volume: float) -> None:
    def signed_volume(segments: int) -> float:
        mesh = tessellate(geometry, segments)
        a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)

    assert signed_volume(96) == pytest.approx(volume, rel=3e-3)
    if not isinstance(geometry, Box):
        coarse, fine = volume - signed_volume(24), volume - signed_volume(96)
        assert coarse / fine == pytest.approx(16, rel=0.05)  # the error falls with segments squared


@pytest.mark.parametrize("geometry", [shape for shape, _ in SHAPES], ids=IDS)
def test_no_vertex_is_repeated_or_unused(geometry: Geometry) -> None:
    mesh = tessellate(geometry)
    assert len(np.unique(mesh.vertices.round(12), axis=0)) == len(mesh.vertices)
    assert set(mesh.faces.ravel().tolist()) == set(range(len(mesh.vertices)))
    assert mesh.faces.dtype == np.int32


def test_vertices_reach_the_full_extents_of_each_primitive() -> None:
    for geometry, extents in [
        (SHAPES[0][0], [0.3, 0.2, 0.1]),
        (SHAPES[1][0], [0.14, 0.14, 0.14]),
        (SHAPES[2][0], [0.1, 0.1, 0.2]),
        (SHAPES[3][0], [0.08, 0.08, 0.23]),
    ]:
        np.testing.assert_allclose(np.ptp(tessellate(geometry, 48).vertices, axis=0), extents, atol=1e-12)


def test_the_same_shape_gives_the_same_digest_and_another_does_not() -> None:
    assert tessellate(Cylinder(0.05, 0.2)).digest == tessellate(Cylinder(0.05, 0.2)).digest
    assert tessellate(Cylinder(0.05, 0.2)).digest != tessellate(Cylinder(0.05, 0.2), 49).digest


def test_a_mesh_is_returned_as_it_is() -> None:
    mesh = tessellate(Sphere(0.1))
    assert isinstance(mesh, Mesh)
    assert tessellate(mesh, 5) is mesh


def test_too_few_segments_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 3 segments, got 2"):
        tessellate(Sphere(0.1), 2)
