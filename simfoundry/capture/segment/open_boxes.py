"""Find boxes without a lid by the rectangle of their rim, and divide them from what is in them.

The walls of such a box are separate surfaces in the image, its floor may be as low as the noise of the table, and what
touches a wall merges with it. Seen from above, however, all walls are thin and lie along one rectangle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simfoundry.capture.frame import depth_sigma
from simfoundry.capture.segment.masks import Labels, Mask, Plan, components, disk, grown, opened, thinned
from simfoundry.capture.segment.merge_regions import compact
from simfoundry.capture.segment.regions import Crop, adjacent_pairs
from simfoundry.geometry.frames import Array

CELL = 0.004  # [m] cell of the plan in which walls are thin: a pixel covers 2 to 3 mm at 1 m
THICK = 0.012  # [m] half of the width from which a part of a plan is no wall: noise adds some millimeters to a wall
NEAR_WALL = 0.01  # [m] maximum distance of a point on a wall from the rectangle, beside the noise
SIDES = (0.07, 0.6)  # [m] minimum and maximum side of a box: smaller ones have no thin walls at the noise of sensors
HIGHEST_FLOOR = 0.02  # [m] maximum height of a floor; a box that stands on another object is left as it is
SHALLOWEST = 0.01  # [m] minimum depth of a cavity; the edge of a tray is 2 cm high
FLOOR = 0.006  # [m] height above which a point belongs to a wall, beside the noise: floors are 2 to 8 mm thick
FOLLOWS = 0.8  # minimum share of the thin parts of walls that lie along the rectangle
COVERED, SIDE_COVERED = 0.7, 0.2  # minimum shares of the rim, and of each side, that are seen: contents hide the rest
# Maximum distance of points on a wall from a corner, as a share of half of the shorter side: a circle is 0.41 away.
CORNER = 0.2
STEPS = 40  # intervals along a side in which points are looked for
TURNS = 60  # directions between 0 and 90 degrees that are tried: 1.5 degrees are 3 mm along half of a side of 20 cm
WALL_POINTS = 30  # minimum number of thin points of a region that has walls
MOST = 4  # maximum number of boxes in an image
LARGEST = 40  # maximum number of regions; more are noise or texture
BAND = 0.015  # [m] maximum distance in height from the rim of the points by which it is seen
LEVEL = 0.01  # [m] maximum distance of the top of a side from that of the rim, for three of the sides
OPEN = 0.2  # minimum share of the visible interior that is below the rim; contents may rise above it
LOWEST_SHARE = 0.15  # share of the visible interior that is at most as high as the floor; contents hide the rest
CONTENT = 4e-4  # [m²] minimum visible area of something in a box, as of any object
CONTENT_PIXELS = 25  # minimum number of its pixels, at the resolution of edges


@dataclass(frozen=True, eq=False)
class RimRectangle:
    """The rim of a box without a lid: a rectangle in the world.

    ``center`` [m] has shape (2,), ``axes`` are its unit sides, shape (2, 2), by row, and ``half`` [m] half of their
    lengths. ``top`` [m] is the height of the rim, and ``floor`` [m] that of what is beneath the contents.
    """

    center: Array
    axes: Array
    half: Array
    top: float = 0.0
    floor: float = 0.0

    def beyond(self, points_W: Array) -> Array:
        """Return the signed distance [m] of points from the rectangle in plan, negative inside, shape (...)."""
        apart = np.abs((points_W[..., :2] - self.center) @ self.axes.T) - self.half
        outside = np.linalg.norm(np.maximum(apart, 0.0), axis=-1)
        return np.asarray(outside + np.minimum(apart.max(axis=-1), 0.0))

    def overlaps(self, other: RimRectangle) -> bool:
        """Return True if the center of one of two rectangles is inside the other one."""
        return bool(self.beyond(other.center) < 0 or other.beyond(self.center) < 0)


def part_open_boxes(labels: Labels, crop: Crop) -> tuple[Labels, Mask]:
    """Join the walls and floors of boxes without a lid, and divide them from what is in them.

    Returns:
        The labels from 1, and a mask of the floors that were added, which may be as low as the support.
    """
    floors = np.zeros(labels.shape, np.bool_)
    rims: list[RimRectangle] = []
    while len(rims) < MOST and (rim := find_rim(labels, crop, rims)) is not None:
        rims.append(rim)
        parted, box = _parted(labels, crop, rim)
        floors |= (parted == box) & (labels == 0)
        labels = parted
    return labels, floors & (labels > 0)


def find_rim(labels: Labels, crop: Crop, known: Sequence[RimRectangle] = ()) -> RimRectangle | None:
    """Return the rim of the largest box without a lid, beside those that are known, or None."""
    count = int(labels.max())
    if not 0 < count <= LARGEST:
        return None
    raised = np.isfinite(crop.depth) & (crop.points_W[..., 2] > FLOOR + 2 * depth_sigma(crop.depth))
    walls = {k: _thin_points((labels == k) & raised, crop) for k in range(1, count + 1)}
    walls = {k: thin for k, thin in walls.items() if len(thin) >= WALL_POINTS}
    pairs = {(k, k) for k in walls} | {(a, b) for a, b in adjacent_pairs(labels) if a in walls and b in walls}
    thin = np.concatenate([thinned(p, 400) for p in walls.values()]) if walls else np.zeros((0, 3))
    every = crop.points_W[raised & (labels > 0)]
    slack = NEAR_WALL + float(np.nanmedian(depth_sigma(crop.depth[labels > 0])))
    best, most = None, 0.0
    for a, b in sorted(pairs):
        own = thinned(walls[a] if a == b else np.concatenate([walls[a], walls[b]]), 300)
        rim = _rectangle(own, slack)
        if rim is None:
            continue
        rim = _checked(_rectangle(thin[np.abs(rim.beyond(thin)) < 1.5 * slack], slack) or rim, every, slack)
        size = 0.0 if rim is None else float(np.prod(rim.half))
        if rim is not None and size > most and not any(rim.overlaps(other) for other in known):
            judged = _opened_upward(rim, crop, slack)
            best, most = (judged, size) if judged is not None else (best, most)
    return best


def _thin_points(mask: Mask, crop: Crop) -> Array:
    """Return the points [m] of a region that are in narrow parts of its plan, shape (n, 3)."""
    points = crop.points_W[mask]
    if len(points) < WALL_POINTS:
        return points[:0]
    corner = points[:, :2].min(axis=0) - 2 * THICK
    cells = np.round((points[:, :2] - corner) / CELL).astype(int)
    size = cells.max(axis=0) + 1 + round(2 * THICK / CELL)
    if size.max() > 400:  # farther than any box
        return points[:0]
    plan = np.zeros((size[1], size[0]), np.bool_)
    plan[cells[:, 1], cells[:, 0]] = True
    plan = grown(plan)  # pixels farther apart than a cell
    thick = grown(opened(plan, disk(round(THICK / CELL) + 1)))
    return points[~Plan(thick, corner, CELL).contains(points[:, :2])]


def _rectangle(points: Array, slack: float) -> RimRectangle | None:
    """Return the rectangle around points whose sides they follow best, or None if they do not follow any."""
    if len(points) < WALL_POINTS:
        return None
    turns = np.linspace(0.0, np.pi / 2, TURNS, endpoint=False)
    axes = np.stack([np.cos(turns), np.sin(turns), -np.sin(turns), np.cos(turns)], axis=1).reshape(-1, 2, 2)
    along = points[:, :2] @ axes.transpose(0, 2, 1)  # (turns, points, 2)
    ordered = np.sort(along, axis=1)
    spare = len(points) // 100  # stray points at both ends
    low, high = ordered[:, spare], ordered[:, -1 - spare]
    half = (high - low) / 2
    apart = np.abs(along - ((low + high) / 2)[:, None]) - half[:, None]
    outside = np.linalg.norm(np.maximum(apart, 0.0), axis=2)
    beyond = np.abs(outside + np.minimum(apart.max(axis=2), 0.0))
    # Among directions that are followed equally well, the sides of the smaller rectangle are closer.
    share = (beyond < slack).mean(axis=1) - 0.2 * beyond.mean(axis=1)
    share[(half.min(axis=1) * 2 < SIDES[0]) | (half.max(axis=1) * 2 > SIDES[1])] = 0.0
    best = int(np.argmax(share))
    if share[best] < FOLLOWS:
        return None
    return RimRectangle((low + high)[best] / 2 @ axes[best], axes[best], half[best])


def _checked(rim: RimRectangle, points: Array, slack: float) -> RimRectangle | None:
    """Return the rectangle with the height of its rim, or None if walls do not surround it at one height."""
    near = points[np.abs(rim.beyond(points)) < slack]
    if len(near) < WALL_POINTS:
        return None
    along = (near[:, :2] - rim.center) @ rim.axes.T
    sides = [np.abs(sign * along[:, k] - rim.half[k]) < slack for k in (0, 1) for sign in (1.0, -1.0)]
    if not all(side.any() for side in sides):
        return None
    tops = [float(np.quantile(near[side, 2], 0.85)) for side in sides]
    top = float(np.median(tops))
    if sum(abs(each - top) < LEVEL for each in tops) < 3:  # a content may rise beside one of the sides
        return None
    at_rim = np.abs(near[:, 2] - top) < BAND
    seen = []
    for side, k in zip(sides, (1, 1, 0, 0), strict=True):
        where = (along[side & at_rim, k] / rim.half[k] + 1) / 2 * STEPS
        seen.append(len(np.unique(np.clip(where.astype(int), 0, STEPS - 1))) / STEPS)
    if min(seen) < SIDE_COVERED or float(np.average(seen, weights=rim.half[[1, 1, 0, 0]])) < COVERED:
        return None
    corners = rim.center + np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]]) * rim.half @ rim.axes
    gaps = np.linalg.norm(near[at_rim, None, :2] - corners, axis=2).min(axis=0)
    if (gaps < CORNER * rim.half.min()).sum() < 3:
        return None
    return RimRectangle(rim.center, rim.axes, rim.half, top)


def _opened_upward(rim: RimRectangle, crop: Crop, slack: float) -> RimRectangle | None:
    """Return the rim with the height of its floor, or None if what it surrounds is not below it."""
    inside = rim.beyond(np.nan_to_num(crop.points_W, nan=1e3)) < -1.5 * slack
    inside &= crop.points_W[..., 2] > -slack  # what is seen below the table may be beneath the box
    heights = crop.points_W[..., 2][inside]
    if len(heights) < WALL_POINTS:
        return None
    floor = float(np.quantile(heights, LOWEST_SHARE))
    below = float(np.mean(crop.points_W[..., 2][inside] < rim.top - SHALLOWEST))
    if floor > HIGHEST_FLOOR or rim.top - floor < SHALLOWEST or below < OPEN:
        return None
    return RimRectangle(rim.center, rim.axes, rim.half, rim.top, floor)


def _parted(labels: Labels, crop: Crop, rim: RimRectangle) -> tuple[Labels, int]:
    """Return the labels in which the box is one region, and its number."""
    sigma = depth_sigma(crop.depth)
    points, height = np.nan_to_num(crop.points_W, nan=1e3), np.nan_to_num(crop.points_W[..., 2], nan=1e3)
    beyond = rim.beyond(points)
    wall = (np.abs(beyond) < NEAR_WALL + sigma) & (height < rim.top + 0.004 + 2 * sigma)
    low = (beyond < 0) & (height < rim.floor + 0.006 + 2 * sigma)
    wall, low = wall & (height > -2 * sigma), low & (height > -2 * sigma)
    box = wall & (labels > 0) | low
    new = int(labels.max()) + 1
    out = labels.copy()
    for k in np.unique(labels[box & (labels > 0)]):
        region = labels == k
        own, other = region & box, region & ~box
        if not _is_object(other, crop):
            out[region if own.sum() > other.sum() else own] = new  # the rest is noise at a wall
        elif own.sum() > other.sum() or (np.median(beyond[other]) < 0 and _is_object(own, crop)):
            out[own] = new
        # Else it is an object that touches a wall.
    out[low & (labels == 0) & np.isfinite(crop.depth)] = new
    return _renumbered(out, new)


def _is_object(mask: Mask, crop: Crop) -> bool:
    """Return True if the largest connected part of a mask is large enough for an object."""
    parts, areas = components(mask, connectivity=8)
    if areas.max(initial=0) < CONTENT_PIXELS:
        return False
    return float(crop.pixel_area[parts == int(np.argmax(areas))].sum()) >= CONTENT


def _renumbered(labels: Labels, box: int) -> tuple[Labels, int]:
    """Number the labels from 1, and return the number of the box."""
    at = np.argmax((labels == box).ravel())
    out = compact(labels)
    return out, int(out.ravel()[at])
