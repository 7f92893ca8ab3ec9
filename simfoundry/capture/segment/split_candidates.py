"""Propose divisions of a region into two: at a level, along colors, and along the creases that merging ignored."""

from __future__ import annotations

import numpy as np

from simfoundry.capture.segment.masks import Labels, Mask, components
from simfoundry.capture.segment.regions import Crop, flood
from simfoundry.geometry.frames import Array

SHARE = 0.1  # minimum fraction of a region in each half; smaller halves are caps, handles and prints
LEVELS = 24  # number of heights at which a region is tried
STRIP = 0.012  # [m] height of the strips above and below a level whose widths and colors are compared
PROPOSALS = 3  # number of levels that are judged, best first


def split_candidates(mask: Mask, crop: Crop, lab: Array, initial: Labels) -> list[tuple[Mask, Mask]]:
    """Return pairs of masks that divide a region.

    ``initial`` are the regions before most merging, whose creases a region may contain.
    """
    found = [mask & (crop.points_W[..., 2] > level) for level in _levels(mask, crop.points_W, lab)]
    found += _by_color(mask, lab)
    inside = np.unique(initial[mask & (initial > 0)])
    if 1 < len(inside) <= 12:
        found += [mask & (initial == k) for k in inside]
    window = _window(mask)
    halves = [_halves(one[window], mask[window]) for one in found]
    return [(_placed(a, window, mask), _placed(b, window, mask)) for a, b in (pair for pair in halves if pair)]


def _window(mask: Mask) -> tuple[slice, slice]:
    """Return the rows and columns that a mask covers: what is outside of them need not be flooded."""
    rows, columns = np.nonzero(mask.any(axis=1))[0], np.nonzero(mask.any(axis=0))[0]
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def _placed(part: Mask, window: tuple[slice, slice], whole: Mask) -> Mask:
    out = np.zeros_like(whole)
    out[window] = part
    return out


def _halves(one: Mask, mask: Mask) -> tuple[Mask, Mask] | None:
    """Return the two connected halves of ``mask`` that ``one`` suggests, or None if one of them is small."""
    cores = []
    for half in (one, mask & ~one):
        parts, areas = components(half, connectivity=8)
        if areas.max(initial=0) < SHARE * mask.sum():
            return None
        cores.append(parts == int(np.argmax(areas)))
    seeds = np.where(cores[0], 1, np.where(cores[1], 2, 0)).astype(np.int32)
    parted = flood(seeds, mask, np.zeros(mask.shape))
    return parted == 1, parted == 2


def _levels(mask: Mask, points_W: Array, lab: Array) -> list[float]:
    """Return the heights at which the width or the color of a region changes most."""
    z = points_W[..., 2]
    inside = mask & np.isfinite(z)
    heights, y, colors = z[inside], points_W[inside][:, 1], lab[inside]
    low, high = np.quantile(heights, [0.02, 0.98])
    if high - low < 3 * STRIP:
        return []
    scores = []
    for level in np.linspace(low + STRIP, high - STRIP, LEVELS):
        above, below = ((heights > level) & (heights < level + STRIP), (heights < level) & (heights > level - STRIP))
        if min(above.sum(), below.sum()) < 10:
            continue
        widths = [float(np.ptp(np.quantile(y[m], [0.03, 0.97]))) for m in (above, below)]
        tone = float(np.linalg.norm(np.median(colors[above], axis=0) - np.median(colors[below], axis=0)))
        scores.append((abs(np.log(max(widths[0], 0.003) / max(widths[1], 0.003))) + tone / 20, float(level)))
    best: list[float] = []
    for score, level in sorted(scores, reverse=True):
        if score > 0.25 and len(best) < PROPOSALS and all(abs(level - other) > 2 * STRIP for other in best):
            best.append(level)
    return best


def _by_color(mask: Mask, lab: Array) -> list[Mask]:
    """Return a division of a region into its two most common colors, if they differ."""
    import cv2

    samples = lab[mask].astype(np.float32)
    if len(samples) < 100:
        return []
    order = np.argsort(samples @ np.linalg.svd(samples[::7] - samples.mean(axis=0), full_matrices=False)[2][0])
    start = np.zeros((len(samples), 1), np.int32)
    start[order[len(order) // 2 :]] = 1
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 10, 0.5)
    _, kinds, centers = cv2.kmeans(samples, 2, start, criteria, 1, cv2.KMEANS_USE_INITIAL_LABELS)
    if float(np.linalg.norm(centers[0] - centers[1])) < 12:
        return []
    one = np.zeros(mask.shape, np.uint8)
    one[mask] = kinds[:, 0]
    return [np.asarray(cv2.medianBlur(one, 5) > 0) & mask]
