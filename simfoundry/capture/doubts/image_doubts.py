"""Findings about an image and its segmentation, which suggest that the scene will be wrong."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from simfoundry.capture.doubts.color_match import color_doubts
from simfoundry.capture.doubts.depth_faults import depth_faults
from simfoundry.capture.doubts.intrinsics import intrinsics_doubt
from simfoundry.capture.doubts.object_normals import object_normals
from simfoundry.capture.doubts.seams import seam_doubts
from simfoundry.capture.doubts.size_priors import scale_doubt
from simfoundry.capture.findings import BORDER, HOLE, JOINED, MERGED, SUPPORT_DOUBT, UNEXPLAINED, CaptureFinding
from simfoundry.capture.frame import Frame, Segmentation, SupportSurface, depth_sigma
from simfoundry.capture.segment.levels import carries_objects, has_level
from simfoundry.capture.segment.masks import Labels, Mask, closed, components, disk, grown, opened, outline_of, shrunk
from simfoundry.capture.segment.regions import pixel_area
from simfoundry.geometry.frames import Array

RIVAL = 0.5  # minimum evidence for another support that is reported; on real tables it stays below 0.35
ON_TOP, LARGE = 0.3, 0.1  # [m], [m²] maximum height and area of the top of an object on the support
SAME = 0.02  # [m] maximum height of a second plane through the same surface, which is not flat
LITTLE = 0.015  # [m²] minimum visible area of the support: half of the least on real tables, 0.029 of a round one
INSIDE = 0.02  # [m] width of the zone along the outline of the support where walls and its own edge appear
CLEARLY_ABOVE = 0.015  # [m] minimum height of what is no noise of the support; a plate is higher
TALLEST = 0.5  # [m] maximum height of what is reported; lamps and walls are higher
SEEN = 1.0e-3  # [m²] minimum visible area of something that is reported, a square of 3 cm
MOSTLY = 0.7  # minimum share of something that is above the support, or hides it; noise at its outline is elsewhere
HOLE_AREA = 1.2e-3  # [m²] minimum area of a hole on the support, the base of a small glass
HOLE_RADIUS = 0.011  # [m] minimum radius of a disk inside a hole; gaps beside objects are narrower
BASELINE = 0.1  # [m] maximum distance between the camera and a projector or second camera: 7.5 cm in a Kinect
NEARER = 0.02  # [1/m] minimum difference of inverse depths between an object and the support behind it: 1.3 cm at 0.8 m
SHADOW_RIM = 6  # [px] width of the zone beside an object in which a matching window loses depth
BORDER_PX = 3  # [px] distance from the border of the image at which an object is cut off; resampling loses pixels there
BORDER_SHARE = 0.08  # minimum fraction of an object's outline along the border of the image


def image_doubts(frame: Frame, support: SupportSurface, segmentation: Segmentation) -> tuple[CaptureFinding, ...]:
    """Return what is doubtful about an image and its division into objects."""
    return (*depth_faults(frame, support), *segmentation_doubts(frame, support, segmentation))


def segmentation_doubts(
    frame: Frame, support: SupportSurface, segmentation: Segmentation
) -> tuple[CaptureFinding, ...]:
    """Return findings about the division of an image into objects, and those about the image that depend on it."""
    frame = frame.cleaned()
    labels, objects = segmentation.labels, segmentation.objects
    normals = object_normals(frame, objects)
    points_W = support.X_WC.apply(frame.points)
    inside = _inside_outline(frame, support)
    return (
        *_support(support, segmentation),
        *_little_support(frame, support),
        *_unexplained(frame, labels, points_W, support, inside),
        *_unexplained_on_levels(frame, support, segmentation),
        *_holes(frame, support, labels, inside),
        *_cut_off(objects),
        *color_doubts(frame, objects),
        *scale_doubt(frame, support, objects, points_W),
        *intrinsics_doubt(frame, support, normals),
        *seam_doubts(frame, support, objects, normals),
        *_merged(segmentation),
        *_joined(segmentation),
    )


def _support(support: SupportSurface, segmentation: Segmentation) -> Iterator[CaptureFinding]:
    """Yield a finding for each other surface that could be the support, or that carries objects as well."""
    for rival in support.rivals:
        if has_level(support, segmentation, rival):
            continue
        if carries_objects(rival):
            where = f"{abs(rival.height) * 100:.0f} cm {'above' if rival.height > 0 else 'below'} the support"
            message = f"a surface {where} carries objects as well, which are not in the scene"
            hint = f"to reconstruct them, state `support: {{pixel: [{rival.pixel[0]}, {rival.pixel[1]}]}}` in the frame"
            yield CaptureFinding(SUPPORT_DOUBT, message, hint, outline=(rival.pixel,))
            continue
        on_top = 0 < rival.height < ON_TOP and rival.area < LARGE
        if rival.share < RIVAL or on_top or abs(rival.height) < (SAME if rival.area < LARGE else SAME / 2):
            continue
        where = f"{abs(rival.height) * 100:.0f} cm {'above' if rival.height > 0 else 'below'} the chosen one"
        message = f"a surface {where} could be the support as well ({rival.share:.0%} of the evidence)"
        hint = f"state `support: {{pixel: [{rival.pixel[0]}, {rival.pixel[1]}]}}` in the frame to choose it"
        yield CaptureFinding(SUPPORT_DOUBT, message, hint, outline=(rival.pixel,))


def _little_support(frame: Frame, support: SupportSurface) -> Iterator[CaptureFinding]:
    """Yield a finding if so little of the support is visible that it may be the top of an object."""
    area = float(np.nansum(pixel_area(frame)[support.inliers]))
    if area < LITTLE:
        message = f"only {area * 1e4:.0f} cm² of the support is visible, so it may be part of an object"
        hint = "show more of the table, and make sure that it has depth: glass and dark glossy tables often have none"
        yield CaptureFinding(SUPPORT_DOUBT, message, hint)


def _inside_outline(frame: Frame, support: SupportSurface) -> Mask:
    """Return a mask of the pixels whose rays meet the support at least :data:`INSIDE` within its outline."""
    import cv2
    import shapely

    polygon = shapely.Polygon(support.outline).buffer(-INSIDE)
    out = np.zeros(frame.depth.shape, np.uint8)
    X_CW = support.X_WC.inverse()
    for part in getattr(polygon, "geoms", [polygon]):
        if part.is_empty:
            continue
        ring = np.array(shapely.segmentize(part, 0.05).exterior.coords)
        in_camera = X_CW.apply(np.column_stack([ring, np.zeros(len(ring))]))
        depth = np.maximum(in_camera[:, 2:], 0.05)
        pixels = in_camera[:, :2] / depth * [frame.K[0, 0], frame.K[1, 1]] + [frame.K[0, 2], frame.K[1, 2]]
        cv2.fillPoly(out, [np.clip(np.round(pixels), -20000, 20000).astype(np.int32)], 1)
    return out > 0


def _unexplained(
    frame: Frame, labels: Labels, points_W: Array, support: SupportSurface, inside: Mask
) -> Iterator[CaptureFinding]:
    """Yield a finding for everything that stands on the support, or hides it, but belongs to no object."""
    import shapely

    height = points_W[..., 2]
    lowest = np.maximum(CLEARLY_ABOVE, 3 * depth_sigma(frame.depth))
    free = (height > lowest) & (height < TALLEST) & ~grown(labels > 0, times=4)
    area = frame.depth**2 / (frame.K[0, 0] * frame.K[1, 1])
    parts, sizes = components(opened(free, disk(2)))
    surface = shapely.Polygon(support.outline).buffer(-INSIDE)
    rim = _border(labels.shape)
    for k in np.flatnonzero(sizes > 100):
        part = parts == k
        if float(np.nansum(area[part])) < SEEN:
            continue
        xy = points_W[part][:: max(1, int(sizes[k]) // 400), :2]
        size = f"something up to {float(np.nanmax(height[part])) * 100:.0f} cm high"
        hint = "name its pixels under `decomposition`, or show it entirely"
        if shapely.contains_xy(surface, xy).mean() >= MOSTLY:
            message = f"{size} belongs to no object"
            yield CaptureFinding(UNEXPLAINED, message, hint, outline=outline_of(part))
        elif inside[part].mean() >= MOSTLY and (part & rim).any():
            message = f"{size} at the border of the image hides a part of the support and belongs to no object"
            yield CaptureFinding(BORDER, message, hint, outline=outline_of(part))


def _unexplained_on_levels(
    frame: Frame, support: SupportSurface, segmentation: Segmentation
) -> Iterator[CaptureFinding]:
    """Yield a finding for everything that stands on another level but belongs to no object."""
    for index in segmentation.surfaces.values():
        raised = support.at(support.levels[index])
        inside = _inside_outline(frame, raised)
        yield from _unexplained(frame, segmentation.labels, raised.X_WC.apply(frame.points), raised, inside)


def _holes(frame: Frame, support: SupportSurface, labels: Labels, inside: Mask) -> Iterator[CaptureFinding]:
    """Yield a finding for each area on the support at which the sensor returned no depth, as at glass."""
    import cv2

    h, w = frame.depth.shape
    u, v = np.meshgrid(np.arange(w), np.arange(h))
    rays = np.stack([(u - frame.K[0, 2]) / frame.K[0, 0], (v - frame.K[1, 2]) / frame.K[1, 1], np.ones((h, w))], -1)
    falling = rays @ support.X_WC.rotation[2]
    distance = np.where(falling < -0.05, -support.X_WC.p[2] / np.minimum(falling, -0.05), np.inf)
    pixel = distance / np.sqrt(frame.K[0, 0] * frame.K[1, 1])  # width of a pixel on a surface that faces the camera
    missing = inside & ~np.isfinite(frame.depth) & (labels == 0)
    missing &= ~_in_shadow(frame, missing, distance)
    missing = closed(missing, 1) & (labels == 0)
    parts, sizes = components(opened(missing, disk(2)))
    radius = cv2.distanceTransform(missing.astype(np.uint8), cv2.DIST_L2, 3)
    for k in np.flatnonzero(sizes > 60):
        part = parts == k
        width = float(np.median(pixel[part]))
        if float(radius[part].max()) * width < HOLE_RADIUS or sizes[k] * width**2 < HOLE_AREA:
            continue
        message = "the support has a hole in the depth, as glass and reflections leave"
        hint = "if something stands there, add it by hand or make it matt"
        yield CaptureFinding(HOLE, message, hint, outline=outline_of(part))


def _in_shadow(frame: Frame, missing: Mask, distance: Array) -> Mask:
    """Return a mask of the pixels that an object may hide from the projector or the second camera.

    Such a shadow begins beside a nearer surface and continues along the row, at most by the surface's parallax over
    :data:`BASELINE`. ``distance`` is the depth of the support [m].
    """
    nearness = np.nan_to_num(1.0 / frame.depth) - 1.0 / distance
    width = np.where(nearness > NEARER, nearness * float(frame.K[0, 0]) * BASELINE + SHADOW_RIM, 0.0)
    gap = closed(missing, 1)
    out = np.zeros(missing.shape, np.bool_)
    columns = range(missing.shape[1])
    for order in (columns, reversed(columns)):
        left = np.zeros(len(missing))  # how much farther the shadow in each row may continue [px]
        for u in order:
            left = np.where(gap[:, u], left - 1, width[:, u])
            out[:, u] |= gap[:, u] & (left > 0)
    return out & missing


def _merged(segmentation: Segmentation) -> Iterator[CaptureFinding]:
    """Yield a finding for each object that may be several."""
    for k in segmentation.doubted:
        message = f"the object with the number {k} in segments.png may be two that touch"
        hint = "if so, state pixels on each of them under `pieces` in `decomposition`"
        yield CaptureFinding(MERGED, message, hint, outline=outline_of(segmentation.labels == k))


def _joined(segmentation: Segmentation) -> Iterator[CaptureFinding]:
    """Yield a finding for each object of several parts, which may be several objects."""
    for k in segmentation.joined:
        message = f"the object with the number {k} in segments.png may be several: what is between its parts is hidden"
        hint = "if so, state pixels on each of them under `pieces` in `decomposition`"
        yield CaptureFinding(JOINED, message, hint, outline=outline_of(segmentation.labels == k))


def _cut_off(labels: Labels) -> Iterator[CaptureFinding]:
    """Yield a finding for each object that the border of the image cuts off."""
    frame = _border(labels.shape)
    for k in range(1, int(labels.max()) + 1):
        mask = labels == k
        rim = int((mask & ~shrunk(mask, np.ones((3, 3), np.uint8))).sum())
        if (mask & frame).sum() > BORDER_SHARE * BORDER_PX * max(1, rim):
            message = f"the border of the image cuts off the object with the number {k} in segments.png"
            yield CaptureFinding(BORDER, message, "show the entire object", outline=outline_of(mask))


def _border(shape: tuple[int, ...]) -> Mask:
    """Return a mask of the pixels within :data:`BORDER_PX` of the border of an image."""
    out = np.ones(shape, np.bool_)
    out[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = False
    return out
