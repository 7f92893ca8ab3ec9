"""Segmentation of one tabletop picture into objects, by geometry alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import CaptureError, Frame, Segmentation, SupportSurface, depth_sigma, valid_depth
from simfoundry.capture.segment.merge_by_color import join_kin, split_necks
from simfoundry.capture.segment.merge_regions import (
    TOUCHING,
    compact,
    join_containers,
    join_hanging,
    join_hidden,
    merge_smooth,
    renamed,
)
from simfoundry.capture.segment.regions import Labels, Relief, borders, cut, flood, reach_of, relief_of
from simfoundry.capture.segment.silhouette import close_silhouettes
from simfoundry.capture.segment.support_graph import below, carriers, parts_of, sinking
from simfoundry.geometry.frames import Array

LOWEST = 0.006  # [m] height above the support below which depth noise hides an object
TALLEST = 0.6  # [m] height above the support; tabletop objects are lower
MARGIN = 0.03  # [m] that an object may stick out over the seen outline
EDGE_ZONE = 0.015  # [m] along the outline, in which walls and things behind the support appear
LONG_BORDER = 0.25  # of the picture's shorter side: what takes more of its border is background
BORDER_BAND = 0.025  # of the picture's shorter side
LOW = 0.02  # [m] the highest that an error of the sensor rises
WORKING_REACH = 6.0  # [px] over which edges are judged; finer pictures are reduced to it
FLOATING = 1e-3  # [m²] largest floating region that is stray depth; larger ones are objects that lean or hang
FRAGMENT = 1.2e-3  # [m²] visible area below which an occluded region shows too little of an object
GLIMPSE = 0.3  # of an object's height; if less is visible above its occluder, the object stays unknown
SMALLEST = 4e-4  # [m²] of visible area
MIN_PIXELS = 60  # pixels of an object: 8 x 8, the least that a tangent plane and its edges take


@dataclass(frozen=True, eq=False)
class _Scene:
    """Crop of the picture around the objects on the support; all of shape (h, w, ...) of the ``window``."""

    window: tuple[slice, slice]
    whole: tuple[int, int]
    color: NDArray[np.uint8]
    depth: Array
    K: Array
    points_W: Array
    relief: Relief
    mask: NDArray[np.bool_]
    down: tuple[float, float]


def decompose(frame: Frame, support: SupportSurface) -> Segmentation:
    """Segment the objects on ``support``, numbered from 1, with the support of each.

    Masks of ``frame.instances`` are taken as they are, cleaned, where there are any. Otherwise the surface above the
    support is cut at depth steps and inward creases; outward bends stay within one object. Parts that an object in
    front cuts off are joined again if they lie in one plane, and unsupported parts are joined to the parts they
    touch. Raises :class:`CaptureError` (``no-depth``, ``depth-unit``, ``no-object``).
    """
    depth = np.where(valid_depth(frame.depth), frame.depth, np.nan)
    points_W = support.X_WC.apply(Frame(frame.color, depth, frame.K).points)
    if frame.instances is not None:
        labels = _given(frame.instances, points_W, support)
    else:
        labels = _found(Frame(frame.color, depth, frame.K), points_W, support)
    if not labels.any():
        raise CaptureError(
            "SF504",
            f"nothing stands out more than {LOWEST * 1000:.0f} mm above the support",
            "check that the objects are in view with valid depth; glass and dark gloss often have none",
        )
    parts = parts_of(labels, points_W, depth, frame.K)
    return Segmentation(labels, carriers(parts))


def _given(instances: NDArray[np.int32], points_W: Array, support: SupportSurface) -> Labels:
    """Return the capture's own masks without specks and without objects that are not on the support."""
    import cv2

    on_it = (
        _within(support.outline, points_W[..., :2], MARGIN) & (points_W[..., 2] > -0.02) & (points_W[..., 2] < TALLEST)
    )
    out = np.zeros(instances.shape, np.int32)
    for k in np.unique(instances[instances > 0]):
        mask = instances == k
        measured = mask & np.isfinite(points_W[..., 2])
        if measured.sum() < MIN_PIXELS or on_it[measured].mean() < 0.5:
            continue
        if np.quantile(points_W[..., 2][measured], 0.9) < LOWEST / 2:
            continue
        _, pieces, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
        keep = stats[:, cv2.CC_STAT_AREA] >= max(20, 0.02 * mask.sum())
        keep[0] = False
        out[keep[pieces]] = k
    return compact(out)


