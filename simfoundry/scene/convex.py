"""The convex hull of points, as a mesh of the scene."""

from __future__ import annotations

from simfoundry.assets.convex import hull
from simfoundry.assets.errors import MeshError
from simfoundry.scene.frames import Array, frozen_array
from simfoundry.scene.model import Mesh


def hull_mesh(points: Array) -> Mesh | None:
    """The hull of points [m], shape (n, 3), with at most 64 vertices; None where they lie in one plane."""
    try:
        vertices, faces = hull(points)
    except MeshError:
        return None
    faces.setflags(write=False)
    return Mesh(frozen_array(vertices), faces)
