"""Primitives as triangle meshes: watertight, vertices merged, faces counter-clockwise from outside."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simfoundry.scene.frames import Array, frozen_array
from simfoundry.scene.model import Box, Capsule, Cylinder, Geometry, Mesh, Sphere

Faces = NDArray[np.int32]


def tessellate(geometry: Geometry, segments: int = 48) -> Mesh:
    """The surface of a primitive as a mesh in the primitive's own frame; a mesh is returned as it is.

    ``segments`` is the number of edges around z, at least 3. Vertices lie on the true surface, so a round shape loses
    at most ``radius * (1 - cos(pi / segments))`` [m] of its radius, and the same input gives the same bytes.
    """
    if segments < 3:
        raise ValueError(f"a round shape needs at least 3 segments, got {segments}")
    match geometry:
        case Mesh():
            return geometry
        case Box():
            return _box(geometry.size)
        case Sphere():
            return _revolved(_arc(geometry.radius, 0.0, 0.0, math.pi, max(2, segments // 2)), segments)
        case Cylinder():
            r, z = geometry.radius, geometry.height / 2
            return _revolved([(0.0, z), (r, z), (r, -z), (0.0, -z)], segments)
        case Capsule():
            r, z, rings = geometry.radius, geometry.height / 2, max(1, segments // 4)
            top = _arc(r, z, 0.0, math.pi / 2, rings)
            bottom = _arc(r, -z, math.pi / 2, math.pi, rings)
            return _revolved(top + (bottom if z > 0 else bottom[1:]), segments)


def _box(size: Array) -> Mesh:
    corners = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]) * np.asarray(size) / 2
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    return _mesh(corners, np.array(faces, dtype=np.int32))


def _arc(radius: float, z: float, start: float, stop: float, steps: int) -> list[tuple[float, float]]:
    """Points ``(r, z)`` of a circle about ``(0, z)`` from angle ``start`` to ``stop`` [rad], measured from +z."""
    angles = [start + (stop - start) * k / steps for k in range(steps + 1)]
    return [(radius * math.sin(a), z + radius * math.cos(a)) for a in angles]


def _revolved(profile: list[tuple[float, float]], segments: int) -> Mesh:
    """Turn a profile ``(r, z)`` about z; it starts and ends on the axis and runs from top to bottom."""
    rings = profile[1:-1]
    turn = 2 * math.pi * np.arange(segments) / segments
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    vertices = [np.array([[0.0, 0.0, profile[0][1]]])]
    vertices += [np.column_stack([r * circle, np.full(segments, z)]) for r, z in rings]
    vertices.append(np.array([[0.0, 0.0, profile[-1][1]]]))
    here = np.arange(segments)
    after = (here + 1) % segments
    faces = [np.stack([np.zeros_like(here), 1 + here, 1 + after], axis=1)]
    for k in range(len(rings) - 1):
        upper, lower = 1 + k * segments, 1 + (k + 1) * segments
        faces.append(np.stack([upper + here, lower + here, lower + after], axis=1))
        faces.append(np.stack([upper + here, lower + after, upper + after], axis=1))
    last_ring, pole = 1 + (len(rings) - 1) * segments, 1 + len(rings) * segments
    faces.append(np.stack([last_ring + here, np.full_like(here, pole), last_ring + after], axis=1))
    return _mesh(np.concatenate(vertices), np.concatenate(faces))


def _mesh(vertices: Array, faces: NDArray[np.integer]) -> Mesh:
    index = np.ascontiguousarray(faces, dtype=np.int32)
    index.setflags(write=False)
    return Mesh(vertices=frozen_array(vertices), faces=index)
