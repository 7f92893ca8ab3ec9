"""Meshes with fewer triangles to be drawn: details smaller than a pixel cost time and show nothing."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import mujoco

    from simfoundry.scene.frames import Array

FEW = 500
"""A mesh of so few triangles is left as it is."""


def coarsened(model: mujoco.MjModel, grid: float) -> mujoco.MjModel:
    """A copy of a model for a renderer, whose meshes lose what lies within a cube of ``grid`` [m].

    All corners of a mesh in one cube become one of them; triangles that vanish by it, or appear twice, are left out. The
    copy is of no use for physics: it says nothing of what the meshes collide as.
    """
    drawn = copy.copy(model)
    for mesh in range(drawn.nmesh):
        if drawn.mesh_facenum[mesh] > FEW:
            _coarsen(drawn, mesh, grid)
    return drawn


def _coarsen(model: mujoco.MjModel, mesh: int, grid: float) -> None:
    begin, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    corner = int(model.mesh_vertadr[mesh])
    corners = model.mesh_vert[corner : corner + int(model.mesh_vertnum[mesh])]
    faces = _clusters(corners, grid)[model.mesh_face[begin : begin + count]]
    kept = _distinct(faces)
    model.mesh_face[begin : begin + len(kept)] = faces[kept]
    for rows in (model.mesh_facenormal, model.mesh_facetexcoord):  # the same corners of the same triangles
        rows[begin : begin + len(kept)] = rows[begin : begin + count][kept]
    model.mesh_facenum[mesh] = len(kept)


def _clusters(corners: Array, grid: float) -> Array:
    """For each corner [m], shape (n, 3), the index of the first in its cube, shape (n,)."""
    low = corners.min(axis=0)
    x, y, z = np.floor((corners - low) / grid).astype(np.int64).T
    size = int(max(x.max(), y.max(), z.max())) + 1
    _, first, cube = np.unique((x * size + y) * size + z, return_index=True, return_inverse=True)
    return np.asarray(first[cube])


def _distinct(faces: Array) -> Array:
    """The indices of triangles that have three corners and are not the same as one before, ascending."""
    a, b, c = np.sort(faces, axis=1).astype(np.int64).T
    size = int(c.max()) + 1
    _, first = np.unique((a * size + b) * size + c, return_index=True)
    first.sort()
    return np.asarray(first[(a[first] != b[first]) & (b[first] != c[first])])
