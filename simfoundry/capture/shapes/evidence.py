"""Measure how well a solid explains the camera's view of an object, using ray casts (`solid_casts.py`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import Frame, SupportSurface
from simfoundry.capture.segment.masks import Labels, Mask, window_around
from simfoundry.capture.shapes.solid_casts import SolidHits
from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.shapes import Geometry

if TYPE_CHECKING:
    from simfoundry.capture.shapes.fit_handle import FittedHandle

_Distance = TypeVar("_Distance", float, Array)

MAX_RAYS = 2600  # maximum number of rays per object, a grid of 51 x 51; a fit casts them about a thousand times
WINDOW_MARGIN = 0.12  # as a fraction of the object's size in the image; free space beside it is evidence too
FREE_WEIGHT = 0.7  # cost of a free ray that the solid blocks, relative to a miss; silhouettes are off by about a pixel
_BLIND_MISS = 0.4  # cost of an object pixel without depth that the solid misses
_BLIND_HIT = 0.15  # cost of a background pixel without depth that the solid covers; often the projector's shadow
SEEN_PAST = 0.01  # [m] a point is free if the observed surface is at least this far behind it

# Cost advantage over an upright box or cylinder that each family requires to be chosen. The more flexible a family is,
# the less meaningful its lower cost is. A CAD model has no sizes to choose, so it wins all the same if noise makes
# its cost 0.02 higher than that of a box around it.
PRIOR = {
    "box": 0.0,
    "cylinder": 0.0,
    "sphere": 0.02,
    "lying": 0.08,
    "hollow": 0.02,
    "open_box": 0.03,
    "lathe": 0.06,
    "completed": 0.14,
    "leaning": 0.06,
    "tilted": 0.08,
    "tilted_hollow": 0.08,
    "relief": 0.1,
    "mirrored": 0.1,
    "cad": -0.02,
}


@dataclass(frozen=True, eq=False)
class Evidence:
    """The observed points on an object, and the rays through and around it.

    Attributes:
        frame: The RGB-D image.
        support: The surface that supports the objects.
        points: Points of the object in the world frame [m], shape (n, 3), without flying pixels.
        rays: Directions in the world frame, shape (m, 3). ``eye + depth * ray`` is the point at a depth.
        depth: Depth observed along each ray [m], shape (m,). Rays without a reading are NaN.
        inside: Mask of the rays that pass through the object's pixels, shape (m,).
        hidden: Mask of the rays that pass through the pixels of other objects, shape (m,).
        scale: Distance above which a residual no longer counts as noise [m].
        base_z: Height of the surface on which the object stands [m].
    """

    frame: Frame
    support: SupportSurface
    points: Array
    rays: Array
    depth: Array
    inside: Mask
    hidden: Mask
    scale: float
    base_z: float

    @property
    def eye(self) -> Array:
        """The camera center in the world [m], as an array of shape (3,)."""
        return self.support.X_WC.p

    @cached_property
    def view(self) -> Array:
        """The horizontal unit direction from the camera to the object, as an array of shape (2,)."""
        away = np.median(self.points[:, :2], axis=0) - self.eye[:2]
        norm = float(np.linalg.norm(away))
        return away / norm if norm > 1e-6 else np.array([1.0, 0.0])

    @cached_property
    def across(self) -> Array:
        """The horizontal unit direction to the left as seen by the camera, as an array of shape (2,)."""
        return np.array([-self.view[1], self.view[0]])

    @cached_property
    def top(self) -> float:
        """A noise-robust estimate of the height of the object [m].

        This is the median height of the highest 2% of its points, or of its ten highest points if the object has few
        points.
        """
        z = self.points[:, 2]
        count = max(min(10, len(z)), len(z) // 50)
        return float(np.median(np.partition(z, len(z) - count)[len(z) - count :]))

    def judge(self, cast: Callable[..., SolidHits], *solid: object) -> RayAgreement:
        """Compare a solid with the observations.

        The rays are cast against the solid with the function ``cast``.
        """
        return agreement(self, cast(self.eye, self.rays, *solid))

    def cost(self, cast: Callable[..., SolidHits], *solid: object) -> float:
        """Return the cost of a solid alone, in less time than :meth:`judge` takes."""
        return _compared(self, cast(self.eye, self.rays, *solid)).cost

    @cached_property
    def groups(self) -> _RayGroups:
        """The rays by the evidence that they provide."""
        measured = np.isfinite(self.depth)
        beside = ~self.inside
        own, open_rays = np.flatnonzero(self.inside & measured), np.flatnonzero(beside & measured)
        return _RayGroups(
            own=own,
            blind=np.flatnonzero(self.inside & ~measured),
            open=open_rays,
            unlit=np.flatnonzero(beside & ~measured & ~self.hidden),
            inside=max(1, int(self.inside.sum())),
            own_depth=self.depth[own],
            open_depth=self.depth[open_rays],
        )


class _RayGroups(NamedTuple):
    """Indices of rays by what they tell about an object.

    Attributes:
        own: Rays through pixels of the object with depth.
        blind: Rays through pixels of the object without depth.
        open: Rays beside the object, with depth.
        unlit: Rays beside the object, without depth, where no other object is.
        inside: Number of rays through the object, at least 1.
        own_depth: Observed depth along the rays ``own`` [m].
        open_depth: Observed depth along the rays ``open`` [m].
    """

    own: NDArray[np.intp]
    blind: NDArray[np.intp]
    open: NDArray[np.intp]
    unlit: NDArray[np.intp]
    inside: int
    own_depth: Array
    open_depth: Array


def gather(frame: Frame, support: SupportSurface, mask: Mask, base_z: float, labels: Labels | None = None) -> Evidence:
    """Collect the evidence for the object under ``mask``, a bool array of shape (h, w).

    ``labels`` is an int32 array of shape (h, w) that identifies the other objects. Rays that end on them do not count
    as misses.
    """
    window = window_around(mask, 1)
    keep = np.zeros_like(mask)
    keep[window] = mask[window] & np.isfinite(frame.depth[window]) & ~flying_pixels(frame.depth[window])
    distance = float(np.median(frame.depth[keep])) if keep.any() else 1.0
    scale = depth_scale(distance)
    p_W = support.X_WC.apply(frame.points_of(keep))
    connected = main_body(p_W, 0.008 + 0.5 * scale)
    points = p_W[connected & (p_W[:, 2] > base_z - scale)]
    stray = np.zeros_like(mask)
    stray[keep] = ~connected
    mask, keep = mask & ~stray, keep & ~stray
    rows, cols = _ray_grid(mask)
    x, y = (cols - frame.K[0, 2]) / frame.K[0, 0], (rows - frame.K[1, 2]) / frame.K[1, 1]
    rays = np.column_stack([x, y, np.ones(len(rows))]) @ support.X_WC.rotation.T
    depth = np.where(keep | ~mask, frame.depth, np.nan)[rows, cols]
    inside = mask[rows, cols]
    hidden = np.zeros(len(rows), dtype=bool) if labels is None else (labels[rows, cols] > 0) & ~inside
    return Evidence(frame, support, points, rays, depth, inside, hidden, scale, base_z)


def is_seen_free(evidence: Evidence, points: Array) -> Mask:
    """Return a mask of the points in the world [m], shape (..., 3), that the camera observed to be free."""
    frame = evidence.frame
    p_C = evidence.support.X_WC.inverse().apply(points)
    u = np.round(p_C[..., 0] / p_C[..., 2] * frame.K[0, 0] + frame.K[0, 2])
    v = np.round(p_C[..., 1] / p_C[..., 2] * frame.K[1, 1] + frame.K[1, 2])
    h, w = frame.depth.shape
    known = (u >= 0) & (v >= 0) & (u < w) & (v < h)
    observed = frame.depth[np.clip(v, 0, h - 1).astype(int), np.clip(u, 0, w - 1).astype(int)]
    return np.asarray(known & (observed > p_C[..., 2] + SEEN_PAST))


def main_body(points: Array, pitch: float) -> Mask:
    """Return a mask of the points that belong to the object itself.

    Stray background points under the object's mask are excluded. Points are connected through a grid of ``pitch`` [m].
    A connected part is kept if it has at least a tenth as many points as the largest part, so that an object split in
    two by an occluder remains whole.

    Returns:
        Bool array of shape (n,).
    """
    from scipy import ndimage

    if len(points) == 0:
        return np.zeros(0, dtype=bool)
    low = np.percentile(points, 1.0, axis=0) - 0.5
    cell = np.floor((np.clip(points, low, low + 1.5) - low) / pitch).astype(np.int64)
    cell -= cell.min(axis=0)
    grid = np.zeros(cell.max(axis=0) + 1, dtype=bool)
    grid[tuple(cell.T)] = True
    part = ndimage.label(grid, structure=np.ones((3, 3, 3)))[0][tuple(cell.T)]
    count = np.bincount(part)
    return np.asarray(count[part] >= max(1, 0.1 * int(count.max())))


def depth_scale(distance: _Distance) -> _Distance:
    """Return the residual [m] that exceeds the noise of common depth cameras at the given distances [m].

    The residual grows with the square of the distance.
    """
    return 0.005 + 0.004 * distance * distance


def flying_pixels(depth: Array) -> Mask:
    """Return a mask of flying pixels, which are located between a near surface and a far surface.

    A pixel is a flying pixel if fewer than three of its eight neighbors have a similar depth.
    """
    padded = np.pad(depth, 1, constant_values=np.nan)
    h, w = depth.shape
    agreeing = np.zeros((h, w), dtype=np.int32)
    for dv, du in np.ndindex(3, 3):
        if (dv, du) != (1, 1):
            agreeing += np.abs(padded[dv : dv + h, du : du + w] - depth) < 0.012 * depth
    return np.asarray(np.isfinite(depth) & (agreeing < 3))


def binned_medians(bins: NDArray[np.intp], values: Array, count: int, fewest: int) -> Array:
    """Return the median of the values in each of ``count`` bins, or NaN in bins with fewer than ``fewest`` values."""
    ordered, first, number = _sorted_bins(bins, values, count)
    low, high = (ordered[np.minimum(first + half, len(ordered) - 1)] for half in ((number - 1) // 2, number // 2))
    return np.where(number >= fewest, (low + high) / 2, np.nan)


def binned_percentiles(bins: NDArray[np.intp], values: Array, count: int, fewest: int, percent: float) -> Array:
    """Return a percentile of the values in each of ``count`` bins, or NaN in bins with fewer than ``fewest`` values.

    Values between two others are interpolated as by ``numpy.percentile``.
    """
    ordered, first, number = _sorted_bins(bins, values, count)
    place = np.maximum(number - 1, 0) * (percent / 100)
    below = np.floor(place).astype(np.intp)
    share = place - below
    low, high = (ordered[np.minimum(first + at, len(ordered) - 1)] for at in (below, np.ceil(place).astype(np.intp)))
    step = high - low
    between = np.where(share < 0.5, low + step * share, high - step * (1 - share))
    return np.where(number >= fewest, between, np.nan)


def _sorted_bins(bins: NDArray[np.intp], values: Array, count: int) -> tuple[Array, NDArray[np.intp], NDArray[np.intp]]:
    """Return the values sorted by bin and size, and the first index and the number of values of each bin."""
    number = np.bincount(bins, minlength=count)
    if not len(values):
        return np.full(1, np.nan), np.cumsum(number) - number, number
    low, span = values.min(), 2 * np.ptp(values) + 1.0
    order = np.argsort(bins * span + (values - low))  # a sixth of the time of lexsort
    return values[order], np.cumsum(number) - number, number


def smooth_gaps(x: Array, values: Array) -> Array:
    """Interpolate NaN values and apply a three-point median filter.

    Values beyond the ends are extrapolated as constants.
    """
    good = np.isfinite(values)
    filled = np.interp(x, x[good], values[good])
    before, after = np.append(filled[0], filled[:-1]), np.append(filled[1:], filled[-1])
    low, high = np.minimum(before, after), np.maximum(before, after)
    return np.asarray(np.minimum(np.maximum(filled, low), high))  # the median of three


def _ray_grid(mask: Mask) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows and columns of the rays.

    The rays form a regular grid over the bounding window of the mask and a margin around it.
    """
    rows, cols = np.nonzero(mask)
    margin = int(6 + WINDOW_MARGIN * max(np.ptp(rows), np.ptp(cols)))
    top, bottom = max(0, rows.min() - margin), min(mask.shape[0] - 1, rows.max() + margin)
    left, right = max(0, cols.min() - margin), min(mask.shape[1] - 1, cols.max() + margin)
    step = max(1, int(np.ceil(np.sqrt((bottom - top + 1) * (right - left + 1) / MAX_RAYS))))
    grid = np.meshgrid(np.arange(top, bottom + 1, step), np.arange(left, right + 1, step), indexing="ij")
    return grid[0].ravel(), grid[1].ravel()


