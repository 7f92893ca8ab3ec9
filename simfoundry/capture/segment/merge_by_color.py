"""Merging of parts of one object that geometry alone separates: of one hue, and unable to stand where they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.segment.merge_regions import compact, renamed
from simfoundry.capture.segment.regions import Border, Labels, borders, flood
from simfoundry.capture.segment.support_graph import (
    RegionPart,
    below,
    carriers,
    footprint_hull,
    parts_of,
    shared_footprint,
)
from simfoundry.geometry.frames import Array

VIVID = 80  # of 255, the saturation from which on a pixel has a hue
BRIGHT = 50  # of 255, likewise
COLORED = 0.25  # share of vivid pixels of a region that has a hue
SAME_HUE = 8.0  # of 180 in a full turn
VIVID_THROUGHOUT = 0.6  # share of vivid pixels of a region that has hardly anything else
ONE_HUE = 4.0  # of 180 in a full turn
SEEN_UNDER = 0.8  # share of a lower edge that may be hidden; the rest shows that nothing else supports the part
NEAR = 0.03  # [m] largest gap between parts of one object
FLUSH = 0.02  # [m] between a lid and the rim it lies in
CAP = 0.2  # of the other's visible area
SLENDER = 0.35  # of the other's visible area: a handle


@dataclass(frozen=True)
class Hue:
    """Most common hue of a region, of 180 in a full turn, and the share of its pixels that are vivid."""

    hue: float
    vivid: float

    def equals(self, other: Hue) -> bool:
        """Return whether both are of one color throughout."""
        return self.matches(other) and min(self.vivid, other.vivid) > VIVID_THROUGHOUT and self.apart(other) <= ONE_HUE

    def apart(self, other: Hue) -> float:
        """The angle between both hues, of 180 in a full turn."""
        turn = abs(self.hue - other.hue)
        return min(turn, 180 - turn)

    def matches(self, other: Hue) -> bool:
        """Return whether both are colored, and alike."""
        return min(self.vivid, other.vivid) > COLORED and self.apart(other) <= SAME_HUE


def hues_of(labels: Labels, color: NDArray[np.uint8]) -> dict[int, Hue]:
    """Return the hue of each region 1..n of ``labels``, shape (h, w); ``color`` is RGB, shape (h, w, 3)."""
    hue, vivid = _smooth_hsv(color)[..., 0], vivid_of(color)
    out = {}
    for k in range(1, int(labels.max()) + 1):
        mask = labels == k
        counts = np.bincount(hue[mask & vivid], minlength=180)
        smooth = np.sum([np.roll(counts, i) for i in range(-5, 6)], axis=0)
        out[k] = Hue(float(np.argmax(smooth)), float((mask & vivid).sum() / max(1, mask.sum())))
    return out


def vivid_of(color: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Pixels, shape (h, w), that have a hue: neither gray nor dark."""
    hsv = _smooth_hsv(color)
    return np.asarray((hsv[..., 1] > VIVID) & (hsv[..., 2] > BRIGHT))


