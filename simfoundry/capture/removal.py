"""Take objects away from an image, those in front first, and fill in what stands behind them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from simfoundry.capture.description.support_object import filled_colors
from simfoundry.capture.frame import Frame, Segmentation, SupportSurface, depth_sigma
from simfoundry.capture.segment.masks import SQUARE, Labels, Mask, closed, disk, grown, shrunk
from simfoundry.capture.shapes.fit import FittedShape
from simfoundry.capture.shapes.solid_casts import cast_mesh
from simfoundry.geometry.frames import Array
from simfoundry.geometry.shapes import tessellate

# Distances [px] at which pixels of two objects are compared; the depth between them is often missing in a band of 5 px.
STEPS_PX = (1, 4, 8)

# Least difference in depth [m], beside noise, by which one object is in front of another, and the least number of pairs
# of pixels that show it.
NEARER, PAIRS_MIN = 0.01, 10

# Distance [m] by which something is in front of a solid, and hides it from another camera; poses are off by 1 to 2 cm.
OCCLUDED = 0.04

# Width [px] of the rim around removed objects that is filled in as well, because colors mix there.
RIM_PX = 3

# Longer side [px] of the image in which the colors of the ground are blurred; they have no detail in any case.
BLURRED_PX = 320

# Width [px] of the band beside an object in which pixels without depth are filled in, too: the shadow of a sensor.
SHADOW_PX = 12


@dataclass(frozen=True, eq=False)
class ClearedImage:
    """An image without some of its objects.

    Attributes:
        removed: Numbers of the objects that are removed.
        hole: Pixels that are filled in, shape (h, w).
        shown: Number of the object at each pixel, shape (h, w), with the pixels that the removed objects hid.
        color: RGB image, shape (h, w, 3).
        depth: Depth [m], shape (h, w); NaN where nothing was measured.
    """

    removed: tuple[int, ...]
    hole: Mask
    shown: Labels
    color: np.ndarray
    depth: Array


def removal_order(frame: Frame, segmentation: Segmentation) -> tuple[tuple[int, ...], ...]:
    """Return the numbers of objects in the order in which they are removed.

    Each layer contains objects that are in front of no others of the same layer, and that neither stand behind nor
    under an object of a later layer. If objects hide each other in a circle, the nearest is removed first. Levels of
    the support remain.
    """
    numbers = [int(k) for k in np.unique(segmentation.objects) if k > 0]
    in_front = _in_front(frame, segmentation.labels)
    before = {k: {a for a, b in in_front if b == k} for k in numbers}
    for k, carrier in segmentation.supports.items():
        if carrier in before:
            before[carrier].add(k)
    distance = {k: _median_depth(frame.depth[segmentation.labels == k]) for k in numbers}
    layers, left = [], set(numbers)
    while left:
        free = tuple(sorted(k for k in left if not before[k] & left - {k}))
        layer = free or (min(left, key=lambda k: (distance[k], k)),)
        layers.append(layer)
        left -= set(layer)
    return tuple(layers)


def _median_depth(depth: Array) -> float:
    measured = depth[np.isfinite(depth)]
    return float(np.median(measured)) if len(measured) else np.inf


def _in_front(frame: Frame, labels: Labels) -> set[tuple[int, int]]:
    """Return the pairs of objects of which the first is in front of the second, next to it in the image."""
    count = int(labels.max()) + 1
    nearer = np.zeros((count, count), np.int64)
    limit = NEARER + 3 * np.nan_to_num(depth_sigma(frame.depth))
    for step in STEPS_PX:
        for one, two in ((np.s_[:-step], np.s_[step:]), (np.s_[:, :-step], np.s_[:, step:])):
            for here, there in ((one, two), (two, one)):
                a, b = labels[here], labels[there]
                with np.errstate(invalid="ignore"):
                    ahead = (a > 0) & (b > 0) & (a != b) & (frame.depth[there] - frame.depth[here] > limit[there])
                np.add.at(nearer, (a[ahead], b[ahead]), 1)
    found = np.argwhere((nearer >= PAIRS_MIN) & (nearer > nearer.T))
    return {(int(a), int(b)) for a, b in found}


def cleared_images(
    frame: Frame, support: SupportSurface, segmentation: Segmentation, shapes: Mapping[int, FittedShape]
) -> tuple[ClearedImage, ...]:
    """Return the image after each layer of objects has been removed; the last one shows no objects.

    What the objects hid is filled in without a model: the depth is that of the fitted solids, which continue by
    symmetry what is seen of them, else that of the plane of the support within its outline, else the nearest
    measurement. Each surface has the colors that it has beside the hole.
    """
    images = []
    removed: tuple[int, ...] = ()
    for layer in removal_order(frame, segmentation):
        removed += layer
        images.append(_cleared(frame, support, segmentation.labels, shapes, tuple(sorted(removed))))
    return tuple(images)


def cleared_view(frame: Frame, support: SupportSurface, shapes: Mapping[int, FittedShape]) -> ClearedImage:
    """Return an image of another camera, whose pose is ``support.X_WC``, without any of the objects.

    The objects are where their solids are, and where the depth does not show something in front of them.
    """
    height, width = frame.depth.shape
    v, u = np.mgrid[:height, :width]
    local = np.stack([(u - frame.K[0, 2]) / frame.K[0, 0], (v - frame.K[1, 2]) / frame.K[1, 1], np.ones(u.shape)], -1)
    rays = local.reshape(-1, 3) @ support.X_WC.rotation.T
    nearest, labels = np.full(len(rays), np.inf), np.zeros(len(rays), np.int32)
    for k, shape in shapes.items():
        mesh = tessellate(shape.geometry)
        hit = cast_mesh(support.X_WC.p, rays, shape.X_WO.apply(mesh.vertices), mesh.faces).depth
        closer = hit < nearest
        nearest, labels = np.where(closer, hit, nearest), np.where(closer, k, labels)
    hidden = np.nan_to_num(frame.depth, nan=np.inf).ravel() < nearest - OCCLUDED
    found = np.where(hidden, 0, labels).reshape(height, width)
    spread = grown(found > 0, disk(RIM_PX))
    found = np.where(spread & (found == 0), int(found.max()), found).astype(np.int32)
    return _cleared(frame, support, found, shapes, tuple(sorted(shapes)))


def removal_layers(cleared: Sequence[ClearedImage], names: Mapping[int, str]) -> tuple[tuple[str, ...], ...]:
    """Return the names of the objects that each image removes in addition to the one before."""
    before = [set[int](), *(set(image.removed) for image in cleared)]
    added = (set(image.removed) - known for image, known in zip(cleared, before, strict=False))
    return tuple(tuple(sorted(names[k] for k in numbers if k in names)) for numbers in added)


def _cleared(
    frame: Frame, support: SupportSurface, labels: Labels, shapes: Mapping[int, FittedShape], removed: Sequence[int]
) -> ClearedImage:
    gone = np.isin(labels, removed)
    near = grown(gone, disk(SHADOW_PX)) & ~np.isfinite(frame.depth)
    hole = (closed(grown(gone, disk(RIM_PX)), SHADOW_PX // 2) | near) & ((labels == 0) | gone)
    rows, columns = np.nonzero(hole)
    x, y = (columns - frame.K[0, 2]) / frame.K[0, 0], (rows - frame.K[1, 2]) / frame.K[1, 1]
    rays = np.column_stack([x, y, np.ones(len(rows))]) @ support.X_WC.rotation.T
    nearest, owner = _plane_depth(support, rays), np.zeros(len(rows), np.int32)
    for k, shape in shapes.items():
        if k not in removed:
            mesh = tessellate(shape.geometry)
            hit = cast_mesh(support.X_WC.p, rays, shape.X_WO.apply(mesh.vertices), mesh.faces).depth
            closer = hit < nearest
            nearest, owner = np.where(closer, hit, nearest), np.where(closer, k, owner)
    shown = np.where(gone, 0, labels).astype(np.int32)
    shown[rows, columns] = owner
    depth = frame.depth.copy()
    bare = np.isfinite(frame.depth) & (labels == 0) & ~hole
    beyond = ~np.isfinite(nearest)
    if beyond.any() and bare.any():
        nearest[beyond] = frame.depth[_nearest(bare, rows[beyond], columns[beyond])]
    depth[rows, columns] = np.where(np.isfinite(nearest), nearest, np.nan)
    return ClearedImage(tuple(removed), hole, shown, _colors(frame, labels, shown, hole), depth)


def _plane_depth(support: SupportSurface, rays: Array) -> Array:
    """Return the depth [m] at which rays meet the support within its outline, infinite for those that do not."""
    import shapely

    with np.errstate(divide="ignore"):
        depth = np.where(rays[:, 2] < 0, -support.X_WC.p[2] / rays[:, 2], np.inf)
    at = support.X_WC.p[:2] + np.where(np.isfinite(depth), depth, 0)[:, None] * rays[:, :2]
    return np.where(shapely.contains_xy(shapely.Polygon(support.outline), at[:, 0], at[:, 1]), depth, np.inf)


def _colors(frame: Frame, labels: Labels, shown: Labels, hole: Mask) -> np.ndarray:
    """Return the colors of an image whose hole shows the surfaces ``shown``."""
    out = frame.color.copy()
    ground = hole & (shown == 0)
    out[ground] = _ground_colors(frame.color, (labels == 0) & ~hole)[ground]
    for k in np.unique(shown[hole & (shown > 0)]):
        own = (labels == k) & ~hole
        core = shrunk(own, disk(2))
        source, here = core if core.any() else own, np.nonzero(hole & (shown == k))
        if source.any():
            out[here] = frame.color[_nearest(source, *here)]
    return out


def _ground_colors(color: np.ndarray, bare: Mask) -> np.ndarray:
    """Return an image in which the pixels that are not bare have the blurred colors of bare ones near them."""
    import cv2

    height, width = bare.shape
    step = max(1.0, max(height, width) / BLURRED_PX)
    size = max(1, round(width / step)), max(1, round(height / step))
    small = np.asarray(cv2.resize(color, size, interpolation=cv2.INTER_AREA), np.uint8)
    seen = np.asarray(cv2.resize(bare.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.999)
    filled = filled_colors(small, seen if seen.any() else ~seen)
    return np.asarray(cv2.resize(filled, (width, height), interpolation=cv2.INTER_LINEAR), np.uint8)


def _nearest(mask: Mask, rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows and columns of the pixels of a mask that are nearest to the given pixels."""
    from scipy.spatial import cKDTree

    rim = np.argwhere(mask & ~shrunk(mask, SQUARE))  # what is nearest to a pixel outside of a mask is on its rim
    at = rim[cKDTree(rim).query(np.column_stack([rows, columns]))[1]]
    return at[:, 0], at[:, 1]