@dataclass(frozen=True)
class RayAgreement:
    """The agreement between a solid and the observations along the rays.

    Attributes:
        explained: Fraction of the object's measured rays that end within the noise scale of the solid.
        intrusion: Number of rays on which the solid occupies space that was observed to be free, divided by the number
            of rays through the object's pixels.
        fit: Median distance between the observations and the solid [m], over the object's measured rays that hit it.
        cost: Value that a fit minimizes, roughly in [0, 2].
    """

    explained: float
    intrusion: float
    fit: float
    cost: float


def surface_distances(depth: Array, hits: SolidHits) -> Array:
    """Return the distances [m] of the observations at the depths (m,) on rays from a solid that the rays may hit.

    A distance is measured along the normal of the surface. It is infinite if the ray misses the solid, or without a
    depth.
    """
    known = np.isfinite(hits.depth) & np.isfinite(depth)
    gap = np.where(known, hits.depth, 0) - np.where(known, depth, 0)
    return np.where(known, np.abs(gap) * hits.slant, np.inf)


class _Comparison(NamedTuple):
    """Distances [m] of an object's measured rays from a solid, the number of free rays that it blocks, and its cost."""

    distance: Array
    blocked: int
    cost: float


def _compared(evidence: Evidence, hits: SolidHits) -> _Comparison:
    groups, scale = evidence.groups, evidence.scale
    distance = surface_distances(groups.own_depth, SolidHits(hits.depth[groups.own], hits.slant[groups.own]))
    blocked = int(np.count_nonzero(groups.open_depth - hits.depth[groups.open] > 2.0 * scale))
    missed = len(groups.blind) - np.count_nonzero(np.isfinite(hits.depth[groups.blind]))
    covered = np.count_nonzero(np.isfinite(hits.depth[groups.unlit]))
    cost = np.minimum(distance / scale, 1.0).sum() + _BLIND_MISS * missed + _BLIND_HIT * covered
    return _Comparison(distance, blocked, float((cost + FREE_WEIGHT * blocked) / groups.inside))