def _smooth_hsv(color: NDArray[np.uint8]) -> NDArray[np.uint8]:
    import cv2

    smooth = cv2.GaussianBlur(cv2.medianBlur(color, 5), (0, 0), 2)
    return np.asarray(cv2.cvtColor(smooth, cv2.COLOR_RGB2HSV), dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class _Family:
    """Evidence for and against being one object: parts, hues, supports, hidden lower edges, and borders."""

    hues: dict[int, Hue]
    on: dict[int, int]
    hidden: dict[int, float]
    graph: dict[tuple[int, int], Border]
    adjacent: frozenset[tuple[int, int]]

    def are_one(self, part: RegionPart, other: RegionPart) -> bool:
        """Return whether ``part`` belongs to ``other``: it is a cap that lost readings cut off, or else of its hue."""
        meet = (min(part.label, other.label), max(part.label, other.label)) in self.adjacent
        if self.on[part.label] == other.label and part.area < CAP * other.area and not meet:
            return True
        a, b = self.hues[part.label], self.hues[other.label]
        if not a.matches(b):
            return False
        if part.is_grounded:
            return a.equals(b) and _is_end(part, other, self.graph)
        return (
            _is_lid(part, other)
            or _is_handle(part, other)
            or (self.on[part.label] == other.label and self.hidden[part.label] < SEEN_UNDER and _is_head(part, other))
        ) and distance(part, other) < NEAR


def join_kin(
    labels: Labels,
    depth: Array,
    K: Array,
    points_W: Array,
    color: NDArray[np.uint8],
    down: tuple[float, float],
    reach: int,
) -> Labels:
    """Merge lids, handles, heads and feet with the nearest part of their hue."""
    while True:
        parts = parts_of(labels, points_W, depth, K)
        hidden, graph = below(labels, depth, down, reach), borders(labels, depth, reach)
        family = _Family(hues_of(labels, color), carriers(parts), hidden, graph, adjacent_pairs(labels))
        pair = _first_kin(parts, family)
        if pair is None:
            return labels
        labels = renamed(labels, {max(pair): min(pair)})


def _first_kin(parts: list[RegionPart], family: _Family) -> tuple[int, int] | None:
    """Return the smallest part that belongs to another, and that other part."""
    for part in sorted(parts, key=lambda p: (p.area, p.label)):
        kin = [other for other in parts if other.label != part.label and family.are_one(part, other)]
        if kin:
            return part.label, min(kin, key=lambda other: (distance(part, other), other.label)).label
    return None


def adjacent_pairs(labels: Labels) -> frozenset[tuple[int, int]]:
    """Return the pairs (low, high) of adjacent regions."""
    sides = ((labels[:-1], labels[1:]), (labels[:, :-1], labels[:, 1:]))
    pairs = np.concatenate([np.stack([a[a != b], b[a != b]], axis=1) for a, b in sides])
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    return frozenset((int(a), int(b)) for a, b in pairs if a > 0)


def _is_lid(part: RegionPart, other: RegionPart) -> bool:
    """Test whether ``part`` lies within the top of ``other``, flush with it."""
    return (
        abs(part.top - other.top) < FLUSH
        and part.bottom > other.bottom + FLUSH
        and part.bottom < other.top
        and shared_footprint(part, other) > 0.5
    )


def _is_handle(part: RegionPart, other: RegionPart) -> bool:
    """Test whether ``part`` hangs beside ``other``, which is far larger."""
    return part.area < SLENDER * other.area and other.bottom < part.bottom and part.top < other.top + FLUSH


def _is_head(part: RegionPart, other: RegionPart) -> bool:
    """Test whether only a neck lies right under ``part``."""
    import cv2

    neck = footprint_hull(other.points_W[other.points_W[:, 2] > other.top - FLUSH])
    return float(cv2.contourArea(neck)) < SLENDER * float(cv2.contourArea(footprint_hull(part.points_W)))


def _is_end(part: RegionPart, other: RegionPart, graph: dict[tuple[int, int], Border]) -> bool:
    """Test whether ``part`` goes on from ``other``, far larger and as high, where the two meet."""
    low, high = sorted((part.label, other.label))
    border = graph.get((low, high))
    return (
        border is not None
        and border.meets > 0.5
        and part.area < SLENDER * other.area
        and abs(part.top - other.top) < FLUSH
    )


def distance(one: RegionPart, other: RegionPart) -> float:
    """Distance [m] between two parts, ignoring stray points between them."""
    from scipy.spatial import cKDTree

    tree = cKDTree(one.points_W[:: max(1, len(one.points_W) // 2000)])
    gaps, _ = tree.query(other.points_W[:: max(1, len(other.points_W) // 1000)])
    return float(np.sort(gaps)[min(5, len(gaps) - 1)])


HOLLOW = 0.7  # share of its convex hull that a region of two things fills at most
SHARE = 0.25  # of the region that each thing covers at least
NECK = 1.2  # width of the neck, over the square root of the smaller thing's area
FOOT = 0.02  # [m] above the support, below which both things reach
Mask = NDArray[np.bool_]


def split_necks(labels: Labels, points_W: Array, color: NDArray[np.uint8], reach: int) -> Labels:
    """Split regions that are far from convex where a vivid and a dull half, both standing, meet at a neck.

    Color alone is no reason to split an object: a bottle has a cap, a box a print. But a color border at a neck of the
    outline, with both halves reaching the support, runs between two objects.
    """
    vivid = vivid_of(color)
    out = labels.copy()
    for k in range(1, int(labels.max()) + 1):
        mask = labels == k
        if _solidity(mask) > HOLLOW:
            continue
        bright, dull = (_largest(_opened(mask & tone, max(1, reach // 4))) for tone in (vivid, ~vivid))
        both_stand = _stands(bright, mask, points_W) and _stands(dull, mask, points_W)
        if both_stand and _neck(bright, dull, reach) < NECK:
            seeds = np.where(bright, 1, np.where(dull, 2, 0)).astype(np.int32)
            parted = flood(seeds, mask, np.zeros(mask.shape))
            out[mask] = np.where(parted[mask] == 2, int(out.max()) + 1, k)
    return compact(out)


def _stands(half: Mask, whole: Mask, points_W: Array) -> bool:
    if half.sum() < SHARE * whole.sum():
        return False
    return bool(np.nanquantile(points_W[..., 2][half], 0.02) < FOOT)


def _neck(one: Mask, other: Mask, reach: int) -> float:
    """Width [px] at which two masks meet, over the square root of the smaller one's area; infinite if they do not."""
    import cv2

    gap = max(2, reach // 2)
    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * gap + 1, 2 * gap + 1))
    shared = (cv2.dilate(one.astype(np.uint8), disk) > 0) & other
    width = float(shared.sum()) / gap
    return width / float(np.sqrt(min(one.sum(), other.sum()))) if width >= gap else np.inf


def _solidity(mask: Mask) -> float:
    import cv2

    hull = cv2.convexHull(np.argwhere(mask)[:, ::-1].astype(np.int32))
    return float(mask.sum()) / max(1.0, float(cv2.contourArea(hull)))


def _opened(mask: Mask, radius: int) -> Mask:
    import cv2

    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    return np.asarray(cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, disk) > 0)


def _largest(mask: Mask) -> Mask:
    import cv2

    _, parts, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    areas = stats[:, cv2.CC_STAT_AREA].copy()
    areas[0] = 0
    return np.asarray((parts == int(np.argmax(areas))) & mask)
