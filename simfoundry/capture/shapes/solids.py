"""Stacks of outlines as closed meshes, and whether a solid stands on its foot."""

from __future__ import annotations

import numpy as np

from simfoundry.assets.solids import ring_faces
from simfoundry.geometry.frames import Array
from simfoundry.geometry.shapes import Mesh
from simfoundry.geometry.tessellate import closed_mesh


def loft_mesh(rings: Array) -> Mesh:
    """Rings of points [m], shape (k, sides, 3), from the bottom up, each counter-clockwise from above, closed by caps.

    The caps are fans about each end ring's mean, so the end rings must be star-shaped about it.
    """
    levels, sides, _ = rings.shape
    top_down = rings[::-1].reshape(-1, 3)
    vertices = np.concatenate([rings[-1].mean(axis=0)[None], top_down, rings[0].mean(axis=0)[None]])
    return closed_mesh(vertices, ring_faces(levels, sides))


def hull_margin(footprint: Array, point: Array) -> float:
    """Distance inside the convex hull of ``footprint`` (xy [m], shape (n, 2)) a point lies [m]; negative outside."""
    from scipy.spatial import ConvexHull

    equations = ConvexHull(footprint).equations
    return float(-(equations[:, :2] @ point + equations[:, 2]).max())
