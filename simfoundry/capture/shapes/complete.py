"""Complete the shapes of objects that are not primitives, using their visible surface and its mirror image.

The solid is a stack of horizontal slices. In each slice, the near side is the visible surface, and the far side is its
mirror image across a vertical plane through the object. The far side does not extend into space that the camera
observed to be free. However, it extends at least as far as the visible surface above it. Each slice is star-shaped
about its center, so the stack is a closed surface without self-intersections.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from simfoundry.assets import mass
from simfoundry.assets.solids import ring_faces
from simfoundry.capture.segment.masks import Mask
from simfoundry.capture.shapes.evidence import Evidence, FitCandidate, binned_percentiles, is_seen_free, smooth_gaps
from simfoundry.capture.shapes.fit_primitives import DEPTH_PRIOR
from simfoundry.capture.shapes.solid_casts import cast_mesh
from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.shapes import Mesh, closed_mesh

LEVELS, SIDES, COLUMNS = 18, 40, 32  # number of slices, and corners and columns per slice: 5 to 10 mm on most objects
FOOT_MARGIN = 0.15  # minimum distance of the center of mass from the edge of the base, as a fraction of its radius
_THINNEST = 0.003  # [m] minimum thickness of a solid: the depth noise at half a meter
_STEPS = 48  # number of free-space samples behind a column; they are 2 to 5 mm apart
_MIN_IN_SLICE = 12  # minimum number of points in a slice for two percentiles to be meaningful
_PAD = 0.0025  # [m] height of the pad under a solid that would tip over


class _Slice(NamedTuple):
    """A horizontal slice at height ``level`` [m].

    ``t`` contains the positions of its columns across the object [m]. ``near`` and ``far`` contain the positions of its
    two sides along the depth axis [m].
    """

    level: float
    t: Array
    near: Array
    far: Array


@dataclass(frozen=True, eq=False)
class _Axes:
    """The axes of the slices, with ``across`` along the width and ``along`` along the depth of the object.

    Both are directions in world xy of shape (2,).
    """

    evidence: Evidence
    across: Array
    along: Array

    @classmethod
    def of(cls, evidence: Evidence) -> _Axes:
        """Return axes that are aligned with the broad side of the object.

        They differ by at most 50 degrees from the axes of the view.
        """
        across = evidence.across
        xy = evidence.points[:, :2] - np.median(evidence.points[:, :2], axis=0)
        values, vectors = np.linalg.eigh(np.cov(xy.T))
        if values[1] > 1.5**2 * values[0]:
            major = vectors[:, 1] * (1.0 if vectors[:, 1] @ across >= 0 else -1.0)
            if major @ across > math.cos(math.radians(50)):
                across = major
        return cls(evidence, across, np.array([across[1], -across[0]]))

    def is_free(self, t: Array, s: Array, level: float) -> Mask:
        """Return a mask of the positions (t, s) [m] at height ``level`` [m] that the camera observed to be free."""
        xy = t[..., None] * self.across + s[..., None] * self.along
        return is_seen_free(self.evidence, np.concatenate([xy, np.full((*s.shape, 1), level)], axis=-1))


def complete(evidence: Evidence) -> FitCandidate:
    """Complete the points in ``evidence`` to form a solid that stands on ``base_z``."""
    axes = _Axes.of(evidence)
    rings = _carve(axes, _smooth(np.array([_ring(axes, one) for one in _slices(axes)])))
    rings = _stabilize(_stand(rings, evidence.base_z))
    origin = np.array([*((rings[0, :, :2].min(axis=0) + rings[0, :, :2].max(axis=0)) / 2), evidence.base_z])
    mesh = loft_mesh(rings - origin)
    return FitCandidate(
        "completed", mesh, Pose.of(origin), evidence.judge(cast_mesh, mesh.vertices + origin, mesh.faces)
    )


def _slices(axes: _Axes) -> list[_Slice]:
    """Return the slices of the solid, ordered from bottom to top."""
    fronts = _fronts(axes)
    slices: list[_Slice] = []
    for front, middle in zip(fronts, _mirror_depths(fronts), strict=True):
        limit = np.maximum(front.far, _free_limit(axes, front))
        mirrored = 2 * middle - np.minimum(front.near, middle)
        own = front._replace(far=np.maximum(np.clip(mirrored, front.far, limit), front.near + _THINNEST))
        slices.append(_extend(axes, own, slices[-1]) if slices else own)
    return slices[::-1]


def _fronts(axes: _Axes) -> list[_Slice]:
    """Return the visible part of each slice, ordered from top to bottom."""
    evidence = axes.evidence
    t, s = evidence.points[:, :2] @ axes.across, evidence.points[:, :2] @ axes.along
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
            far = np.maximum(_envelope(columns, t[above], s[above], 92.0), near)
            fronts.append(_Slice(float(level), columns, near, far))
    if not fronts:
        near, far = (np.full(COLUMNS, np.percentile(s, share)) for share in (2.0, 98.0))
        fronts.append(_Slice(float(evidence.base_z + height / 2), _columns(t), near, far))
    return fronts


def _columns(t: Array) -> Array:
    low, high = np.percentile(t, [1.0, 99.0])
    return np.linspace(low, max(high, low + _THINNEST), COLUMNS)


def _mirror_depths(fronts: list[_Slice]) -> Array:
    """Return the position of the mirror plane in each slice [m].

    The plane is computed from the curvature of the front. Over the inner 85% of its width, an ellipse curves back by
    0.47 of its half depth. A flat front provides no information, so the depth prior for boxes is used instead. Standing
    objects are usually symmetric about a single plane from base to cap. All slices therefore use the median position,
    as far as their widths allow.
    """
    width = np.array([one.t[-1] - one.t[0] for one in fronts])
    front, turned = np.array([np.percentile(one.near, [10.0, 85.0]) for one in fronts]).T
    own = front + np.clip((turned - front) * 2.1, DEPTH_PRIOR / 2 * width, 0.55 * width)
    return np.asarray(front + np.clip(np.median(own) - front, DEPTH_PRIOR / 2 * width, 0.6 * width))


def _envelope(columns: Array, t: Array, s: Array, percentile: float) -> Array:
    """Return a percentile of the depths ``s`` near each column.

    Columns without points are interpolated.
    """
    pitch = max(float(columns[1] - columns[0]), 1e-6)
    index = np.clip(np.round((t - columns[0]) / pitch).astype(int), 0, COLUMNS - 1)
    out = binned_percentiles(index, s, COLUMNS, 2, percentile)
    if not np.isfinite(out).any():
        return np.full(COLUMNS, float(np.percentile(s, percentile)))
    return smooth_gaps(columns, out)


def _free_limit(axes: _Axes, front: _Slice) -> Array:
    """Return the maximum depth of the solid in each column [m] that does not occlude the observed background."""
    steps = np.linspace(0.0, 1.3 * float(front.t[-1] - front.t[0]) + 0.01, _STEPS)
    s = front.near[:, None] + steps
    free = axes.is_free(np.broadcast_to(front.t[:, None], s.shape), s, front.level)
    return np.asarray(front.near + steps[np.where(free.any(axis=1), np.argmax(free, axis=1), _STEPS - 1)])


def _extend(axes: _Axes, own: _Slice, above: _Slice) -> _Slice:
    """Extend a slice to the columns of the slice above it, except columns that overhang observed free space."""
    t, low, high = above.t, own.t[0], own.t[-1]
    held = ~axes.is_free(t, (above.near + above.far) / 2, own.level)
    first = last = int(np.argmin(np.abs(t - (low + high) / 2)))
    while first > 0 and (t[first - 1] >= low or held[first - 1]):
        first -= 1
    while last < len(t) - 1 and (t[last + 1] <= high or held[last + 1]):
        last += 1
    wide = np.linspace(min(low, t[first]), max(high, t[last]), COLUMNS)
    outside = (wide < low) | (wide > high)
    near, far = (
        np.where(outside, np.interp(wide, t, side_above), np.interp(wide, own.t, side))
        for side, side_above in ((own.near, above.near), (own.far, above.far))
    )
    return _Slice(own.level, wide, near, far)


def _ring(axes: _Axes, one: _Slice) -> Array:
    """Return an outline of a slice that is star-shaped about the slice's center, in counterclockwise order.

    Returns:
        Points in the world [m], as an array of shape (SIDES, 3).
    """
    angle = np.arange(SIDES) * (2 * math.pi / SIDES)
    ray = np.column_stack([np.cos(angle), np.sin(angle)])
    t, near, far = one.t, one.near, one.far
    ct = float((t * (far - near)).sum() / (far - near).sum())
    center = np.array([ct, float(np.interp(ct, t, (near + far) / 2))])
    rho = np.linspace(0.0, 1.05 * math.hypot(t[-1] - t[0], far.max() - near.min()) + _THINNEST, 4 * _STEPS)
    tt, ss = center[0] + ray[:, :1] * rho, center[1] + ray[:, 1:] * rho
    inside = (tt >= t[0]) & (tt <= t[-1]) & (ss >= np.interp(tt, t, near)) & (ss <= np.interp(tt, t, far))
    first_out = np.where(inside.all(axis=1), len(rho), np.argmin(inside, axis=1))
    local = center + ray * np.maximum(rho[np.maximum(first_out - 1, 0)], _THINNEST / 2)[:, None]
    xy = local[:, :1] * axes.across + local[:, 1:] * axes.along
    # The axis `along` is a quarter turn clockwise from `across`, so the angle increases clockwise in the world.
    return np.column_stack([xy, np.full(SIDES, one.level)])[::-1]


def _smooth(rings: Array) -> Array:
    """Smooth out noise with a pass around each ring and a pass up the stack."""
    round_ = 0.25 * np.roll(rings, 1, axis=1) + 0.5 * rings + 0.25 * np.roll(rings, -1, axis=1)
    padded = np.concatenate([round_[:1], round_, round_[-1:]])
    out = 0.25 * padded[:-2] + 0.5 * padded[1:-1] + 0.25 * padded[2:]
    out[..., 2] = rings[..., 2]
    return np.asarray(out)


def _carve(axes: _Axes, rings: Array) -> Array:
    """Move every point in observed free space toward the center of its slice until it leaves that space."""
    center = rings[..., :2].mean(axis=1, keepdims=True)
    out = rings.copy()
    share = np.ones(rings.shape[:2])
    for _ in range(8):
        for k, ring in enumerate(out):
            free = axes.is_free(ring[:, :2] @ axes.across, ring[:, :2] @ axes.along, float(ring[0, 2]))
            share[k] -= np.where(free & (share[k] > 0.3), 0.1, 0.0)
        out[..., :2] = center + share[..., None] * (rings[..., :2] - center)
    return out


def _stand(rings: Array, base_z: float) -> Array:
    """Close the stack at the top and the bottom.

    Half a level is added at the top, and the lowest slice is extended straight down to the base.
    """
    pitch = float(rings[1, 0, 2] - rings[0, 0, 2]) if len(rings) > 1 else 2 * float(rings[0, 0, 2] - base_z)
    top, foot = rings[-1:].copy(), rings[:1].copy()
    top[..., 2] += pitch / 2
    foot[..., 2] = base_z
    return np.concatenate([foot, rings, top])


def _stabilize(rings: Array) -> Array:
    """Add a thin pad to a solid that would otherwise tip over.

    The pad is the hull of the solid's base and a disk under its center of mass.
    """
    import shapely

    foot = rings[0, :, :2]
    wanted = max(FOOT_MARGIN * math.sqrt(shapely.Polygon(foot).area / math.pi), 0.003)
    out = rings
    for attempt in range(6):
        mesh = loft_mesh(out)
        center = mass.mesh(mesh.vertices, mesh.faces).com[:2]
        if hull_margin(out[0, :, :2], center) >= wanted:
            break
        pad = rings[0].copy()
        pad[:, :2] = _hull_with_disk(foot, center, (1.5 + 0.5 * attempt) * wanted)
        lid, sole = pad.copy(), rings[0].copy()
        lid[:, 2] += _PAD
        sole[:, 2] += 1.2 * _PAD
        out = np.concatenate([[pad, lid, sole], rings[1:]])
    return out


def _hull_with_disk(foot: Array, center: Array, radius: float) -> Array:
    """Return the convex hull of a base outline and a disk, sampled at the same angles as the outline.

    A ray from the center of the base through a point of the outline meets the hull at the corresponding point of the
    result.

    Returns:
        Array of shape (SIDES, 2).
    """
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


def loft_mesh(rings: Array) -> Mesh:
    """Return a closed mesh through rings of points [m], given as an array of shape (k, sides, 3).

    The rings are ordered from the bottom up, and the points of each ring are counterclockwise when seen from above. The
    mesh is closed with a triangle fan on the first ring and one on the last ring, centered at the mean of the ring.
    These two rings must be star-shaped about their means.
    """
    levels, sides, _ = rings.shape
    top_down = rings[::-1].reshape(-1, 3)
    vertices = np.concatenate([rings[-1].mean(axis=0)[None], top_down, rings[0].mean(axis=0)[None]])
    return closed_mesh(vertices, ring_faces(levels, sides))


def hull_margin(footprint: Array, point: Array) -> float:
    """Return the distance of a point from the boundary of the convex hull of ``footprint`` [m].

    The points of ``footprint`` are xy positions [m] of shape (n, 2). The distance is positive inside the hull and
    negative outside.
    """
    from scipy.spatial import ConvexHull

    equations = ConvexHull(footprint).equations
    return float(-(equations[:, :2] @ point + equations[:, 2]).max())
