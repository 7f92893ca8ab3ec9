"""Texture coordinates for any closed mesh: charts that face one of six directions, packed on shelves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array

_GUTTER = 4.0  # texels between charts, so that filtering never mixes two of them
_DIRECTIONS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Atlas:
    """An unwrapped mesh: vertices are repeated where charts meet.

    ``source`` the vertex of the original mesh, shape (n,); ``faces`` into the new vertices, shape (m, 3), in the order
    of the original faces; ``texel`` positions in the texture [texels, x right, y down], shape (n, 2).
    """

    source: NDArray[np.intp]
    faces: NDArray[np.int32]
    texel: Array
    size: int

    @property
    def uv(self) -> Array:
        """Texture coordinates, v up, shape (n, 2)."""
        return np.column_stack([self.texel[:, 0] / self.size, 1.0 - self.texel[:, 1] / self.size])


def unwrap(vertices: Array, faces: NDArray[np.int32], size: int) -> Atlas:
    """Unwrap a mesh (vertices [m], shape (n, 3); faces shape (m, 3)) into a square texture of ``size`` texels."""
    facing = _facing(vertices, faces)
    chart = _charts(faces, facing)
    source_parts, texel_parts, extents = [], [], []
    new_faces = np.zeros_like(faces)
    offset = 0
    for k in range(int(chart.max()) + 1):
        chosen = np.nonzero(chart == k)[0]
        used, local = np.unique(faces[chosen], return_inverse=True)
        axis = int(facing[chosen[0]]) // 2
        plane = np.delete(vertices[used], axis, axis=1)
        if axis != 2:
            plane = plane * [1.0, -1.0]  # upright in the texture: z up is y up
        new_faces[chosen] = local.reshape(-1, 3) + offset
        offset += len(used)
        source_parts.append(used)
        texel_parts.append(plane - plane.min(axis=0))
        extents.append(np.ptp(plane, axis=0))
    corners, scale = _pack(np.array(extents), size)
    texel = np.concatenate([part * scale + corner for part, corner in zip(texel_parts, corners, strict=True)])
    return Atlas(np.concatenate(source_parts), new_faces, texel, size)


def face_normals(vertices: Array, faces: NDArray[np.int32]) -> Array:
    """Unit normals, shape (m, 3)."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-15))


def _neighbors(faces: NDArray[np.int32]) -> NDArray[np.intp]:
    """Pairs of faces that share an edge, shape (k, 2)."""
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(len(faces)), 3)
    order = np.lexsort((owner, edges[:, 1], edges[:, 0]))
    edges, owner = edges[order], owner[order]
    same = np.all(edges[1:] == edges[:-1], axis=1)
    return np.column_stack([owner[:-1][same], owner[1:][same]])


def _facing(vertices: Array, faces: NDArray[np.int32]) -> NDArray[np.intp]:
    """The direction each face belongs to; a lone face among others joins them, so that charts stay few."""
    dots = face_normals(vertices, faces) @ _DIRECTIONS.T
    facing = np.argmax(dots + np.arange(6) * 1e-9, axis=1)
    pairs = _neighbors(faces)
    for _ in range(3):
        votes = np.zeros((len(faces), 6))
        np.add.at(votes, (pairs[:, 0], facing[pairs[:, 1]]), 1.0)
        np.add.at(votes, (pairs[:, 1], facing[pairs[:, 0]]), 1.0)
        votes[dots < 0.35] = 0.0
        wanted = np.argmax(votes, axis=1)
        facing = np.where(votes[np.arange(len(faces)), wanted] >= 2, wanted, facing)
    return np.asarray(facing)


def _charts(faces: NDArray[np.int32], facing: NDArray[np.intp]) -> NDArray[np.intp]:
    """Number the connected patches of faces with one direction."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    pairs = _neighbors(faces)
    pairs = pairs[facing[pairs[:, 0]] == facing[pairs[:, 1]]]
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(faces), len(faces)))
    return np.asarray(connected_components(graph, directed=False)[1])


def _pack(extents: Array, size: int) -> tuple[Array, float]:
    """Corners [texels] and the largest common scale [texels/m] at which all rectangles fit the texture."""
    low, high = 0.0, size / max(float(extents.max()), 1e-9)
    for _ in range(24):
        middle = (low + high) / 2
        low, high = (middle, high) if _shelves(extents * middle, size) is not None else (low, middle)
    corners = _shelves(extents * low, size)
    if corners is None:  # more charts than gutters leave room for: let them share one spot
        return np.full((len(extents), 2), _GUTTER), 0.0
    return corners, low


def _shelves(extents: Array, size: int) -> Array | None:
    """Corners of rectangles set on shelves, tallest first, or None if they do not fit."""
    corners = np.zeros_like(extents)
    x = y = _GUTTER
    shelf = 0.0
    for k in np.lexsort((np.arange(len(extents)), -extents[:, 1])):
        width, height = extents[k]
        if x + width + _GUTTER > size:
            x, y, shelf = _GUTTER, y + shelf + _GUTTER, 0.0
        if x + width + _GUTTER > size or y + height + _GUTTER > size:
            return None
        corners[k] = (x, y)
        x += width + _GUTTER
        shelf = max(shelf, float(height))
    return corners