def agreement(evidence: Evidence, hits: SolidHits) -> RayAgreement:
    """Compare the hits on a solid with the observations."""
    distance, blocked, cost = _compared(evidence, hits)
    fitted = distance[np.isfinite(distance)]
    return RayAgreement(
        explained=float(np.count_nonzero(distance < evidence.scale) / max(1, len(distance))),
        intrusion=float(blocked / evidence.groups.inside),
        fit=_median(fitted) if fitted.size else float("inf"),
        cost=cost,
    )


def _median(values: Array) -> float:
    """Return the median of finite values as ``numpy.median`` does, in a fifth of its time: a fit needs thousands."""
    half = len(values) // 2
    if len(values) % 2:
        return float(np.partition(values, half)[half])
    low, high = np.partition(values, (half - 1, half))[half - 1 : half + 1]
    return float((low + high) / 2)


@dataclass(frozen=True, eq=False)
class FitCandidate:
    """The best solid from one family of shapes.

    The origin of ``X_WO`` is the center of the bounding box for a primitive, or the center of the base (z up) for a
    mesh. For a body of revolution, ``profile`` contains pairs (radius, height) [m], as an array of shape (k, 2).
    ``guessed`` is True if a prior supplied an extent that was not visible. ``model`` is the name of a CAD model.
    ``wall`` [m] is the thickness of the floor and the walls of an open box, and 0 for other solids.
    ``handle`` is that of a body of revolution, whose mesh includes it.
    ``penalty`` is added to the cost for what rays do not show, such as a part below the table.
    """

    family: str
    geometry: Geometry
    X_WO: Pose
    agreement: RayAgreement
    guessed: bool = False
    profile: Array | None = None
    model: str = ""
    penalty: float = 0.0
    wall: float = 0.0
    handle: FittedHandle | None = None

    @property
    def cost(self) -> float:
        """The cost by which candidates are compared."""
        return self.agreement.cost + PRIOR[self.family] + self.penalty
