"""Describe two adjacent regions by the evidence that they are one object or two."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.segment.masks import Mask, grown, solidity, thinned
from simfoundry.capture.segment.regions import Crop, borders
from simfoundry.capture.segment.support_graph import footprint_overlap
from simfoundry.geometry.frames import Array

NEAR_BORDER = 0.015  # [m] distance from the border within which widths are compared: 5 to 10 pixels at 1 m
PAD = 4  # [px] margin of a window around two regions, so that their borders are complete
COUNT = 29  # number of features of a pair
MEETS = 4  # index of the share of the border along which the regions meet


def lab_image(color: NDArray[np.uint8]) -> Array:
    """Return a smoothed image in CIELAB, as an array of shape (h, w, 3), on which distances are perceived ones."""
    import cv2

    smooth = cv2.GaussianBlur(cv2.medianBlur(color, 3), (0, 0), 1.0)
    return np.asarray(cv2.cvtColor(smooth.astype(np.float32) / 255, cv2.COLOR_RGB2LAB))


def pair_features(one: Mask, other: Mask, crop: Crop, lab: Array) -> Array:
    """Return the features of a pair of adjacent regions, shape (COUNT,), which do not depend on their order.

    The features describe the border (length, bend, jump, color contrast, course), the regions (area, color, flatness),
    and the upper region in relation to the lower one (heights, widths at the border, overlap in plan).
    """
    window = _window(one | other)
    local = _cropped(crop, window)
    a, b = one[window], other[window]
    z = local.points_W[..., 2]
    if np.nanmedian(z[a]) < np.nanmedian(z[b]):
        a, b = b, a  # a is the upper region
    reach = max(2, crop.reach // 2)
    near_a, near_b = a & grown(b, times=reach), b & grown(a, times=reach)
    lab = lab[window]
    features: Array = np.array(
        [
            *_border(a, b, near_a, near_b, local),
            *_colors(a, b, near_a, near_b, lab),
            *_heights(a, b, near_a | near_b, local.points_W),
            *_forms(a, b, local),
        ]
    )
    return np.nan_to_num(features, posinf=10.0, neginf=-10.0)


def _window(mask: Mask) -> tuple[slice, slice]:
    rows, columns = np.nonzero(mask.any(axis=1))[0], np.nonzero(mask.any(axis=0))[0]
    return (
        slice(max(0, int(rows[0]) - PAD), int(rows[-1]) + PAD + 1),
        slice(max(0, int(columns[0]) - PAD), int(columns[-1]) + PAD + 1),
    )


def _cropped(crop: Crop, window: tuple[slice, slice]) -> Crop:
    """Return the part of a crop in ``window``."""
    fields = ("color", "depth", "pixel_area", "points_W", "mask", "edge", "step")
    return replace(crop, **{name: getattr(crop, name)[window] for name in fields})


def _border(a: Mask, b: Mask, near_a: Mask, near_b: Mask, crop: Crop) -> list[float]:
    """Return the relative length, bend, jump (positive if the upper region is in front), continuity and edge."""
    labels = np.where(b, 1, 0).astype(np.int32) + np.where(a, 2, 0).astype(np.int32)
    found = borders(labels, crop).get((1, 2))
    near = near_a | near_b
    size = float(np.sqrt(min(a.sum(), b.sum())))
    length = min(near_a.sum(), near_b.sum()) / max(1.0, crop.reach / 2 * size)
    edge, step = (float(np.mean(np.minimum(x[near], 5.0))) if near.any() else 0.0 for x in (crop.edge, crop.step))
    if found is None:
        return [length, 0.0, 0.0, 0.0, 0.0, edge, step]
    return [length, float(np.log1p(found.pairs)), found.bend, found.jump, found.meets, edge, step]


def _colors(a: Mask, b: Mask, near_a: Mask, near_b: Mask, lab: Array) -> list[float]:
    """Return contrasts in lightness and chroma at the border and in total, and the variation within the regions."""

    def contrast(one: Mask, other: Mask) -> tuple[float, float]:
        if not one.any() or not other.any():
            return 0.0, 0.0
        delta = np.median(lab[one], axis=0) - np.median(lab[other], axis=0)
        return abs(float(delta[0])) / 20, float(np.hypot(delta[1], delta[2])) / 20

    spread = [float(np.mean(np.std(lab[m], axis=0))) / 10 for m in (a, b)]
    return [*contrast(near_a, near_b), *contrast(a, b), min(spread), max(spread)]


def _heights(a: Mask, b: Mask, near: Mask, points_W: Array) -> list[float]:
    """Return the heights of both regions [dm], those of the border, and the widths beside it."""
    z = points_W[..., 2]
    (low_a, high_a), (low_b, high_b) = (np.nanquantile(z[m], [0.02, 0.98]) for m in (a, b))
    out = [low_a * 10, high_a * 10, low_b * 10, high_b * 10, (low_a - high_b) * 10]
    border = z[near & np.isfinite(z)]
    level = float(np.median(border)) if len(border) else float(low_a)
    spread = float(np.ptp(np.quantile(border, [0.1, 0.9]))) if len(border) else 0.0
    along = (level - low_b) / max(0.01, float(high_b - low_b))
    beside = (np.abs(z - level - sign * NEAR_BORDER / 2) < NEAR_BORDER for sign in (1, -1))
    widths = [_width(points_W[m & near]) for m, near in zip((a, b), beside, strict=True)]
    whole = [_width(points_W[m]) for m in (a, b)]
    out += [spread * 10, along, widths[0] / max(0.005, widths[1]), whole[0] / max(0.005, whole[1])]
    return [*out, widths[0] / max(0.005, whole[0]), widths[1] / max(0.005, whole[1])]


def _width(points_W: Array) -> float:
    """Return the extent [m] of points across the viewing direction, which is the world's y axis."""
    y = points_W[..., 1].ravel()
    y = y[np.isfinite(y)]
    return float(np.ptp(np.quantile(y, [0.03, 0.97]))) if len(y) > 5 else 0.0


def _forms(a: Mask, b: Mask, crop: Crop) -> list[float]:
    """Return areas, how much of the upper region is over the lower one, and how well each fills its outline."""
    areas = [float(np.nansum(crop.pixel_area[m])) for m in (a, b)]
    shared = footprint_overlap(*(crop.points_W[m & np.isfinite(crop.depth)] for m in (a, b)))
    small, large = sorted(areas)
    flat = [_off_plane(crop.points_W[m]) for m in (a, b, a | b)]
    return [
        float(np.log10(max(1e-5, small))) + 3,
        small / max(1e-6, large),
        shared,
        solidity(a | b) - 0.5 * (solidity(a) + solidity(b)),
        (flat[2] - max(flat[:2])) * 100,
    ]


def _off_plane(points_W: Array) -> float:
    """Return the root mean square distance [m] of points from their best plane."""
    points = thinned(points_W[np.isfinite(points_W[:, 2])], 800)
    if len(points) < 4:
        return 0.0
    centered = points - points.mean(axis=0)
    return float(np.sqrt(max(0.0, np.linalg.eigvalsh(centered.T @ centered)[0] / len(points))))
