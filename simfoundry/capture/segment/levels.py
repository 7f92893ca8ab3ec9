"""Objects on several level surfaces, such as a table and a lower one beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from simfoundry.capture.frame import Frame, Segmentation, SupportLevel, SupportRival, SupportSurface
from simfoundry.capture.segment.masks import Labels, closed, thinned
from simfoundry.capture.segment.regions import pixel_area
from simfoundry.capture.segment.support_graph import carriers, parts_of
from simfoundry.geometry.frames import Array

CARRIED = 2e-3  # [m²] minimum visible area of what a second surface carries: two small objects of 3 cm
# Distance [m] of a second surface from the first: planes closer to it are through parts of it, so that nothing is lost,
# and a floor is farther below a table, and carries its furniture.
LEVELS = (0.05, 0.4)
OVERHANG = 0.03  # [m] distance by which an object extends past the visible outline of what it stands on
BENEATH = 0.01  # [m] distance below the support at which an object is not on it
SPECKS = 2  # [px] half of the width of gaps in a surface that are noise
SURFACE = 0.5  # minimum share of a region's pixels on a surface that is this surface, in masks of a person


def carries_objects(rival: SupportRival) -> bool:
    """Return True if another surface is beside the support, and carries objects that are not on it."""
    return rival.carried > CARRIED and LEVELS[0] < abs(rival.height) < LEVELS[1]


def has_level(support: SupportSurface, segmentation: Segmentation, rival: SupportRival) -> bool:
    """Return True if the objects that a rival carries are among those of the segmentation."""
    heights = [support.levels[index].height for index in segmentation.surfaces.values()]
    return any(abs(height - rival.height) < LEVELS[0] for height in heights)


def segmentation_on_levels(
    labels: Labels,
    frame: Frame,
    support: SupportSurface,
    pieces: Mapping[str, int],
    unmet: tuple[str, ...],
) -> Segmentation:
    """Return the segmentation in which each level that carries objects is a region, and supports them.

    Args:
        labels: Numbers of the objects from 1, shape (h, w). They may include a surface, as in the masks of a person.
        frame: The image.
        support: The surface that supports the other objects.
        pieces: Numbers of named objects.
        unmet: Constraints that are not respected.
    """
    points_W, area = support.X_WC.apply(frame.points), pixel_area(frame)
    parts = parts_of(labels, points_W, area)
    if not support.levels:
        return Segmentation(labels, carriers(parts), pieces, unmet)
    surfaces = _stated_surfaces(labels, support)
    level_of = {p.label: _level_of(p.points_W, support) for p in parts if p.label not in surfaces}
    supports = carriers([p for p in parts if level_of.get(p.label) == -1]) | dict.fromkeys(surfaces, 0)
    for index, level in enumerate(support.levels):
        own = {k for k, at in level_of.items() if at == index}
        if not own:
            continue
        number = next((k for k, at in surfaces.items() if at == index), 0)
        if not number:
            number = int(labels.max()) + 1
            labels = np.where((labels == 0) & closed(level.inliers, SPECKS), number, labels).astype(np.int32)
        surfaces[number] = index
        supports[number] = 0
        raised = support.at(level).X_WC.apply(frame.points)
        on = carriers([p for p in parts_of(np.where(labels == number, 0, labels), raised, area) if p.label in own])
        supports |= {k: carrier or number for k, carrier in on.items()}
    return Segmentation(labels, dict(sorted(supports.items())), pieces, unmet, surfaces)


def _stated_surfaces(labels: Labels, support: SupportSurface) -> dict[int, int]:
    """Return the regions that are levels of the support, with the index of the level."""
    out = {}
    counts = np.bincount(labels.ravel(), minlength=int(labels.max()) + 1)
    for index, level in enumerate(support.levels):
        within = np.bincount(labels[level.inliers], minlength=len(counts))[1:]
        k = int(np.argmax(within)) + 1 if len(within) else 0
        if k and within[k - 1] > SURFACE * counts[k]:
            out[k] = index
    return out


def _level_of(points_W: Array, support: SupportSurface) -> int:
    """Return the index of the level on which an object stands, or -1 for the support itself."""
    if not len(points_W):
        return -1
    points = thinned(points_W, 500)
    height = float(np.median(points[:, 2]))
    best, most = -1, 0.0 if height < -BENEATH else _share_within(support.outline, points)
    for index, level in enumerate(support.levels):
        share = _share_within(level.outline, points) if height > level.height else 0.0
        if share > most:
            best, most = index, share
    return best


def _share_within(outline: Array, points: Array) -> float:
    """Return the share of points, shape (n, 3), that are above an outline or at most :data:`OVERHANG` beside it."""
    import shapely

    polygon = shapely.Polygon(outline).buffer(OVERHANG)
    return float(shapely.contains_xy(polygon, points[:, 0], points[:, 1]).mean())


def without_support(frame: Frame, labels: Labels, support: SupportSurface, level: SupportLevel) -> Frame:
    """Return the frame without depth at the pixels of the support and of what is known, for finding the rest."""
    known = (labels > 0) | (support.inliers & ~level.inliers)
    instances = None if frame.instances is None else np.where(labels > 0, 0, frame.instances).astype(np.int32)
    return replace(frame, depth=np.where(known, np.nan, frame.depth), instances=instances)
