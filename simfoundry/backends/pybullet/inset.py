"""Convex meshes shrunk by the collision margin that Bullet adds around them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from simfoundry.backends.urdf.elements import Split
from simfoundry.geometry.frames import IDENTITY, Array, Pose, frozen_array
from simfoundry.geometry.shapes import Geometry, Mesh

SKIN = 1e-3
"""Collision margin that Bullet adds around a convex mesh from a URDF [m]; it cannot be disabled."""


def split_under_skin() -> Split:
    """Return a split that shrinks each mesh by Bullet's margin; a mesh too thin to shrink is unchanged."""
    done: dict[str, Mesh] = {}

    def parts(geometry: Geometry) -> Iterator[tuple[str, Geometry, Pose]]:
        if isinstance(geometry, Mesh):
            digest = geometry.digest
            if digest not in done:
                done[digest] = inset_hull(geometry, SKIN) or geometry
            geometry = done[digest]
        yield "", geometry, IDENTITY

    return parts


def inset_hull(mesh: Mesh, distance: float) -> Mesh | None:
    """Return the convex hull of a mesh with every face moved inward by ``distance`` [m]; None if it is too thin.

    With a margin of the same size, the faces are in their original places and the edges are rounded.
    """
    from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

    try:
        planes = ConvexHull(np.asarray(mesh.vertices)).equations  # normal, offset: normal @ x + offset <= 0 inside
        inside = _inner_point(planes, mesh.vertices.mean(axis=0), 1.1 * distance)
        if inside is None:
            return None
        planes = planes + np.array([0.0, 0.0, 0.0, distance])
        corners = HalfspaceIntersection(planes, inside).intersections
        corners = np.unique(np.round(corners, 10), axis=0)  # a triangulated face gives each corner many times
        hull = ConvexHull(corners)
    except QhullError:  # flat, or too small for floating point
        return None
    return Mesh(frozen_array(corners), _outward(hull.simplices, hull.equations, corners))


def _inner_point(planes: Array, guess: Array, depth: float) -> Array | None:
    """Return a point at least ``depth`` [m] below every plane: the guess if it qualifies, else the deepest point."""
    from scipy.optimize import linprog

    if float((planes[:, :3] @ guess + planes[:, 3]).max()) < -depth:
        return guess
    rows = np.column_stack([planes[:, :3], np.ones(len(planes))])
    found = linprog([0.0, 0.0, 0.0, -1.0], A_ub=rows, b_ub=-planes[:, 3], bounds=[(None, None)] * 3 + [(0.0, None)])
    if not found.success or found.x[3] < depth:
        return None
    return np.asarray(found.x[:3], dtype=np.float64)


def _outward(simplices: np.ndarray, planes: Array, points: Array) -> np.ndarray:
    """Return the triangles in counter-clockwise order as seen from outside, int32, shape (m, 3)."""
    a, b, c = (points[simplices[:, k]] for k in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), planes[:, :3]) < 0
    faces = simplices.astype(np.int32)
    faces[inward] = faces[inward][:, [0, 2, 1]]
    return faces