def _found(frame: Frame, points_W: Array, support: SupportSurface) -> Labels:
    """Segment at the resolution of the depth noise, then extend the regions to the true silhouettes."""
    depth, K = frame.depth, frame.K
    standing = _standing(depth, points_W, support.outline)
    if not standing.any():
        return np.zeros(depth.shape, np.int32)
    step = max(1, round(reach_of(depth[standing], K) / WORKING_REACH))
    small = np.array(K, dtype=np.float64)
    small[:2] /= step
    coarse = np.zeros(depth[::step, ::step].shape, np.int32)
    scene = _scene(Frame(_averaged(frame.color, step), depth[::step, ::step], small), points_W[::step, ::step], support)
    if scene is not None:
        coarse[scene.window] = _instances(scene, support)
    labels = np.kron(coarse, np.ones((step, step), np.int32))[: depth.shape[0], : depth.shape[1]]
    labels = np.pad(labels, [(0, n - m) for n, m in zip(depth.shape, labels.shape, strict=True)])
    labels = np.where(np.isfinite(depth) & (points_W[..., 2] > LOWEST / 2), labels, 0).astype(np.int32)
    return close_silhouettes(labels, depth, points_W, step + 1)


def _instances(scene: _Scene, support: SupportSurface) -> Labels:
    """Run the passes in order: cut; merge smooth, occluded, same-colored and hanging regions; drop non-objects."""
    reach = scene.relief.reach
    regions = cut(scene.mask, scene.relief)
    regions = merge_smooth(regions, scene.depth, reach, edge=0.5)
    regions = merge_smooth(regions, scene.depth, reach)
    regions = _without_specks(regions, scene)
    regions = join_containers(regions, scene.depth, scene.points_W, reach)
    regions = join_hidden(regions, scene.depth, scene.points_W, reach)
    regions = split_necks(regions, scene.points_W, scene.color, reach)
    regions = join_kin(regions, scene.depth, scene.K, scene.points_W, scene.color, scene.down, reach)
    regions = join_hanging(regions, scene.depth, scene.K, scene.points_W, scene.down, reach)
    regions = _without_specks(regions, scene)
    regions = _without_foreign_regions(regions, scene, support.outline)
    return regions


def _scene(frame: Frame, points_W: Array, support: SupportSurface) -> _Scene | None:
    """Crop to the objects on the support; None if there are none."""
    depth, K = frame.depth, frame.K
    height = points_W[..., 2]
    near = _within(support.outline, points_W[..., :2], MARGIN) & (height > -0.02) & (height < TALLEST)
    high = _standing(depth, points_W, support.outline)
    if high.sum() < MIN_PIXELS:
        return None
    rows, columns = np.nonzero(high.any(axis=1))[0], np.nonzero(high.any(axis=0))[0]
    window = (_padded(rows, depth.shape[0]), _padded(columns, depth.shape[1]))
    inner = np.array(K, dtype=np.float64)
    inner[:2, 2] -= window[1].start, window[0].start
    reach = reach_of(depth[high], K)
    relief = relief_of(np.where(near, depth, np.nan)[window], inner, reach)
    smooth = support.X_WC.apply(relief.points)[..., 2]
    mask = high[window] & (smooth > np.maximum(LOWEST, 1.2 * depth_sigma(depth[window])))
    gravity = support.X_WC.rotation.T @ np.array([0.0, 0.0, -1.0])
    # How the picture moves when a point at the optical axis falls.
    down = gravity[:2] / max(1e-9, float(np.linalg.norm(gravity[:2])))
    return _Scene(
        window,
        depth.shape[:2],
        frame.color[window],
        depth[window],
        inner,
        points_W[window],
        relief,
        mask,
        (float(down[0]), float(down[1])),
    )


