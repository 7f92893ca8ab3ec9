"""Join parts of one thing that geometry alone sets apart: of one hue, and unable to stand where they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.segment.merge import renamed
from simfoundry.capture.segment.regions import Labels
from simfoundry.capture.segment.stacking import Part, carriers, is_over, parts_of, shared_footprint
from simfoundry.scene.frames import Array

VIVID = 80  # of 255, the saturation from which on a pixel has a hue
BRIGHT = 50  # of 255, likewise
COLOURED = 0.25  # share of vivid pixels of a region that has a hue
SAME_HUE = 8.0  # of 180 in a full turn
NEAR = 0.03  # [m] between parts of one thing
FLUSH = 0.02  # [m] between a lid and the rim it lies in
SLENDER = 0.35  # of the other's visible area: a handle


@dataclass(frozen=True)
class Hue:
    """The commonest hue of a region, of 180 in a full turn, and the share of its pixels that are vivid."""

    hue: float
    vivid: float

    def matches(self, other: Hue) -> bool:
        """Whether both are coloured, and alike."""
        turn = abs(self.hue - other.hue)
        return min(self.vivid, other.vivid) > COLOURED and min(turn, 180 - turn) <= SAME_HUE


def hues_of(labels: Labels, color: NDArray[np.uint8]) -> dict[int, Hue]:
    """The hue of each region 1..n of ``labels``, shape (h, w); ``color`` is RGB, shape (h, w, 3)."""
    import cv2

    hsv = cv2.cvtColor(cv2.GaussianBlur(cv2.medianBlur(color, 5), (0, 0), 2), cv2.COLOR_RGB2HSV)
    vivid = (hsv[..., 1] > VIVID) & (hsv[..., 2] > BRIGHT)
    out = {}
    for k in range(1, int(labels.max()) + 1):
        mask = labels == k
        counts = np.bincount(hsv[..., 0][mask & vivid], minlength=180)
        smooth = np.sum([np.roll(counts, i) for i in range(-5, 6)], axis=0)
        out[k] = Hue(float(np.argmax(smooth)), float((mask & vivid).sum() / max(1, mask.sum())))
    return out


def join_kin(labels: Labels, depth: Array, K: Array, points_W: Array, color: NDArray[np.uint8]) -> Labels:
    """Join what cannot be a thing of its own to the nearest part of its hue: lids, handles, and heavy heads."""
    while True:
        parts = parts_of(labels, points_W, depth, K)
        pair = _first_kin(parts, hues_of(labels, color))
        if pair is None:
            return labels
        labels = renamed(labels, {max(pair): min(pair)})


def _first_kin(parts: list[Part], hues: dict[int, Hue]) -> tuple[int, int] | None:
    """The smallest part that belongs to another, and that other."""
    on = carriers(parts)
    for part in sorted(parts, key=lambda p: (p.area, p.label)):
        if part.is_grounded:
            continue
        kin = [
            (gap, other.label)
            for other in parts
            if other.label != part.label
            and hues[part.label].matches(hues[other.label])
            and (_is_lid(part, other) or _is_handle(part, other) or _would_fall(part, other, on[part.label]))
            and (gap := distance(part, other)) < NEAR
        ]
        if kin:
            return part.label, min(kin)[1]
    return None


def _is_lid(part: Part, other: Part) -> bool:
    """Whether ``part`` lies within the top of ``other``, flush with it."""
    return (
        abs(part.top - other.top) < FLUSH
        and part.bottom > other.bottom + FLUSH
        and part.bottom < other.top
        and shared_footprint(part, other) > 0.5
    )


def _is_handle(part: Part, other: Part) -> bool:
    """Whether ``part`` hangs beside ``other``, which is far larger."""
    return part.area < SLENDER * other.area and other.bottom < part.bottom and part.top < other.top + FLUSH


def _would_fall(part: Part, other: Part, on: int) -> bool:
    """Whether ``part`` begins on top of ``other`` with its middle beside what is right under it."""
    if on != other.label:
        return False
    under = other.points_W[other.points_W[:, 2] > other.top - FLUSH][:, :2]
    lo, hi = np.quantile(part.points_W[:, :2], [0.02, 0.98], axis=0)
    middle = (lo + hi) / 2
    return len(under) > 0 and is_over(middle[None], under) < 0.5


def distance(one: Part, other: Part) -> float:
    """The distance [m] between two parts, but for stray points between them."""
    from scipy.spatial import cKDTree

    tree = cKDTree(one.points_W[:: max(1, len(one.points_W) // 2000)])
    gaps, _ = tree.query(other.points_W[:: max(1, len(other.points_W) // 1000)])
    return float(np.sort(gaps)[min(5, len(gaps) - 1)])
