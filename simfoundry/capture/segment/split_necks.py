"""Splitting of two touching objects at a neck, if one is colored and the other is gray."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.segment.merge_by_color import vivid_of
from simfoundry.capture.segment.merge_regions import compact
from simfoundry.capture.segment.regions import Labels, flood
from simfoundry.geometry.frames import Array

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
