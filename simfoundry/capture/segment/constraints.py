"""Apply what a person knows about the objects in an image: what is one piece, what is two, and what is no object."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import Frame, Segmentation
from simfoundry.capture.segment.masks import Labels, Mask
from simfoundry.capture.segment.merge_regions import compact
from simfoundry.capture.segment.regions import edges_of, flood, reach_of
from simfoundry.geometry.frames import Array
from simfoundry.spec.models.capture import Pixel

# Distance [px] from a pixel to the region that it marks: a hand's inaccuracy with a mouse.
NEAR_PX = 8

# Radius [px] around a pixel that surely belongs to the same object.
SEED_PX = 2

# Difference of neighboring colors (0 to 255) that divides objects as clearly as the least certain edge in depth, which
# is 1 in `edges_of`. Sensor noise and textures of one material stay below it.
COLOR_STEP = 24.0

# Margin [px] around a region, so that its edges are not those of the crop.
PAD_PX = 20


def constrained(labels: Labels, frame: Frame) -> tuple[Labels, dict[str, int], tuple[str, ...]]:
    """Apply the constraints of ``frame.decomposition`` to a segmentation.

    Returns:
        The new labels, compact from 1, the numbers of the named pieces, and a sentence for each unmet constraint.
    """
    given = frame.decomposition
    if given is None:
        return labels, {}, ()
    labels, unmet = labels.copy(), []
    found = {name: _regions_at(labels, pixels) for name, pixels in given.pieces.items()}
    for name, regions in found.items():
        if missing := [list(p) for p, k in zip(given.pieces[name], regions, strict=True) if not k]:
            unmet.append(f"{name}: no object was found at the pixels {', '.join(map(str, missing))}")
    numbers = {name: int(labels.max()) + 1 + k for k, name in enumerate(given.pieces)}
    regions_of = {name: set(regions) - {0} for name, regions in found.items()}
    for region in sorted(set().union(*regions_of.values())):
        owners = [name for name, regions in regions_of.items() if region in regions]
        mask = labels == region
        if len(owners) == 1:
            labels[mask] = numbers[owners[0]]
            continue
        seeds = {numbers[n]: [p for p, k in zip(given.pieces[n], found[n], strict=True) if k == region] for n in owners}
        labels[mask] = _divided(frame, mask, seeds)[mask]
    for k in set(_regions_at(labels, given.ignore)) - {0}:
        labels[labels == k] = 0
    before = {name: k for name, k in numbers.items() if (labels == k).any()}
    where = {name: np.unravel_index(np.argmax(labels == k), labels.shape) for name, k in before.items()}
    labels = compact(labels)
    return labels, {name: int(labels[at]) for name, at in where.items()}, tuple(unmet)


def without_occluders(frame: Frame, segmentation: Segmentation, k: int) -> Frame:
    """Return the frame in which the pixels of the objects that occlude object ``k`` have no depth.

    Such pixels are then unknown to its fit, rather than places at which it ends.
    """
    if frame.decomposition is None:
        return frame
    name = next((name for name, number in segmentation.pieces.items() if number == k), None)
    occluders = [a for a, hidden in frame.decomposition.occludes.items() if name in hidden]
    numbers = [segmentation.pieces[a] for a in occluders if a in segmentation.pieces]
    if not numbers:
        return frame
    return replace(frame, depth=np.where(np.isin(segmentation.labels, numbers), np.nan, frame.depth))


def _regions_at(labels: Labels, pixels: tuple[Pixel, ...]) -> list[int]:
    """Return the number of the region at, or nearest to, each pixel, or 0 if none is near."""
    out = []
    for u, v in pixels:
        top, left = max(0, v - NEAR_PX), max(0, u - NEAR_PX)
        window = labels[top : v + NEAR_PX + 1, left : u + NEAR_PX + 1]
        rows, columns = np.nonzero(window)
        distance = (rows + top - v) ** 2 + (columns + left - u) ** 2
        near = len(distance) > 0 and distance.min() <= NEAR_PX**2
        at = int(np.argmin(distance)) if near else 0
        out.append(int(window[rows[at], columns[at]]) if near else 0)
    return out


def _divided(frame: Frame, mask: Mask, seeds: dict[int, list[Pixel]]) -> Labels:
    """Divide a region among objects, along edges in depth and color.

    Args:
        frame: The image.
        mask: The region, shape (h, w).
        seeds: Pixels of each object, by its number.

    Returns:
        The number of the object at each pixel of the region, shape (h, w).
    """
    from scipy import ndimage

    rows, columns = np.nonzero(mask)
    window = tuple(slice(max(0, int(x.min()) - PAD_PX), int(x.max()) + PAD_PX + 1) for x in (rows, columns))
    inside, start = mask[window], np.zeros(mask.shape, np.int32)
    v, u = np.mgrid[: mask.shape[0], : mask.shape[1]]
    for number, pixels in seeds.items():
        for x, y in pixels:
            start[(u - x) ** 2 + (v - y) ** 2 <= SEED_PX**2] = number
    start = start[window]
    grown = flood(np.where(inside, start, 0).astype(np.int32), inside, _edges(frame, window))
    # Parts that no seed reaches, and seeds beside the region, belong to the object with the nearest pixel.
    sources = np.where(grown > 0, grown, start)
    nearest = ndimage.distance_transform_edt(sources == 0, return_distances=False, return_indices=True)
    out = np.zeros(mask.shape, np.int32)
    out[window] = np.where(inside, sources[tuple(nearest)], 0)
    return out


def _edges(frame: Frame, window: tuple[slice, ...]) -> NDArray[np.float64]:
    """Return the strength of the edges in depth and color; 1 is an edge that is as strong as noise."""
    import cv2

    depth: Array = frame.depth[window]
    K = np.array(frame.K)
    K[:2, 2] -= window[1].start, window[0].start
    reach = int(np.clip(round(reach_of(depth[np.isfinite(depth)], K)), 3, 14)) if np.isfinite(depth).any() else 3
    _, edge, _ = edges_of(depth, K, reach)
    color = cv2.GaussianBlur(frame.color[window], (5, 5), 0).astype(np.float64)
    slope = np.hypot(*np.gradient(color, axis=(0, 1))).max(axis=-1)
    strength: Array = np.fmax(np.nan_to_num(edge), slope / COLOR_STEP)
    return strength
