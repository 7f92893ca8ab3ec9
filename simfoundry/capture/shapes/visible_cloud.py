"""The visible surface of an object as a cloud of points with normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simfoundry.capture.shapes.evidence import Evidence
from simfoundry.geometry.frames import Array

# Number of nearest points to which a tangent plane is fitted: 5 x 6 pixels.
NEIGHBORS = 30


@dataclass(frozen=True, eq=False)
class VisibleCloud:
    """Observed points [m], shape (n, 3), with normals toward the camera, shape (n, 3), and the ray to their middle."""

    points: Array
    normals: Array
    ray: Array

    @classmethod
    def of(cls, evidence: Evidence, count: int) -> VisibleCloud:
        """Choose points that are spread evenly over the visible surface, and estimate their normals."""
        points = evidence.points
        chosen = points[np.linspace(0, len(points) - 1, min(len(points), count)).astype(np.int64)]
        ray = chosen.mean(axis=0) - evidence.eye
        return cls(chosen, visible_normals(chosen, points, evidence.eye), ray / np.linalg.norm(ray))


def visible_normals(points: Array, cloud: Array, eye: Array, reach: float = float("inf")) -> Array:
    """Estimate the normals of a visible surface at points, toward the camera.

    Args:
        points: Points on the surface [m], shape (n, 3).
        cloud: All points that were observed [m], shape (m, 3). The plane of the nearest ones is tangent.
        eye: Camera center [m], shape (3,).
        reach: Largest distance of a point that is considered [m].

    Returns:
        Unit vectors, shape (n, 3). If fewer than three points are within reach, they are arbitrary.
    """
    from scipy.spatial import cKDTree

    count = min(len(cloud), NEIGHBORS)
    distance, index = cKDTree(cloud).query(points, k=count, distance_upper_bound=reach)
    within = np.isfinite(distance).reshape(len(points), count, 1)
    near = cloud[np.minimum(index, len(cloud) - 1).reshape(len(points), count)]
    middle = (near * within).sum(axis=1, keepdims=True) / np.maximum(within.sum(axis=1, keepdims=True), 1)
    offsets = (near - middle) * within
    normals = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))[1][:, :, 0]
    toward = np.einsum("ni,ni->n", normals, eye - points)
    return np.asarray(normals * np.where(toward < 0, -1.0, 1.0)[:, None])