def _averaged(color: NDArray[np.uint8], step: int) -> NDArray[np.uint8]:
    """Average the color around every ``step``-th pixel."""
    import cv2

    blurred = cv2.blur(color, (2 * (step // 2) + 1,) * 2)
    return np.ascontiguousarray(blurred[::step, ::step])


def _standing(depth: Array, points_W: Array, outline: Array) -> NDArray[np.bool_]:
    """Pixels clearly above the support."""
    height = points_W[..., 2]
    tall = (height > np.maximum(LOWEST, depth_sigma(depth))) & (height < TALLEST)
    return np.asarray(tall & _within(outline, points_W[..., :2], MARGIN))


def _padded(used: NDArray[np.intp], size: int, pad: int = 16) -> slice:
    return slice(max(0, int(used[0]) - pad), min(size, int(used[-1]) + pad + 1))


def _within(outline: Array, xy: Array, margin: float) -> NDArray[np.bool_]:
    """Mask of world points, shape (..., 2) [m], on the support or up to ``margin`` [m] beside it; False for NaN."""
    import cv2

    cell = 0.005
    corner = outline.min(axis=0) - 2 * abs(margin)
    columns, rows = (np.ceil((np.ptp(outline, axis=0) + 4 * abs(margin)) / cell).astype(int) + 1).tolist()
    plan = cv2.fillPoly(np.zeros((rows, columns), np.uint8), [np.round((outline - corner) / cell).astype(np.int32)], 1)
    size = 2 * round(abs(margin) / cell) + 1
    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    plan = cv2.dilate(plan, disk) if margin > 0 else cv2.erode(plan, disk)
    index = np.round((np.nan_to_num(xy, nan=-1e6) - corner) / cell)
    inside = (index >= 0).all(-1) & (index[..., 0] < columns) & (index[..., 1] < rows)
    index = np.where(inside[..., None], index, 0).astype(int)
    return np.asarray(inside & (plan[index[..., 1], index[..., 0]] > 0))


def _without_specks(labels: Labels, scene: _Scene) -> Labels:
    """Give regions too small to be an object to the region that they touch, or to nothing."""
    pixel_area = scene.depth**2 / (scene.K[0, 0] * scene.K[1, 1])
    count = int(labels.max()) + 1
    pixels = np.bincount(labels.ravel(), minlength=count)
    areas = np.bincount(labels[labels > 0], pixel_area[labels > 0], minlength=count)
    keep = (pixels >= MIN_PIXELS) & (areas >= SMALLEST)
    keep[0] = False
    touching = np.zeros(count, bool)
    for border in borders(labels, scene.depth, scene.relief.reach).values():
        if abs(border.jump) < TOUCHING:
            touching[[border.a, border.b]] = True
    seeds = np.where(keep[labels], labels, 0).astype(np.int32)
    return compact(flood(seeds, (keep | touching)[labels] & (labels > 0), scene.relief.edge))


def _without_foreign_regions(labels: Labels, scene: _Scene, outline: Array) -> Labels:
    """Drop regions that do not stand on the support: a wall at its end, a chair behind it, a lamp above it."""
    parts = parts_of(labels, scene.points_W, scene.depth, scene.K)
    on = carriers(parts)
    hidden = below(labels, scene.depth, scene.down, scene.relief.reach)
    sunk = sinking(labels, scene.points_W, scene.down, scene.relief.reach)
    graph = borders(labels, scene.depth, scene.relief.reach).values()
    behind = {b.a if b.jump > 0 else b.b for b in graph if abs(b.jump) >= TOUCHING}
    touched = {k for b in graph if abs(b.jump) < TOUCHING for k in (b.a, b.b)}
    parent = {}
    for part in parts:
        k = part.label
        beside = _within(outline, part.points_W[:, :2], -EDGE_ZONE).mean() < 0.4
        floats = not part.is_grounded and not on[k]
        glimpsed = floats and part.top - part.bottom < GLIMPSE * part.top
        floats_alone = floats and k not in touched and part.area < FLOATING
        seen_past = floats_alone and part.bottom > 0.05 and hidden[k] < 0.3
        along_border = _on_border(labels == k, scene)
        if (
            (beside and not on[k])
            or seen_past
            or glimpsed
            or (k in behind and part.area < FRAGMENT)
            or along_border > LONG_BORDER
            or (along_border > 0 and floats_alone)
            or sunk[k] > 0.3
            or _is_warp(labels == k, part.top, scene)
        ):
            parent[k] = 0
    # An object whose support was dropped is dropped as well.
    return _without_foreign_regions(renamed(labels, parent), scene, outline) if parent else labels


def _on_border(mask: NDArray[np.bool_], scene: _Scene) -> float:
    """Length of the picture's border that the region covers, as a share of the picture's shorter side."""
    rows, columns = scene.window
    h, w = scene.whole
    band = round(BORDER_BAND * min(h, w))  # sensors often leave the outermost pixels empty
    top, left = band - rows.start, band - columns.start
    bottom, right = h - band - rows.start, w - band - columns.start
    length = int(mask[: max(0, top)].any(axis=0).sum()) + int(mask[max(0, bottom) :].any(axis=0).sum())
    length += int(mask[:, : max(0, left)].any(axis=1).sum()) + int(mask[:, max(0, right) :].any(axis=1).sum())
    return length / min(h, w)


def _is_warp(mask: NDArray[np.bool_], top: float, scene: _Scene) -> bool:
    """Test whether a low region fades into the support without an edge: a sensor error, not an object."""
    import cv2

    if top > LOW:
        return False
    rim = (cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0) & ~mask
    edge = scene.relief.edge[rim & np.isfinite(scene.depth)]
    return len(edge) > 0 and float(np.mean(edge)) < 0.8
