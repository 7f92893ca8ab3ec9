"""Determine the colors of captured objects.

The result is either a single robust color or a texture baked from the image. Every texel of the texture corresponds to
a point on the surface, and the color of this point is looked up in the image. Points that the camera did not see get
the color of the visible point on the opposite side.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.mesh import adjacent_faces
from simfoundry.capture.frame import Frame, SupportSurface
from simfoundry.capture.segment.masks import Mask, window_around
from simfoundry.capture.shapes.evidence import depth_scale
from simfoundry.capture.shapes.fit import FittedShape
from simfoundry.geometry.frames import Array, frozen_array
from simfoundry.geometry.ray_casts import area_normals, unit
from simfoundry.geometry.shapes import Mesh, tessellate

_LARGE, _SMALL = 512, 256
_LARGE_FROM = 120**2  # [px] minimum visible area of an object that benefits from the larger texture
_GRAZING = 0.2  # minimum cosine of the viewing angle at which a surface point has a reliable color
_NORMAL_WEIGHT = 0.03  # [m] weight of a unit difference in normals when searching for the nearest visible point
_LENDERS = 6000  # maximum number of points from which colors are copied; limits the nearest-neighbor search
_BATCH = 200_000  # texels that are compared with faces at once, in 20 MB of memory
_MARGIN = 3  # [px] margin around an object that the erosion of its mask and the interpolation of its colors can reach
_TOO_FAR = 0.3  # as a fraction of the object's size; beyond this, a uniform color looks better than a stretched one


@dataclass(frozen=True, eq=False)
class _Texels:
    """The texels on the surface.

    ``row`` and ``col`` are their positions in the texture. The points [m] and normals are in the object frame and have
    shape (n, 3).
    """

    row: NDArray[np.intp]
    col: NDArray[np.intp]
    points: Array
    normals: Array


def dominant_color(frame: Frame, mask: Mask) -> tuple[float, float, float]:
    """Return the robust mean color of the pixels under ``mask``, as sRGB in [0, 1].

    ``mask`` is a bool array of shape (h, w). The rim of the mask is excluded because colors mix there. The darkest 10%
    (shadows) and the lightest 20% (highlights) are also excluded.
    """
    if not mask.any():
        return 0.5, 0.5, 0.5
    window = window_around(mask, _MARGIN)
    return _robust_mean(frame.color[window], mask[window])


def _robust_mean(color: NDArray[np.uint8], mask: Mask) -> tuple[float, float, float]:
    core = _eroded(mask, 2)
    pixels = color[core if core.sum() >= 20 else mask].astype(np.float64) / 255.0
    light = pixels @ np.array([0.299, 0.587, 0.114])
    low, high = np.percentile(light, [10.0, 80.0])
    r, g, b = pixels[(light >= low) & (light <= high)].mean(axis=0)
    return float(r), float(g), float(b)


def textured_mesh(shape: FittedShape, frame: Frame, support: SupportSurface, mask: Mask) -> Mesh:
    """Return a fitted shape as a mesh in its object frame, with a PNG texture from the image.

    ``mask`` is a bool array of shape (h, w) that marks the object's pixels. Colors outside the mask are never used. The
    v axis of the texture coordinates points up.

    Raises:
        ValueError: The mask is empty.
    """
    if not mask.any():
        raise ValueError("cannot create a texture from an empty mask")
    mesh = tessellate(shape.geometry)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    atlas = unwrap(vertices, faces, _LARGE if int(mask.sum()) > _LARGE_FROM else _SMALL)
    texels = _rasterize(atlas, vertices, faces)
    window = window_around(mask, _MARGIN)
    color, depth, mask = frame.color[window], frame.depth[window], mask[window]
    core = _eroded(mask, 1 + int(mask.sum() > _LARGE_FROM / 4))
    core = core if core.any() else mask
    corner = (window[1].start, window[0].start)
    view = _View(shape, support, frame.K, corner, depth, core, _nearest_fill(color.astype(np.float32), core))
    colors = _paint(texels, view, np.array(_robust_mean(color, mask)) * 255.0)
    picture = _spread(texels, colors, atlas.size)
    return Mesh(frozen_array(vertices[atlas.source]), atlas.faces, frozen_array(atlas.uv), encode_png(picture))


def _rasterize(atlas: Atlas, vertices: Array, faces: NDArray[np.int32]) -> _Texels:
    """Find the texels inside each face, along with the surface point and the normal at each texel.

    A texel belongs to the last face that contains its center, or else to the first that narrowly misses it.
    """
    corners = atlas.texel[atlas.faces]
    low = np.maximum(np.floor(corners.min(axis=1) - 1), 0).astype(np.intp)
    high = np.minimum(np.ceil(corners.max(axis=1) + 1), atlas.size).astype(np.intp)
    (ax, ay), (bx, by) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    area = ax * by - bx * ay  # twice the area [texels²]
    sides = np.linalg.norm(corners[:, [1, 2, 0]] - corners[:, [2, 0, 1]], axis=2)
    heights = np.abs(area)[:, None] / np.maximum(sides, 1e-9)
    span = np.maximum(high - low, 0)
    proper = np.flatnonzero(np.abs(area) >= 1e-9)
    owner = np.full(atlas.size**2, -1, dtype=np.intp)
    weight = np.zeros((3, len(owner)))
    for batch in _batches(proper, span.prod(axis=1)):
        count = span[batch].prod(axis=1)
        face = np.repeat(batch, count)
        within = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
        row, col = low[face, 1] + within // span[face, 0], low[face, 0] + within % span[face, 0]
        x, y = col + 0.5 - corners[face, 0, 0], row + 0.5 - corners[face, 0, 1]
        second, third = (by[face] * x - bx[face] * y) / area[face], (ax[face] * y - ay[face] * x) / area[face]
        weights = np.stack([1.0 - second - third, second, third])
        # A barycentric weight multiplied by the height over its edge is a distance [texels]. A texel whose center
        # narrowly misses the face still belongs to it; otherwise, seams would be visible.
        near = np.flatnonzero((weights * heights[face].T).min(axis=0) > -0.75)
        face, texel, weights = face[near], row[near] * atlas.size + col[near], weights[:, near]
        is_in = weights.min(axis=0) >= 0
        for chosen in (np.flatnonzero(~is_in)[::-1], np.flatnonzero(is_in)):  # what is written last remains
            chosen = chosen[is_in[chosen] | (owner[texel[chosen]] < 0)]
            owner[texel[chosen]], weight[:, texel[chosen]] = face[chosen], weights[:, chosen]
    found = np.flatnonzero(owner >= 0)
    owned = owner[found]
    points = np.einsum("kn,nkd->nd", np.clip(weight[:, found], 0, 1), vertices[faces[owned]])
    return _Texels(found // atlas.size, found % atlas.size, points, face_normals(vertices, faces)[owned])


def _batches(faces: NDArray[np.intp], texels: NDArray[np.intp]) -> Iterator[NDArray[np.intp]]:
    """Yield the faces in groups that cover about :data:`_BATCH` texels, given the number of texels of each face."""
    if len(faces):
        group = np.cumsum(texels[faces]) // _BATCH
        yield from np.split(faces, np.flatnonzero(np.diff(group)) + 1)


@dataclass(frozen=True, eq=False)
class _View:
    """The window of the image around an object, prepared for texturing, and the projection of object points into it.

    ``corner`` is the position (column, row) of the window in the image. ``depth`` [m] has the shape (h, w) of the
    window. ``core`` is a bool array of the same shape that marks the object's pixels without the rim, where colors mix.
    ``colors`` is a float32 array of shape (h, w, 3) that contains only colors of the object.
    """

    shape: FittedShape
    support: SupportSurface
    K: Array
    corner: tuple[int, int]
    depth: Array
    core: Mask
    colors: NDArray[np.float32]

    def look(self, points: Array, normals: Array) -> tuple[Array, Mask]:
        """Return the colors of points in the object frame and a mask of the visible points.

        The colors have shape (n, 3) and are in [0, 255].
        """
        from scipy import ndimage

        p_W = self.shape.X_WO.apply(points)
        n_W = normals @ self.shape.X_WO.rotation.T
        ray = p_W - self.support.X_WC.p
        cosine = -np.einsum("ij,ij->i", n_W, ray) / np.maximum(np.linalg.norm(ray, axis=1), 1e-9)
        p_C = self.support.X_WC.inverse().apply(p_W)
        z, K = np.maximum(p_C[:, 2], 1e-6), self.K
        u = p_C[:, 0] / z * K[0, 0] + K[0, 2] - self.corner[0]
        v = p_C[:, 1] / z * K[1, 1] + K[1, 2] - self.corner[1]
        h, w = self.core.shape
        col, row = np.clip(np.round(u), 0, w - 1).astype(int), np.clip(np.round(v), 0, h - 1).astype(int)
        gap = self.depth[row, col] - z
        in_picture = (u >= 0) & (v >= 0) & (u <= w - 1) & (v <= h - 1) & (p_C[:, 2] > 0)
        same_surface = ~(np.abs(gap) > 2.0 * depth_scale(float(np.median(z))))  # missing depth is accepted
        where = np.stack([v, u])
        colors = [ndimage.map_coordinates(self.colors[..., k], where, order=1, mode="nearest") for k in range(3)]
        seen = in_picture & self.core[row, col] & (cosine > _GRAZING) & same_surface
        return np.stack(colors, axis=1).astype(np.float64), np.asarray(seen)


def _paint(texels: _Texels, view: _View, plain: Array) -> Array:
    """Return the colors of all texels, as an array of shape (n, 3).

    A texel that was not visible gets the color of the opposite point if that point was visible. Otherwise, it gets the
    color of the nearest visible point, or the color ``plain`` if that point is too far away.
    """
    points, normals = texels.points, texels.normals
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    colors, done = np.tile(plain, (len(points), 1)), np.zeros(len(points), dtype=bool)
    # Try the half turn before the mirror images because it keeps text readable.
    for flip in ((1, 1, 1), (-1, -1, 1), (-1, 1, 1), (1, -1, 1)):
        if not done.all():
            todo = np.nonzero(~done)[0]
            found, seen = view.look((points[todo] - center) * flip + center, normals[todo] * flip)
            colors[todo[seen]] = found[seen]
            done[todo[seen]] = True
    if 10 <= done.sum() < len(done):
        _borrow(np.hstack([points - center, _NORMAL_WEIGHT * normals]), colors, done)
    return colors


def _borrow(key: Array, colors: Array, done: Mask) -> None:
    """Replace each color that is not marked as ``done`` with the nearest color that is marked.

    The colors are replaced in place. A color is not replaced if the nearest one is too far away.
    """
    from scipy.spatial import cKDTree

    lenders, todo = np.nonzero(done)[0], np.nonzero(~done)[0]
    lenders = lenders[:: max(1, len(lenders) // _LENDERS)]
    reach = _TOO_FAR * float(np.ptp(key[:, :3], axis=0).max())
    distance, index = cKDTree(key[lenders]).query(key[todo], eps=0.2, distance_upper_bound=reach)
    near = np.isfinite(distance)
    colors[todo[near]] = colors[lenders[index[near]]]


def _spread(texels: _Texels, colors: Array, size: int) -> NDArray[np.uint8]:
    """Return the texture.

    Texels off the surface get the nearest color so that filtering does not blend in black.
    """
    picture = np.zeros((size, size, 3), dtype=np.float32)
    on_surface = np.zeros((size, size), dtype=bool)
    picture[texels.row, texels.col] = colors
    on_surface[texels.row, texels.col] = True
    return np.clip(np.round(_nearest_fill(picture, on_surface)), 0, 255).astype(np.uint8)


def _nearest_fill(picture: NDArray[np.float32], known: Mask) -> NDArray[np.float32]:
    """Fill each unknown pixel with the color of the nearest pixel that is marked as ``known``."""
    from scipy import ndimage

    index = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(picture[index[0], index[1]])


def _eroded(mask: Mask, pixels: int) -> Mask:
    from scipy import ndimage

    return np.asarray(ndimage.binary_erosion(mask, iterations=pixels))


def encode_png(picture: NDArray[np.uint8]) -> bytes:
    """Encode an RGB image as PNG. Identical images produce identical bytes."""
    import cv2

    # Level 3 takes a quarter of the time of level 9, and its files are 6 % larger.
    _, data = cv2.imencode(".png", picture[:, :, ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 3])
    return bytes(data)


_GUTTER = 4.0  # texels between charts, so that filtering never mixes two of them
_DIRECTIONS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Atlas:
    """An unwrapped mesh whose vertices are duplicated along chart seams.

    ``source`` contains the index of each vertex in the original mesh and has shape (n,). ``faces`` contains indices of
    the new vertices in the order of the original faces and has shape (m, 3). ``texel`` contains positions in the
    texture [texels, x to the right, y down] and has shape (n, 2).
    """

    source: NDArray[np.intp]
    faces: NDArray[np.int32]
    texel: Array
    size: int

    @property
    def uv(self) -> Array:
        """The texture coordinates, as an array of shape (n, 2).

        The v axis points up.
        """
        return np.column_stack([self.texel[:, 0] / self.size, 1.0 - self.texel[:, 1] / self.size])


def unwrap(vertices: Array, faces: NDArray[np.int32], size: int) -> Atlas:
    """Unwrap a mesh into a square texture of ``size`` texels.

    The vertices [m] have shape (n, 3), and the faces have shape (m, 3).
    """
    facing = _facing(vertices, faces)
    chart = _charts(vertices, faces, facing)
    source_parts, texel_parts, extents = [], [], []
    new_faces = np.zeros_like(faces)
    offset = 0
    for k in range(int(chart.max()) + 1):
        chosen = np.nonzero(chart == k)[0]
        used, local = np.unique(faces[chosen], return_inverse=True)
        axis = int(facing[chosen[0]]) // 2
        plane = np.delete(vertices[used], axis, axis=1)
        if axis != 2:
            plane = plane * [1.0, -1.0]  # keep the texture upright: z up maps to y up
        new_faces[chosen] = local.reshape(-1, 3) + offset
        offset += len(used)
        source_parts.append(used)
        texel_parts.append(plane - plane.min(axis=0))
        extents.append(np.ptp(plane, axis=0))
    corners, scale = _pack(np.array(extents), size)
    texel = np.concatenate([part * scale + corner for part, corner in zip(texel_parts, corners, strict=True)])
    return Atlas(np.concatenate(source_parts), new_faces, texel, size)


def face_normals(vertices: Array, faces: NDArray[np.int32]) -> Array:
    """Return the unit normals of faces, as an array of shape (m, 3)."""
    return unit(area_normals(vertices[faces]))


def _facing(vertices: Array, faces: NDArray[np.int32]) -> NDArray[np.intp]:
    """Return the direction of each face.

    An isolated face gets the direction of its neighbors, which reduces the number of charts.
    """
    dots = face_normals(vertices, faces) @ _DIRECTIONS.T
    facing = np.argmax(dots + np.arange(6) * 1e-9, axis=1)
    pairs = adjacent_faces(vertices, faces)
    for _ in range(3):
        votes = np.zeros((len(faces), 6))
        np.add.at(votes, (pairs[:, 0], facing[pairs[:, 1]]), 1.0)
        np.add.at(votes, (pairs[:, 1], facing[pairs[:, 0]]), 1.0)
        votes[dots < 0.35] = 0.0
        wanted = np.argmax(votes, axis=1)
        facing = np.where(votes[np.arange(len(faces)), wanted] >= 2, wanted, facing)
    return np.asarray(facing)


def _charts(vertices: Array, faces: NDArray[np.int32], facing: NDArray[np.intp]) -> NDArray[np.intp]:
    """Number the connected patches of faces that have the same direction."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    pairs = adjacent_faces(vertices, faces)
    pairs = pairs[facing[pairs[:, 0]] == facing[pairs[:, 1]]]
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(faces), len(faces)))
    return np.asarray(connected_components(graph, directed=False)[1])


def _pack(extents: Array, size: int) -> tuple[Array, float]:
    """Pack rectangles into the texture.

    Returns:
        The corners of the rectangles [texels] and the largest possible scale [texels/m].
    """
    low, high = 0.0, size / max(float(extents.max()), 1e-9)
    for _ in range(24):
        middle = (low + high) / 2
        low, high = (middle, high) if _shelves(extents * middle, size) is not None else (low, middle)
    corners = _shelves(extents * low, size)
    if corners is None:  # too many charts for the gutters; let them overlap at one position
        return np.full((len(extents), 2), _GUTTER), 0.0
    return corners, low


def _shelves(extents: Array, size: int) -> Array | None:
    """Return the corners of rectangles that are placed on shelves, with the tallest rectangles first.

    The result is None if the rectangles do not fit.
    """
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
