"""The visible surface of an object as a cloud of points with normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simfoundry.capture.shapes.evidence import Evidence
from simfoundry.geometry.frames import Array


@dataclass(frozen=True, eq=False)
class VisibleCloud:
    """Observed points [m], shape (n, 3), with normals toward the camera, shape (n, 3), and the ray to their middle."""

    points: Array
    normals: Array
    ray: Array

    @classmethod
    def of(cls, evidence: Evidence, count: int) -> VisibleCloud:
        """Choose points that are spread evenly over the visible surface, and estimate their normals."""
        from scipy.spatial import cKDTree

        points = evidence.points
        chosen = points[np.linspace(0, len(points) - 1, min(len(points), count)).astype(np.int64)]
        tree = cKDTree(points)
        beside = min(len(points), 30)
        near = points[tree.query(chosen, k=beside)[1].reshape(len(chosen), beside)]
        middle = near.mean(axis=1, keepdims=True)
        moments = np.einsum("nki,nkj->nij", near - middle, near - middle)
        normals = np.linalg.eigh(moments)[1][:, :, 0]
        toward = np.einsum("ni,ni->n", normals, evidence.eye - chosen)
        normals = normals * np.where(toward < 0, -1.0, 1.0)[:, None]
        ray = chosen.mean(axis=0) - evidence.eye
        return cls(chosen, normals, ray / np.linalg.norm(ray))
