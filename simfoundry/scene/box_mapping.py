"""Texture coordinates for surfaces without their own, by projection along the nearest axis."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from simfoundry.geometry.frames import Array
from simfoundry.geometry.shapes import Geometry, Mesh, closed_mesh, tessellate


class Texture(NamedTuple):
    """The image of a material: ``png`` is the content of a PNG file, and ``size`` [m] the width of one repetition.

    If ``size`` is None, the image covers the longest side of each surface once.
    """

    png: bytes
    size: float | None = None


# For each side of a box (+x, -x, +y, -y, +z, -z): the axis that runs to the right in the image as seen from outside and
# its sign, and the axis that runs up.
_SIDES = ((1, 1, 2), (1, -1, 2), (0, -1, 2), (0, 1, 2), (0, 1, 1), (0, -1, 1))


def textured(geometry: Geometry, texture: Texture) -> Mesh:
    """Return the surface of a shape with a repeating image, which is projected along the axis nearest to each normal.

    The texture coordinates start at the corner of the bounding box. The vertices on the border of two projections are
    duplicated. A mesh with texture coordinates keeps them.
    """
    mesh = tessellate(geometry)
    if mesh.uv is not None:
        return closed_mesh(mesh.vertices, mesh.faces, mesh.uv, texture.png)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    along = np.abs(normals).argmax(axis=1)
    side = 2 * along + (normals[np.arange(len(along)), along] < 0)
    # Each pair of a vertex and a side becomes one vertex.
    pairs, faces = np.unique(mesh.faces * len(_SIDES) + side[:, None], return_inverse=True)
    vertices = mesh.vertices[pairs // len(_SIDES)]
    uv = _coordinates(vertices, pairs % len(_SIDES), texture.size)
    return closed_mesh(vertices, faces.reshape(-1, 3).astype(np.int32), uv, texture.png)


def _coordinates(vertices: Array, sides: Array, size: float | None) -> Array:
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    width = float((high - low).max()) if size is None else size
    uv = np.zeros((len(vertices), 2))
    for k, (right, sign, up) in enumerate(_SIDES):
        chosen = sides == k
        start = vertices[chosen, right] - low[right] if sign > 0 else high[right] - vertices[chosen, right]
        uv[chosen] = np.column_stack([start, vertices[chosen, up] - low[up]]) / width
    return uv
