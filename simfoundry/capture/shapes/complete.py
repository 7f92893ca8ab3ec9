"""Completion of shapes beyond primitives: visible surface, mirrored far side, carved by observed free space.

The solid is a stack of horizontal slices. In each slice the near side is what was seen, the far side its mirror image
across a vertical plane along the object, never beyond where the camera saw through, and never short of what was seen
further up. Each slice is a star-shaped polygon about its own center, so the stack is closed and free of
self-intersection by construction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets import mass
from simfoundry.assets.solids import ring_faces
from simfoundry.capture.frame import Frame, SupportSurface
from simfoundry.capture.shapes.evidence import Evidence, RayAgreement, agreement, cast_mesh
from simfoundry.capture.shapes.fit_primitives import DEPTH_PRIOR
from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.shapes import Mesh, closed_mesh

LEVELS, SIDES, COLUMNS = 18, 40, 32  # slices, their corners and columns: 5 to 10 mm on household objects
FOOT_MARGIN = 0.15  # of the foot's radius, that the center of mass must keep from the edge of the foot
_THINNEST = 0.003  # [m] thinnest solid: the depth noise at half a meter
_STEPS = 48  # samples of free space behind a column: 2 to 5 mm apart
_MIN_IN_SLICE = 12  # points that a slice needs for two percentiles to mean anything
_PAD = 0.0025  # height of the pad under a solid that would tip over [m]
_SEEN_PAST = 0.01  # [m] distance behind a point at which the observed surface proves the point free


@dataclass(frozen=True, eq=False)
class CompletedFit:
    """A closed mesh (origin at the center of its base, z up), its pose, and its agreement with the picture."""

    mesh: Mesh
    X_WO: Pose
    agreement: RayAgreement


@dataclass(frozen=True, eq=False)
class _Slices:
    """Per level ``z`` [m], shape (k,): columns ``t`` across and the ``near`` and ``far`` side along the depth axis [m],
    each shape (k, COLUMNS), in the axes ``across`` and ``along`` (world xy, shape (2,))."""

    z: Array
    t: Array
    near: Array
    far: Array
    across: Array
    along: Array


def complete(frame: Frame, support: SupportSurface, evidence: Evidence) -> CompletedFit:
    """Complete the points in ``evidence`` to a solid that stands on ``base_z``."""
    slices = _slice(frame, support, evidence)
    rings = _carve(_Space(frame, support, slices.across, slices.along), _smooth(_rings(slices)))
    rings = _stabilize(_stand(rings, evidence.base_z))
    origin = np.array([*((rings[0, :, :2].min(axis=0) + rings[0, :, :2].max(axis=0)) / 2), evidence.base_z])
    mesh = loft_mesh(rings - origin)
    hits = cast_mesh(evidence.eye, evidence.rays, np.asarray(mesh.vertices) + origin, np.asarray(mesh.faces))
    return CompletedFit(mesh, Pose.of(origin), agreement(evidence, hits))


def _axes(evidence: Evidence) -> tuple[Array, Array]:
    """Axes across and along the depth of the object: along its broad side, but within 50 degrees of the view."""
    view = evidence.view
    across = np.array([-view[1], view[0]])
    xy = evidence.points[:, :2] - np.median(evidence.points[:, :2], axis=0)
    values, vectors = np.linalg.eigh(np.cov(xy.T))
    if values[1] > 1.5**2 * values[0]:
        major = vectors[:, 1] * (1.0 if vectors[:, 1] @ across >= 0 else -1.0)
        if major @ across > math.cos(math.radians(50)):
            across = major
    return across, np.array([across[1], -across[0]])


def _slice(frame: Frame, support: SupportSurface, evidence: Evidence) -> _Slices:
    across, along = _axes(evidence)
    space = _Space(frame, support, across, along)
    fronts = _fronts(evidence, evidence.points[:, :2] @ across, evidence.points[:, :2] @ along)
    depths = _mirror_depths(fronts)
    rows: list[tuple[float, Array, Array, Array]] = []
    for (level, columns, near, seen), middle in zip(fronts, depths, strict=True):
        limit = np.maximum(seen, _free_limit(space, columns, near, level))
        mirrored = 2 * middle - np.minimum(near, middle)
        far = np.maximum(np.clip(mirrored, seen, limit), near + _THINNEST)
        own = (columns, near, far)
        rows.append((level, *(_extend(space, level, own, rows[-1][1:]) if rows else own)))
    rows.reverse()
    z, t, near, far = (np.array([row[k] for row in rows]) for k in range(4))
    return _Slices(z, t, near, far, across, along)


def _fronts(evidence: Evidence, t: Array, s: Array) -> list[tuple[float, Array, Array, Array]]:
    """Height, columns, near side and visible extent [m] of each slice, from the top down."""
    z = evidence.points[:, 2]
    height = max(evidence.top - evidence.base_z, 2 * _THINNEST)
    edges = np.linspace(evidence.base_z + min(0.012, 0.2 * height), evidence.base_z + height, LEVELS + 1)
    reach = max((edges[1] - edges[0]) / 2, 0.3 * evidence.scale)
    fronts = []
    for level in ((edges[:-1] + edges[1:]) / 2)[::-1]:
        here, above = np.abs(z - level) < reach, z > level - reach
        if here.sum() >= _MIN_IN_SLICE:
            columns = _columns(t[here])
            near = _envelope(columns, t[here], s[here], 10.0)
            fronts.append((float(level), columns, near, np.maximum(_envelope(columns, t[above], s[above], 92.0), near)))
    if not fronts:
        columns = _columns(t)
        near, seen = np.full(COLUMNS, np.percentile(s, 2.0)), np.full(COLUMNS, np.percentile(s, 98.0))
        fronts.append((float(evidence.base_z + height / 2), columns, near, seen))
    return fronts


def _columns(t: Array) -> Array:
    low, high = np.percentile(t, [1.0, 99.0])
    return np.linspace(low, max(high, low + _THINNEST), COLUMNS)


def _mirror_depths(fronts: list[tuple[float, Array, Array, Array]]) -> Array:
    """Position of the mirror plane in each slice [m].

    An ellipse curves back by 0.47 of its half depth over the inner 85 % of its width; a flat front tells nothing, and
    the depth prior of boxes takes over. Things that stand are symmetric about one plane from foot to cap, so the
    slices share their median as far as each slice's width allows.
    """
    width = np.array([columns[-1] - columns[0] for _, columns, _, _ in fronts])
    front, turned = np.array([np.percentile(near, [10.0, 85.0]) for _, _, near, _ in fronts]).T
    own = front + np.clip((turned - front) * 2.1, DEPTH_PRIOR / 2 * width, 0.55 * width)
    return np.asarray(front + np.clip(np.median(own) - front, DEPTH_PRIOR / 2 * width, 0.6 * width))


def _envelope(columns: Array, t: Array, s: Array, percentile: float) -> Array:
    """A low or high percentile of ``s`` near each column, interpolated where a column saw nothing."""
    pitch = max(float(columns[1] - columns[0]), 1e-6)
    index = np.clip(np.round((t - columns[0]) / pitch).astype(int), 0, len(columns) - 1)
    out = np.full(len(columns), np.nan)
    for k in range(len(columns)):
        here = s[index == k]
        if len(here) >= 2:
            out[k] = np.percentile(here, percentile)
    good = np.isfinite(out)
    if not good.any():
        return np.full(len(columns), float(np.percentile(s, percentile)))
    out = np.interp(columns, columns[good], out[good])
    padded = np.concatenate([out[:1], out, out[-1:]])
    return np.asarray(np.median(np.stack([padded[:-2], padded[1:-1], padded[2:]]), axis=0))


@dataclass(frozen=True, eq=False)
class _Space:
    """Free space as the camera saw it, in the axes of the slices."""

    frame: Frame
    support: SupportSurface
    across: Array
    along: Array

    def free(self, t: Array, s: Array, level: float) -> NDArray[np.bool_]:
        """Test whether the camera saw past each place (t, s) [m] at the height ``level`` [m]."""
        frame = self.frame
        xy = t[..., None] * self.across + s[..., None] * self.along
        p_C = self.support.X_WC.inverse().apply(np.concatenate([xy, np.full((*s.shape, 1), level)], axis=-1))
        u = np.round(p_C[..., 0] / p_C[..., 2] * frame.K[0, 0] + frame.K[0, 2])
        v = np.round(p_C[..., 1] / p_C[..., 2] * frame.K[1, 1] + frame.K[1, 2])
        h, w = frame.depth.shape
        known = (u >= 0) & (v >= 0) & (u < w) & (v < h)
        observed = frame.depth[np.clip(v, 0, h - 1).astype(int), np.clip(u, 0, w - 1).astype(int)]
        return np.asarray(known & (observed > p_C[..., 2] + _SEEN_PAST))


def _free_limit(space: _Space, columns: Array, near: Array, level: float) -> Array:
    """Greatest depth of a solid per column [m] before it would occlude the background that the camera saw."""
    steps = np.linspace(0.0, 1.3 * float(columns[-1] - columns[0]) + 0.01, _STEPS)
    s = near[:, None] + steps
    free = space.free(np.broadcast_to(columns[:, None], s.shape), s, level)
    return np.asarray(near + steps[np.where(free.any(axis=1), np.argmax(free, axis=1), _STEPS - 1)])


def _extend(
    space: _Space, level: float, own: tuple[Array, Array, Array], above: tuple[Array, Array, Array]
) -> tuple[Array, Array, Array]:
    """Widen a slice to the columns of the slice above that do not overhang observed free space."""
    columns, near, far = own
    t, near_above, far_above = above
    held = ~space.free(t, (near_above + far_above) / 2, level)
    middle = int(np.argmin(np.abs(t - (columns[0] + columns[-1]) / 2)))
    first, last = middle, middle
    while first > 0 and (t[first - 1] >= columns[0] or held[first - 1]):
        first -= 1
    while last < len(t) - 1 and (t[last + 1] <= columns[-1] or held[last + 1]):
        last += 1
    wide = np.linspace(min(columns[0], t[first]), max(columns[-1], t[last]), COLUMNS)
    outside = (wide < columns[0]) | (wide > columns[-1])
    merged = [
        np.where(outside, np.interp(wide, t, side_above), np.interp(wide, columns, side))
        for side, side_above in ((near, near_above), (far, far_above))
    ]
    return wide, merged[0], merged[1]


def _rings(slices: _Slices) -> Array:
    """Star-shaped outlines about each slice's center, world [m], shape (k, SIDES, 3), counter-clockwise."""
    angle = np.arange(SIDES) * (2 * math.pi / SIDES)
    ray = np.column_stack([np.cos(angle), np.sin(angle)])
    rings = []
    for level, t, near, far in zip(slices.z, slices.t, slices.near, slices.far, strict=True):
        depth = far - near
        ct = float((t * depth).sum() / depth.sum())
        cs = float(np.interp(ct, t, (near + far) / 2))
        reach = 1.05 * math.hypot(t[-1] - t[0], far.max() - near.min()) + _THINNEST
        rho = np.linspace(0.0, reach, 4 * _STEPS)
        tt, ss = ct + ray[:, :1] * rho, cs + ray[:, 1:] * rho
        inside = (tt >= t[0]) & (tt <= t[-1]) & (ss >= np.interp(tt, t, near)) & (ss <= np.interp(tt, t, far))
        first_out = np.where(inside.all(axis=1), len(rho), np.argmin(inside, axis=1))
        radius = np.maximum(rho[np.maximum(first_out - 1, 0)], _THINNEST / 2)
        local = np.array([ct, cs]) + ray * radius[:, None]
        xy = local[:, :1] * slices.across + local[:, 1:] * slices.along
        rings.append(np.column_stack([xy, np.full(SIDES, level)]))
    stacked = np.array(rings)
    if slices.across[0] * slices.along[1] - slices.across[1] * slices.along[0] < 0:
        stacked = stacked[:, ::-1]
    return stacked


