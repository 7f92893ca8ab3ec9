"""Intersections of vertical lines with the convex parts of objects, used to find objects above and below a point."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.form import Form
from simfoundry.geometry.frames import Array, Index, Pose, Poses, frozen_array, rotate
from simfoundry.geometry.shapes import Box

# Maximum distance between a line and a part for the line to hit the part [m]; it covers rounding errors between
# adjacent parts of one object.
SEAM = 1e-6

# Cosine between a face normal and the up direction below which the face counts as vertical, that is, parallel to the
# lines.
STEEP = 1e-9


# Number of edges processed at once, which takes about 100 MB; a round tabletop has hundreds of edges.
AT_ONCE = 400_000


def chords_of(own: Form, X_WL: Poses, points: Array) -> tuple[Index, Array, Array, Array]:
    """Find the states in which vertical lines through given points may hit parts of a body.

    Args:
        own: Shapes of the body.
        X_WL: Poses of the body in n states.
        points: One point per state [m], shape (n, 3).

    Returns:
        Four arrays with one element for each pair of a line and a part that it may hit: the index of the state, the
        depth of the line inside the outline of the part [m], and the heights above the point at which the line enters
        and leaves the part [m].
    """
    form = _convex(own)
    local = rotate(X_WL.R.transpose(0, 2, 1), points - X_WL.p)
    up = X_WL.R[:, 2]
    low, high, _, _ = form.pieces
    state, part = np.nonzero(_beside_box(local, up, (low + high) / 2, (high - low) / 2) <= SEAM)
    if not len(state):
        return state, np.zeros(0), np.zeros(0), np.zeros(0)
    return state, *_chords(form, part, local[state], up[state])


@lru_cache(maxsize=256)
def _convex(form: Form) -> Form:
    """Return the form itself, or its bounding box if it is only visual, because visual meshes can be non-convex."""
    if form.solid:
        return form
    low, high = form.low[:3], form.high[:3]
    return Form.of([(Box(frozen_array(np.maximum(high - low, SEAM))), Pose.of((low + high) / 2))])


def _beside_box(points: Array, up: Array, middle: Array, half: Array) -> Array:
    """Return lower bounds on the distances [m] between lines and boxes, as an array of shape (n, k).

    Only directions perpendicular to both the line and an axis of the box are tested.

    Args:
        points: A point on each line [m], shape (n, 3).
        up: Unit vector along each line, shape (n, 3).
        middle: Centers of the boxes [m], shape (k, 3).
        half: Half extents of the boxes [m], shape (k, 3).
    """
    out = np.full((len(points), len(middle)), -np.inf)
    for axis in np.eye(3):
        way = np.cross(up, axis)
        size = np.linalg.norm(way, axis=1, keepdims=True)
        way = np.divide(way, size, out=np.zeros_like(way), where=size > STEEP)
        off = np.abs(np.einsum("ni,ni->n", points, way)[:, None] - way @ middle.T)
        out = np.maximum(out, off - np.abs(way) @ half.T)
    return out


class _Faces(NamedTuple):
    """The faces and edges of each part of a form, padded to equal length with entries that never affect the result.

    Attributes:
        planes: Outward unit normals and offsets [m] of the faces, shape (k, f, 4).
        lines: Unit vector along each edge and its moment about the origin [m], shape (k, e, 6).
        sides: Sum of the two adjacent face normals, crossed with the unit vector along the edge, shape (k, e, 3).
        beside: The two face normals adjacent to each edge, shape (k, e, 2, 3).
        axis: The two end points of each round part [m], shape (k, 2, 3).
        radius: Radius of each part [m], which is positive only for round parts, shape (k,).
        small: Mask of the parts with few faces and edges, shape (k,).
    """

    planes: Array
    lines: Array
    sides: Array
    beside: Array
    axis: Array
    radius: Array
    small: NDArray[np.bool_]


# Maximum number of faces and edges of a small part. Small parts are processed separately because padding them to the
# size of the few large parts would be wasteful.
SMALL_FACES, SMALL_EDGES = 16, 24


@lru_cache(maxsize=256)
def _faces(form: Form) -> _Faces:
    parts = form.parts
    k = len(parts.radius)
    planes: list[Array] = []
    edges: list[Index] = []
    of_triangle, of_edge = parts.part[parts.triangles[:, 0]], parts.part[parts.edges[:, 0]]
    flat = np.linalg.norm(parts.normals, axis=1) > 0.5  # degenerate triangles have zero normals
    offset = np.einsum("ij,ij->i", parts.normals, parts.corners[parts.triangles[:, 0]])
    sharp = (parts.beside >= 0).all(axis=1)
    for number in range(k):
        rows = np.flatnonzero((of_triangle == number) & flat)
        every = np.column_stack([parts.normals[rows], offset[rows]])
        planes.append(np.unique(np.round(every, 9), axis=0))
        own = np.flatnonzero((of_edge == number) & sharp)
        edges.append(own[flat[parts.beside[own]].all(axis=1)])
    most = [max((len(v) for v in every), default=0) for every in (planes, edges)]
    out = _Faces(
        np.zeros((k, most[0], 4)),
        np.zeros((k, most[1], 6)),
        np.zeros((k, most[1], 3)),
        np.full((k, most[1], 2, 3), np.nan),  # padding: NaN normals never bound an outline
        np.zeros((k, 2, 3)),
        parts.radius.copy(),
        np.array([len(f) <= SMALL_FACES and len(e) <= SMALL_EDGES for f, e in zip(planes, edges, strict=True)]),
    )
    for number in range(k):
        out.planes[number, : len(planes[number])] = planes[number]
        own = edges[number]
        first, last = parts.corners[parts.edges[own, 0]], parts.corners[parts.edges[own, 1]]
        way = (last - first) / np.linalg.norm(last - first, axis=1, keepdims=True)
        out.lines[number, : len(own)] = np.concatenate([way, np.cross(first, way)], axis=1)
        out.beside[number, : len(own)] = parts.normals[parts.beside[own]]
        out.sides[number, : len(own)] = np.cross(parts.normals[parts.beside[own]].sum(axis=1), way)
        corners = parts.corners[parts.part == number]
        if len(corners):
            out.axis[number] = corners[[0, -1]]
    return out


def _chords(form: Form, part: Index, points: Array, up: Array) -> tuple[Array, Array, Array]:
    """Intersect lines along ``up`` through ``points`` with parts.

    Args:
        points: A point on each line [m], shape (m, 3).
        up: Unit vector along each line, shape (m, 3).

    Returns:
        The depth of each line inside the outline of its part [m], and the heights above the point at which the line
        enters and leaves the part [m], shape (m,) each.
    """
    faces = _faces(form)
    sharp, small = faces.radius[part] <= 0, faces.small[part]
    few = faces._replace(**{name: getattr(faces, name)[:, :SMALL_EDGES] for name in ("lines", "sides", "beside")})
    few = few._replace(planes=faces.planes[:, :SMALL_FACES])
    out = np.empty((3, len(part)))
    ways = ((sharp & small, _sharp_chords, few), (sharp & ~small, _sharp_chords, faces), (~sharp, _round_chords, faces))
    for rows, measure, kept in ways:
        index = np.flatnonzero(rows)
        for some in np.array_split(index, len(index) * kept.lines.shape[1] // AT_ONCE + 1) if len(index) else ():
            out[:, some] = measure(kept, part[some], points[some], up[some])
    return out[0] + SEAM, out[1], out[2]


def _sharp_chords(faces: _Faces, part: Index, points: Array, up: Array) -> tuple[Array, Array, Array]:
    normals, offset = faces.planes[part, :, :3], faces.planes[part, :, 3]
    rising = (normals @ up[:, :, None])[..., 0]
    room = offset - (normals @ points[:, :, None])[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        at = room / rising
    top = np.where(rising > STEEP, at, np.inf).min(axis=1)
    bottom = np.where(rising < -STEEP, at, -np.inf).max(axis=1)
    # The outline is bounded by the edges between an upward and a downward face. The distance from a line along `up` to
    # an edge, and the side on which the line passes, are triple products; all factors except `up` and the point are
    # precomputed.
    lines = faces.lines[part]
    looks = (faces.beside[part].reshape(len(part), -1, 3) @ up[:, :, None]).reshape(len(part), -1, 2)
    across = np.sqrt(np.maximum(0.0, 1 - (lines[..., :3] @ up[:, :, None])[..., 0] ** 2))
    seen = (looks[..., 0] * looks[..., 1] <= 0) & (across > STEEP)
    apart = (lines @ np.concatenate([np.cross(up, points), -up], axis=1)[:, :, None])[..., 0]
    side = (faces.sides[part] @ up[:, :, None])[..., 0]
    off = np.where(seen, np.copysign(apart, apart * side) / np.maximum(across, STEEP), -np.inf)
    within = -off.max(axis=1, initial=-np.inf)
    return within, bottom, top


def _round_chords(faces: _Faces, part: Index, points: Array, up: Array) -> tuple[Array, Array, Array]:
    """Intersect lines with spheres and capsules."""
    first, last, radius = faces.axis[part, 0], faces.axis[part, 1], faces.radius[part]
    along = last - first
    level = along - np.einsum("mi,mi->m", along, up)[:, None] * up
    away = points - first
    away_level = away - np.einsum("mi,mi->m", away, up)[:, None] * up
    square = np.einsum("mi,mi->m", level, level)
    share = np.clip(np.einsum("mi,mi->m", away_level, level) / np.where(square > 0, square, 1.0), 0.0, 1.0)
    within = radius - np.linalg.norm(away_level - share[:, None] * level, axis=1)
    low, high = np.full(len(part), np.inf), np.full(len(part), -np.inf)
    for center in (first, last):
        found = _ball_chord(points - center, up, radius)
        low, high = np.fmin(low, found[0]), np.fmax(high, found[1])
    length = np.linalg.norm(along, axis=1)
    way = along / np.where(length > 0, length, 1.0)[:, None]
    flat_up = up - np.einsum("mi,mi->m", up, way)[:, None] * way
    flat = away - np.einsum("mi,mi->m", away, way)[:, None] * way
    a, b = np.einsum("mi,mi->m", flat_up, flat_up), np.einsum("mi,mi->m", flat_up, flat)
    inner = b * b - a * (np.einsum("mi,mi->m", flat, flat) - radius**2)
    for sign in (-1.0, 1.0):
        with np.errstate(divide="ignore", invalid="ignore"):
            at = (-b + sign * np.sqrt(inner)) / a
            height = np.einsum("mi,mi->m", away + at[:, None] * up, way)
            met = (height >= 0) & (height <= length) & (length > 0)
        low, high = np.fmin(low, np.where(met, at, np.inf)), np.fmax(high, np.where(met, at, -np.inf))
    return within, low, high


def _ball_chord(away: Array, up: Array, radius: Array) -> tuple[Array, Array]:
    """Return the heights at which lines enter and leave spheres. The heights are NaN for lines that miss."""
    middle = np.einsum("mi,mi->m", away, up)
    with np.errstate(invalid="ignore"):
        half = np.sqrt(radius**2 - np.einsum("mi,mi->m", away, away) + middle**2)
    return -middle - half, -middle + half
