"""Meshes with fewer triangles to be drawn: details smaller than a pixel cost time and show nothing."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import mujoco

Index = NDArray[np.int64]
Floats = NDArray[np.float32]

FEW = 500
"""A mesh of so few triangles is left as it is."""

FINE = 1e-3
"""Corners within a cube of this size [m] become one: 0.4 pixels at half a metre in a picture 320 pixels wide."""

FLAT_LEVELS, FLAT = 3, 0.985
"""Up to twice, four and eight times that size where a surface is so flat: the least cosine (10 deg) between its normals
and their mean. The outline moves by 0.2 mm at most, and shading not at all, because normals are kept."""


def coarsened(model: mujoco.MjModel) -> mujoco.MjModel:
    """A copy of a model for a renderer, whose meshes lose what a small picture does not show.

    Triangles that vanish when corners become one, or appear twice, are left out. The copy is of no use for physics: it
    says nothing of what the meshes collide as.
    """
    drawn = copy.copy(model)
    for mesh in range(drawn.nmesh):
        if drawn.mesh_facenum[mesh] > FEW:
            _coarsen(drawn, mesh)
    return drawn


def _coarsen(model: mujoco.MjModel, mesh: int) -> None:
    begin, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    corner = int(model.mesh_vertadr[mesh])
    corners = model.mesh_vert[corner : corner + int(model.mesh_vertnum[mesh])]
    faces = model.mesh_face[begin : begin + count].astype(np.int64)
    faces = _clusters(corners, faces)[faces]
    kept = _distinct(faces)
    model.mesh_face[begin : begin + len(kept)] = faces[kept]
    for rows in (model.mesh_facenormal, model.mesh_facetexcoord):  # the same corners of the same triangles
        rows[begin : begin + len(kept)] = rows[begin : begin + count][kept]
    model.mesh_facenum[mesh] = len(kept)


def _clusters(corners: Floats, faces: Index) -> Index:
    """For each corner [m], shape (n, 3), the index of the one that it becomes, shape (n,)."""
    a, b, c = (corners[faces[:, k]] for k in range(3))
    normals = _unit(np.cross(b - a, c - a))
    owner = _cubes(corners, FINE)
    for level in range(1, FLAT_LEVELS + 1):
        cubes = _cubes(corners, FINE * 2**level)
        at = cubes[faces.ravel()]
        every = np.repeat(normals, 3, axis=0)
        mean = _unit(np.stack([np.bincount(at, every[:, k], cubes.max() + 1) for k in range(3)], axis=1))
        least = np.ones(len(mean))
        np.minimum.at(least, at, np.einsum("ij,ij->i", every, mean[at]))
        flat = least[cubes] > FLAT
        owner = np.where(flat, cubes + (level << 32), owner)
    _, first, cube = np.unique(owner, return_index=True, return_inverse=True)
    return np.asarray(first[cube])


def _unit(vectors: NDArray[np.floating]) -> NDArray[np.float64]:
    """Vectors of length one, shape (n, 3); what has no length stays."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, 1e-20), dtype=np.float64)


def _cubes(corners: Floats, size: float) -> Index:
    """The number of the cube that each corner lies in, counted from 0 among those that hold any, shape (n,)."""
    x, y, z = np.floor((corners - corners.min(axis=0)) / size).astype(np.int64).T
    along = int(max(x.max(), y.max(), z.max())) + 1
    return np.asarray(np.unique((x * along + y) * along + z, return_inverse=True)[1], dtype=np.int64)


def _distinct(faces: Index) -> Index:
    """The indices of triangles that have three corners and are not the same as one before, ascending."""
    a, b, c = np.sort(faces, axis=1).T
    size = int(c.max()) + 1
    _, first = np.unique((a * size + b) * size + c, return_index=True)
    first.sort()
    return np.asarray(first[(a[first] != b[first]) & (b[first] != c[first])], dtype=np.int64)
