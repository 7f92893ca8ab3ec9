"""Segment a single tabletop image into objects, based mainly on geometry."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import CaptureError, Frame, Segmentation, SupportSurface, depth_sigma
from simfoundry.capture.frames.reduced import enlarged
from simfoundry.capture.segment import merge_by_color, merge_regions
from simfoundry.capture.segment.constraints import constrained
from simfoundry.capture.segment.hidden_middles import join_parts
from simfoundry.capture.segment.learned_merging import divide_regions, join_regions
from simfoundry.capture.segment.levels import segmentation_on_levels, without_support
from simfoundry.capture.segment.masks import Labels, Mask, Plan, components, disk, grown, shrunk
from simfoundry.capture.segment.merge_regions import TOUCHING, compact, renamed
from simfoundry.capture.segment.open_boxes import part_open_boxes
from simfoundry.capture.segment.regions import Crop, Window, borders, cut, edges_of, flood, pixel_area, reach_of
from simfoundry.capture.segment.silhouette import close_silhouettes
from simfoundry.capture.segment.support_graph import below, carriers, parts_of, sinking
from simfoundry.geometry.frames import Array

LOWEST = 0.006  # [m] minimum height above the support; depth noise hides lower objects
TALLEST = 0.6  # [m] maximum height above the support; tabletop objects are lower
MARGIN = 0.03  # [m] maximum overhang of an object past the visible outline
EDGE_ZONE = 0.015  # [m] width of the zone along the outline where walls and objects behind the support appear
LONG_BORDER = 0.25  # fraction of the image's shorter side; a region that covers more of the border is background
BORDER_BAND = 0.025  # width of the image border, as a fraction of the image's shorter side
LOW = 0.02  # [m] maximum height of a bump caused by sensor error
WORKING_REACH = 6.0  # [px] distance over which edges are evaluated; images with finer detail are downsampled to it
FLOATING = 1e-3  # [m²] maximum area of floating stray depth; larger floating regions are leaning or hanging objects
FRAGMENT = 1.2e-3  # [m²] minimum visible area of an occluded region; smaller ones show too little of an object
STANDING = 6e-4  # [m²] the same for a region that is seen to stand: stray depth at the end of a desk has 5 cm²
BASE_HIDDEN = 0.8  # maximum hidden fraction of the lower edge of a region that is seen to stand
GLIMPSE = 0.3  # minimum fraction of an object's height that must be visible above its occluder
SMALLEST = 4e-4  # [m²] minimum visible area of an object
MIN_PIXELS = 60  # minimum number of pixels of an object: 8 x 8 is enough for a tangent plane and its edges


def decompose(frame: Frame, support: SupportSurface) -> Segmentation:
    """Segment the objects on ``support``, number them from 1, and determine the support of each object.

    If ``frame.instances`` is set, its masks are cleaned and used. Otherwise, the surface above the support is cut at
    depth steps and inward creases. Outward bends do not separate objects. Parts separated by an occluder are joined
    again if they are coplanar or alike, and unsupported parts are joined to the parts that they touch. Finally, the
    constraints in ``frame.decomposition`` are applied.

    Raises:
        CaptureError: The depth is unusable, or no object is found.
    """
    frame = frame.cleaned()
    labels, marks = _on_surface(frame, support)
    for level in support.levels:
        others, more = _on_surface(without_support(frame, labels, support, level), support.at(level))
        marks += more
        labels = np.where(others > 0, others + int(labels.max()), labels).astype(np.int32)
    joins: list[tuple[int, int]] = []
    if frame.instances is None:
        labels, joins = join_parts(labels, frame, support.X_WC.apply(frame.points))
    labels, pieces, unmet = constrained(labels, frame)
    if not labels.any():
        message = f"nothing stands out more than {LOWEST * 1000:.0f} mm above the support"
        hint = "check that the objects are in view and have valid depth; glass and dark glossy surfaces often have none"
        raise CaptureError("SF504", message, hint)
    doubted, joined = (sorted({int(labels[mark]) for mark in each} - {0, *pieces.values()}) for each in (marks, joins))
    found = segmentation_on_levels(labels, frame, support, pieces, unmet)
    return replace(found, doubted=tuple(doubted), joined=tuple(joined))


def _on_surface(frame: Frame, support: SupportSurface) -> tuple[Labels, list[tuple[int, int]]]:
    """Return the objects on a surface, numbered from 1: those of the given masks, or those that are found.

    Returns:
        The labels, and a pixel (row, column) in each object that may be several.
    """
    points_W = support.X_WC.apply(frame.points)
    if frame.instances is not None:
        return _given(frame.instances, points_W, support), []
    return _found(frame, points_W, support)


def _given(instances: NDArray[np.int32], points_W: Array, support: SupportSurface) -> Labels:
    """Return the masks from the capture. Specks and objects that are not on the support are removed."""
    on_it, height = _near(points_W, support), points_W[..., 2]
    out = np.zeros(instances.shape, np.int32)
    for k in np.unique(instances[instances > 0]):
        mask = instances == k
        measured = mask & np.isfinite(height)
        if measured.sum() < MIN_PIXELS or on_it[measured].mean() < 0.5:
            continue
        if np.quantile(height[measured], 0.9) < LOWEST / 2:
            continue
        pieces, areas = components(mask, connectivity=8)
        out[(areas >= max(20, 0.02 * mask.sum()))[pieces]] = k
    return compact(out)


def _found(frame: Frame, points_W: Array, support: SupportSurface) -> tuple[Labels, list[tuple[int, int]]]:
    """Segment the image at the resolution of the depth noise, then extend the regions to the actual silhouettes.

    Returns:
        The labels, and a pixel (row, column) in each object that may be several.
    """
    depth = frame.depth
    survey = survey_regions(frame, points_W, support)
    if survey is None:
        return np.zeros(depth.shape, np.int32), []
    step, crop = survey.step, survey.crop
    coarse = np.zeros(depth[::step, ::step].shape, np.int32)
    regions, doubted = divide_regions(survey.regions, survey.initial, crop)
    marks = [_middle(regions == k, crop.window, step) for k in doubted]
    regions, floors = part_open_boxes(join_regions(merged_by_rules(regions, crop), crop), crop)
    regions = _without_specks(regions, crop)
    coarse[crop.window] = _without_foreign_regions(regions, crop, support)
    labels = enlarged(coarse, step, depth.shape)
    low = np.zeros(coarse.shape, np.int32)
    low[crop.window] = floors
    standing = (points_W[..., 2] > LOWEST / 2) | (enlarged(low, step, depth.shape) > 0)
    labels = np.where(np.isfinite(depth) & standing, labels, 0).astype(np.int32)
    return close_silhouettes(labels, depth, points_W, step + 1), marks


def _middle(mask: Mask, window: Window, step: int) -> tuple[int, int]:
    """Return the pixel (row, column) of the whole image that is farthest inside of a region of a reduced window."""
    import cv2

    inside = cv2.distanceTransform(np.pad(mask, 1).astype(np.uint8), cv2.DIST_L2, 3)
    row, column = np.unravel_index(int(np.argmax(inside)), inside.shape)
    return (window[0].start + int(row) - 1) * step, (window[1].start + int(column) - 1) * step


def initial_regions(frame: Frame, points_W: Array, support: SupportSurface) -> Labels:
    """Return the smooth regions of an image before most merging, from 1, and 0 elsewhere, shape (h, w)."""
    survey = survey_regions(frame, points_W, support)
    if survey is None:
        return np.zeros(frame.depth.shape, np.int32)
    coarse = np.zeros(frame.depth[:: survey.step, :: survey.step].shape, np.int32)
    coarse[survey.crop.window] = survey.initial
    return enlarged(coarse, survey.step, frame.depth.shape)


def merged_by_rules(regions: Labels, crop: Crop) -> Labels:
    """Merge and split regions by the rules that need no network: rims, occluded boxes, hues, hanging parts."""
    for stage in (
        *(merge_regions.join_containers, merge_regions.join_hidden, merge_by_color.split_necks),
        *(merge_by_color.join_kin, merge_regions.join_hanging),
    ):
        regions = stage(regions, crop)
    return regions


@dataclass(frozen=True, eq=False)
class RegionSurvey:
    """The regions of an image before the network judges them.

    ``step`` is the factor by which the image of ``crop`` is smaller than the original. ``initial`` are the regions
    before most merging.
    """

    step: int
    crop: Crop
    initial: Labels
    regions: Labels


def survey_regions(frame: Frame, points_W: Array, support: SupportSurface) -> RegionSurvey | None:
    """Cut the surface above the support into regions, and merge those that meet smoothly.

    The result is None if nothing stands on the support.
    """
    depth = frame.depth
    standing = standing_mask(depth, points_W, support)
    if not standing.any():
        return None
    step = max(1, round(reach_of(depth[standing], frame.K) / WORKING_REACH))
    K = np.array(frame.K, dtype=np.float64)
    K[:2] /= step
    crop = _crop(Frame(_averaged(frame.color, step), depth[::step, ::step], K), points_W[::step, ::step], support)
    if crop is None:
        return None
    initial = merge_regions.merge_smooth(cut(crop), crop, edge=0.5)
    regions = _without_specks(merge_regions.merge_smooth(initial, crop), crop)
    return RegionSurvey(step, crop, initial, regions)


def _crop(frame: Frame, points_W: Array, support: SupportSurface) -> Crop | None:
    """Crop the image to the objects on the support, or return None if there are no objects."""
    high = standing_mask(frame.depth, points_W, support)
    if high.sum() < MIN_PIXELS:
        return None
    window = _padded(high), _padded(high.T)
    K = np.array(frame.K, dtype=np.float64)
    K[:2, 2] -= window[1].start, window[0].start
    reach = int(np.clip(round(reach_of(frame.depth[high], K)), 3, 14))
    depth = frame.depth[window]
    smooth, edge, step = edges_of(np.where(_near(points_W, support)[window], depth, np.nan), K, reach)
    lowest = np.maximum(LOWEST, 1.2 * depth_sigma(depth))
    gravity = support.X_WC.rotation.T @ np.array([0.0, 0.0, -1.0])
    down = gravity[:2] / max(1e-9, float(np.linalg.norm(gravity[:2])))
    return Crop(
        window=window,
        whole=frame.depth.shape,
        color=frame.color[window],
        depth=depth,
        pixel_area=pixel_area(frame)[window],
        points_W=points_W[window],
        mask=high[window] & (support.X_WC.apply(smooth)[..., 2] > lowest),
        edge=edge,
        step=step,
        reach=reach,
        down=(float(down[0]), float(down[1])),
    )


def _averaged(color: NDArray[np.uint8], step: int) -> NDArray[np.uint8]:
    """Downsample a color image by ``step``, averaging the color around each pixel."""
    import cv2

    blurred = cv2.blur(color, (2 * (step // 2) + 1,) * 2)
    return np.ascontiguousarray(blurred[::step, ::step])


def _near(points_W: Array, support: SupportSurface) -> Mask:
    """Return a mask of the pixels on the support or at most :data:`TALLEST` above it."""
    height = points_W[..., 2]
    return is_within(support, points_W[..., :2], MARGIN) & (height > -0.02) & (height < TALLEST)


def standing_mask(depth: Array, points_W: Array, support: SupportSurface) -> Mask:
    """Return a mask of the pixels that are clearly above the support."""
    return _near(points_W, support) & (points_W[..., 2] > np.maximum(LOWEST, depth_sigma(depth)))


def _padded(mask: Mask, pad: int = 16) -> slice:
    """Return the slice from the first to the last row with a marked pixel.

    The slice is extended by ``pad`` [px] on both sides.
    """
    rows = np.nonzero(mask)[0]
    return slice(max(0, int(rows.min()) - pad), min(len(mask), int(rows.max()) + pad + 1))


def is_within(support: SupportSurface, xy: Array, margin: float) -> Mask:
    """Return a mask of the points inside the support outline.

    Args:
        support: The support.
        xy: World points [m], shape (..., 2). NaN points are never inside.
        margin: Distance by which the outline is grown, or shrunk if negative [m].
    """
    import cv2

    cell, outline = 0.005, support.outline
    corner = outline.min(axis=0) - 2 * abs(margin)
    columns, rows = (np.ceil((np.ptp(outline, axis=0) + 4 * abs(margin)) / cell).astype(int) + 1).tolist()
    polygon = np.round((outline - corner) / cell).astype(np.int32)
    inside = cv2.fillPoly(np.zeros((rows, columns), np.uint8), [polygon], 1) > 0
    kernel = disk(round(abs(margin) / cell))
    return Plan(grown(inside, kernel) if margin > 0 else shrunk(inside, kernel), corner, cell).contains(xy)


def _without_specks(labels: Labels, crop: Crop) -> Labels:
    """Remove regions that are too small to be objects.

    Such a region is merged into the region that it touches, if there is one.
    """
    count = int(labels.max()) + 1
    pixels = np.bincount(labels.ravel(), minlength=count)
    areas = np.bincount(labels[labels > 0], crop.pixel_area[labels > 0], minlength=count)
    keep = (pixels >= MIN_PIXELS) & (areas >= SMALLEST)
    keep[0] = False
    touching = np.zeros(count, bool)
    for border in borders(labels, crop).values():
        if abs(border.jump) < TOUCHING:
            touching[[border.a, border.b]] = True
    seeds = np.where(keep[labels], labels, 0).astype(np.int32)
    return compact(flood(seeds, (keep | touching)[labels] & (labels > 0), crop.edge))


def _without_foreign_regions(labels: Labels, crop: Crop, support: SupportSurface) -> Labels:
    """Drop regions that are not on the support.

    Examples are a wall at its end, a chair behind it, and a lamp above it.
    """
    parts = parts_of(labels, crop.points_W, crop.pixel_area)
    on, hidden, sunk = carriers(parts), below(labels, crop), sinking(labels, crop)
    graph = borders(labels, crop).values()
    behind = {b.a if b.jump > 0 else b.b for b in graph if abs(b.jump) >= TOUCHING}
    touched = {k for b in graph if abs(b.jump) < TOUCHING for k in (b.a, b.b)}
    foreign = {}
    for part in parts:
        k = part.label
        beside = is_within(support, part.points_W[:, :2], -EDGE_ZONE).mean() < 0.4
        floats = not part.is_grounded and not on[k]
        glimpsed = floats and part.top - part.bottom < GLIMPSE * part.top
        floats_alone = floats and k not in touched and part.area < FLOATING
        seen_past = floats_alone and part.bottom > 0.05 and hidden[k] < 0.3
        along_border = _on_border(labels == k, crop)
        stands = part.is_grounded and hidden[k] < BASE_HIDDEN
        if (
            (beside and not on[k])
            or seen_past
            or glimpsed
            or (k in behind and part.area < (STANDING if stands else FRAGMENT))
            or along_border > LONG_BORDER
            or (along_border > 0 and floats_alone)
            or sunk[k] > 0.3
            or _is_warp(labels == k, part.top, crop)
        ):
            foreign[k] = 0
    # An object whose support was dropped is dropped as well.
    return _without_foreign_regions(renamed(labels, foreign), crop, support) if foreign else labels


def _on_border(mask: Mask, crop: Crop) -> float:
    """Return the length of the image border that a region covers, as a fraction of the image's shorter side."""
    band = round(BORDER_BAND * min(crop.whole))  # sensors often leave the outermost pixels empty
    length = 0
    for side, size, window in zip((mask, mask.T), crop.whole, crop.window, strict=True):
        first, last = max(0, band - window.start), max(0, size - band - window.start)
        length += int(side[:first].any(axis=0).sum()) + int(side[last:].any(axis=0).sum())
    return length / min(crop.whole)


def _is_warp(mask: Mask, top: float, crop: Crop) -> bool:
    """Return True if a low region fades into the support without an edge.

    This indicates a sensor error.
    """
    if top > LOW:
        return False
    edge = crop.edge[grown(mask) & ~mask & np.isfinite(crop.depth)]
    return len(edge) > 0 and float(np.mean(edge)) < 0.8
