"""Mesh simplification for rendering: details smaller than a pixel take time and are not visible."""

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
"""Meshes with at most this many triangles are unchanged."""

FINE = 1e-3
"""Edge length of the cubes whose vertices are merged [m]: 0.4 pixels at half a meter in an image 320 pixels wide."""

FLAT_LEVELS, FLAT = 3, 0.985
"""Minimum cosine (10 deg) between the normals and their mean for merging in cubes of two, four and eight times that
size, in flat regions. The outline moves by at most 0.2 mm, and shading is unchanged because normals are kept."""


def coarsened(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy of a model for rendering, with meshes reduced to the detail visible in a small image.

    Triangles that become degenerate or duplicate by merging are omitted. The copy cannot be used for physics, because
    its collision meshes are not updated.
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
    for rows in (model.mesh_facenormal, model.mesh_facetexcoord):  # indexed by the same corners of the same triangles
        rows[begin : begin + len(kept)] = rows[begin : begin + count][kept]
    model.mesh_facenum[mesh] = len(kept)


def _clusters(corners: Floats, faces: Index) -> Index:
    """Return the index of the vertex into which each vertex [m], shape (n, 3), is merged, shape (n,)."""
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
    """Normalize vectors, shape (n, 3); vectors of zero length are unchanged."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, 1e-20), dtype=np.float64)


def _cubes(corners: Floats, size: float) -> Index:
    """Return the index of the cube that contains each vertex, counted from 0 among nonempty cubes, shape (n,)."""
    x, y, z = np.floor((corners - corners.min(axis=0)) / size).astype(np.int64).T
    along = int(max(x.max(), y.max(), z.max())) + 1
    return np.asarray(np.unique((x * along + y) * along + z, return_inverse=True)[1], dtype=np.int64)


def _distinct(faces: Index) -> Index:
    """Return the ascending indices of triangles with three distinct vertices that do not repeat an earlier triangle."""
    a, b, c = np.sort(faces, axis=1).T
    size = int(c.max()) + 1
    _, first = np.unique((a * size + b) * size + c, return_index=True)
    first.sort()
    return np.asarray(first[(a[first] != b[first]) & (b[first] != c[first])], dtype=np.int64)