def _smooth(rings: Array) -> Array:
    """Smooth the noise: one pass around each ring, one pass up the stack."""
    round_ = 0.25 * np.roll(rings, 1, axis=1) + 0.5 * rings + 0.25 * np.roll(rings, -1, axis=1)
    padded = np.concatenate([round_[:1], round_, round_[-1:]])
    out = 0.25 * padded[:-2] + 0.5 * padded[1:-1] + 0.25 * padded[2:]
    out[..., 2] = rings[..., 2]
    return np.asarray(out)


def _carve(space: _Space, rings: Array) -> Array:
    """Pull every point in observed free space toward its slice's center until it leaves that space."""
    center = rings[..., :2].mean(axis=1, keepdims=True)
    out = rings.copy()
    share = np.ones(rings.shape[:2])
    for _ in range(8):
        for k, ring in enumerate(out):
            free = space.free(ring[:, :2] @ space.across, ring[:, :2] @ space.along, float(ring[0, 2]))
            share[k] -= np.where(free & (share[k] > 0.3), 0.1, 0.0)
        out[..., :2] = center + share[..., None] * (rings[..., :2] - center)
    return out


def _stand(rings: Array, base_z: float) -> Array:
    """Close the stack: half a level on top, the lowest slice extended straight down to the base."""
    pitch = float(rings[1, 0, 2] - rings[0, 0, 2]) if len(rings) > 1 else 2 * float(rings[0, 0, 2] - base_z)
    top, foot = rings[-1:].copy(), rings[:1].copy()
    top[..., 2] += pitch / 2
    foot[..., 2] = base_z
    return np.concatenate([foot, rings, top])


