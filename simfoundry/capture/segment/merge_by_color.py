"""Merge parts of the same object, and split regions that contain two objects, on the basis of color."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.segment.masks import (
    Labels,
    Mask,
    components,
    disk,
    grown,
    hull_mm,
    opened,
    solidity,
    thinned,
)
from simfoundry.capture.segment.merge_regions import compact, renamed
from simfoundry.capture.segment.regions import Border, Crop, adjacent_pairs, borders, flood
from simfoundry.capture.segment.support_graph import RegionPart, below, carriers, is_content, parts_of, shared_footprint

VIVID = 80  # minimum saturation of a vivid pixel, out of 255
BRIGHT = 50  # minimum value of a vivid pixel, out of 255
COLORED = 0.25  # minimum fraction of vivid pixels in a region that has a hue
SAME_HUE = 8.0  # maximum difference between matching hues, on a color wheel of 180
VIVID_THROUGHOUT = 0.6  # minimum fraction of vivid pixels in a region that is colored throughout
ONE_HUE = 4.0  # maximum difference between equal hues, on a color wheel of 180
SEEN_UNDER = 0.8  # maximum hidden fraction of a lower edge; the rest shows that nothing else supports the part
NEAR = 0.03  # [m] maximum gap between parts of the same object
FLUSH = 0.02  # [m] maximum height difference between a lid and the rim around it
CAP = 0.2  # maximum area of a cap, as a fraction of the other part's visible area
SLENDER = 0.35  # maximum area of a handle, as a fraction of the other part's visible area
HOLLOW = 0.7  # maximum fraction of its convex hull that a region made of two objects fills
SHARE = 0.25  # minimum fraction of a region that each of its two objects covers
NECK = 1.2  # maximum width of a neck, divided by the square root of the smaller object's area
FOOT = 0.02  # [m] both objects must reach below this height above the support


def hue_and_vivid(color: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], Mask]:
    """Return the smoothed hue of an RGB image and a mask of its vivid pixels.

    Vivid pixels are neither gray nor dark. Hue values range from 0 to 180, where 180 is a full circle.
    """
    import cv2

    smooth = cv2.GaussianBlur(cv2.medianBlur(color, 5), (0, 0), 2)
    hue, saturation, value = cv2.split(cv2.cvtColor(smooth, cv2.COLOR_RGB2HSV))
    return np.asarray(hue, dtype=np.uint8), np.asarray((saturation > VIVID) & (value > BRIGHT))


@dataclass(frozen=True)
class Hue:
    """The most common hue in a region, from 0 to 180, and the fraction of its pixels that are vivid."""

    hue: float
    vivid: float

    def equals(self, other: Hue) -> bool:
        """Return True if both regions have the same color throughout."""
        return self.matches(other) and min(self.vivid, other.vivid) > VIVID_THROUGHOUT and self.apart(other) <= ONE_HUE

    def apart(self, other: Hue) -> float:
        """Return the difference between the two hues around the color wheel, which is between 0 and 90."""
        turn = abs(self.hue - other.hue)
        return min(turn, 180 - turn)

    def matches(self, other: Hue) -> bool:
        """Return True if both regions are colored and have similar hues."""
        return min(self.vivid, other.vivid) > COLORED and self.apart(other) <= SAME_HUE

    @classmethod
    def of(cls, mask: Mask, hue: NDArray[np.uint8], vivid: Mask) -> Hue:
        """Return the hue of the region that ``mask`` covers."""
        counts = np.bincount(hue[mask & vivid], minlength=180)
        smooth = np.sum([np.roll(counts, i) for i in range(-5, 6)], axis=0)
        return cls(float(np.argmax(smooth)), float((mask & vivid).sum() / max(1, mask.sum())))


@dataclass(frozen=True, eq=False)
class _Family:
    """The evidence that two parts may belong to the same object.

    It consists of hues, supports, hidden lower edges, and borders.
    """

    hues: dict[int, Hue]
    on: dict[int, int]
    hidden: dict[int, float]
    graph: dict[tuple[int, int], Border]
    adjacent: frozenset[tuple[int, int]]

    def are_one(self, part: RegionPart, other: RegionPart) -> bool:
        """Return True if ``part`` belongs to ``other``.

        The part is either a cap behind missing depth or has the same hue as the other part.
        """
        meet = (min(part.label, other.label), max(part.label, other.label)) in self.adjacent
        if self.on[part.label] == other.label and part.area < CAP * other.area and not meet:
            return not is_content(part, other)
        a, b = self.hues[part.label], self.hues[other.label]
        if not a.matches(b):
            return False
        if part.is_grounded:
            return a.equals(b) and _is_end(part, other, self.graph)
        joins = _is_lid(part, other) or _is_handle(part, other)
        if not joins and self.on[part.label] == other.label and self.hidden[part.label] < SEEN_UNDER:
            joins = _is_head(part, other)
        return joins and _distance(part, other) < NEAR


def join_kin(labels: Labels, crop: Crop) -> Labels:
    """Merge lids, handles, heads and feet with the nearest part that has the same hue."""
    hue, vivid = hue_and_vivid(crop.color)
    while True:
        parts = parts_of(labels, crop.points_W, crop.pixel_area)
        hues = {p.label: Hue.of(labels == p.label, hue, vivid) for p in parts}
        family = _Family(hues, carriers(parts), below(labels, crop), borders(labels, crop), adjacent_pairs(labels))
        pair = _first_kin(parts, family)
        if pair is None:
            return labels
        labels = renamed(labels, {max(pair): min(pair)})


def _first_kin(parts: list[RegionPart], family: _Family) -> tuple[int, int] | None:
    """Return the label of the smallest part that belongs to another part, and the label of that other part."""
    for part in sorted(parts, key=lambda p: (p.area, p.label)):
        kin = [other for other in parts if other.label != part.label and family.are_one(part, other)]
        if kin:
            return part.label, min(kin, key=lambda other: (_distance(part, other), other.label)).label
    return None


def _is_lid(part: RegionPart, other: RegionPart) -> bool:
    """Return True if ``part`` is inside the top of ``other`` and flush with that top."""
    flush = abs(part.top - other.top) < FLUSH and other.bottom + FLUSH < part.bottom < other.top
    return flush and shared_footprint(part, other) > 0.5


def _is_handle(part: RegionPart, other: RegionPart) -> bool:
    """Return True if ``part`` hangs beside a much larger ``other``."""
    return part.area < SLENDER * other.area and other.bottom < part.bottom and part.top < other.top + FLUSH


def _is_head(part: RegionPart, other: RegionPart) -> bool:
    """Return True if ``other`` narrows to a neck right below ``part``."""
    import cv2

    neck = hull_mm(other.points_W[other.points_W[:, 2] > other.top - FLUSH])
    return float(cv2.contourArea(neck)) < SLENDER * float(cv2.contourArea(hull_mm(part.points_W)))


def _is_end(part: RegionPart, other: RegionPart, graph: dict[tuple[int, int], Border]) -> bool:
    """Return True if ``part`` continues the surface of ``other``, which is equally high and much larger."""
    low, high = sorted((part.label, other.label))
    border = graph.get((low, high))
    continuous = border is not None and border.meets > 0.5
    return continuous and part.area < SLENDER * other.area and abs(part.top - other.top) < FLUSH


def _distance(one: RegionPart, other: RegionPart) -> float:
    """Return the distance [m] between two parts, ignoring stray points between them."""
    from scipy.spatial import cKDTree

    gaps, _ = cKDTree(thinned(one.points_W, 2000)).query(thinned(other.points_W, 1000))
    return float(np.sort(gaps)[min(5, len(gaps) - 1)])


def split_necks(labels: Labels, crop: Crop) -> Labels:
    """Split clearly non-convex regions at necks between a vivid half and a dull half that both stand on the support.

    Color alone is not a reason to split an object, since bottles have caps and boxes have prints. However, a color
    border at a neck of the outline separates two objects if both halves reach the support.
    """
    _, vivid = hue_and_vivid(crop.color)
    kernel = disk(max(1, crop.reach // 4))
    out = labels.copy()
    for k in range(1, int(labels.max()) + 1):
        mask = labels == k
        if solidity(mask) > HOLLOW:
            continue
        bright, dull = (_largest(opened(mask & tone, kernel)) for tone in (vivid, ~vivid))
        large = min(bright.sum(), dull.sum()) >= SHARE * mask.sum()
        height = crop.points_W[..., 2]
        stand = large and all(np.nanquantile(height[half], 0.02) < FOOT for half in (bright, dull))
        if stand and _neck(bright, dull, crop.reach) < NECK:
            seeds = np.where(bright, 1, np.where(dull, 2, 0)).astype(np.int32)
            parted = flood(seeds, mask, np.zeros(mask.shape))
            out[mask] = np.where(parted[mask] == 2, int(out.max()) + 1, k)
    return compact(out)


def _neck(one: Mask, other: Mask, reach: int) -> float:
    """Return the width of the neck between two masks, divided by the square root of the smaller mask's area.

    The result is infinite if the masks do not meet.
    """
    gap = max(2, reach // 2)
    width = float((grown(one, disk(gap)) & other).sum()) / gap
    return width / float(np.sqrt(min(one.sum(), other.sum()))) if width >= gap else np.inf


def _largest(mask: Mask) -> Mask:
    parts, areas = components(mask, connectivity=8)
    return np.asarray((parts == int(np.argmax(areas))) & mask)