def _stabilize(rings: Array) -> Array:
    """Put a thin pad under a solid that would tip over: the hull of its foot and of a disk under its center of mass."""
    wanted = max(FOOT_MARGIN * math.sqrt(_area(rings[0, :, :2]) / math.pi), 0.003)
    out = rings
    for attempt in range(6):
        if _foot_margin(out) >= wanted:
            break
        disk = (1.5 + 0.5 * attempt) * wanted
        pad = rings[0].copy()
        pad[:, :2] = _hull_with_disk(rings[0, :, :2], _com(out)[:2], disk)
        lid, sole = pad.copy(), rings[0].copy()
        lid[:, 2] += _PAD
        sole[:, 2] += 1.2 * _PAD
        out = np.concatenate([[pad, lid, sole], rings[1:]])
    return out


def _hull_with_disk(foot: Array, center: Array, radius: float) -> Array:
    """Points where rays from the foot's center through its points meet the hull of foot and disk, shape (SIDES, 2)."""
    from scipy.spatial import ConvexHull

    angle = np.arange(24) * (2 * math.pi / 24)
    disk = center + radius * np.column_stack([np.cos(angle), np.sin(angle)])
    equations = ConvexHull(np.concatenate([foot, disk])).equations
    middle = foot.mean(axis=0)
    rays = foot - middle
    toward = rays @ equations[:, :2].T
    room = -(equations[:, :2] @ middle + equations[:, 2])
    reach = np.where(toward > 1e-9, room / np.maximum(toward, 1e-9), np.inf).min(axis=1)
    return np.asarray(middle + rays * reach[:, None])


def _com(rings: Array) -> Array:
    mesh = loft_mesh(rings)
    return mass.mesh(mesh.vertices, mesh.faces).com


def _foot_margin(rings: Array) -> float:
    return hull_margin(rings[0, :, :2], _com(rings)[:2])


def _area(polygon: Array) -> float:
    x, y = polygon.T
    return abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2


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
