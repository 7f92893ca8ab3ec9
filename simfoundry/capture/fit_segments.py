"""Fitting of solids to segments, from the bottom up: each object stands on the fitted top of its support."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.errors import CaptureError
from simfoundry.capture.frame import Frame, Segmentation, SupportSurface
from simfoundry.capture.shapes.fit import FittedShape, fit_shape
from simfoundry.geometry.frames import Array, Pose, frozen_array
from simfoundry.geometry.shapes import Box
from simfoundry.geometry.tessellate import tessellate

Progress = Callable[[str, float], None]

SUNK = 0.03
"""Distance below the top of its support at which a supported object is not seen [m]; fitted tops err by 1 to 2 cm."""

DOUBTFUL = 0.05
"""Least confidence of a fit: below it, the solid explains next to none of the visible points."""

CARRIED = 0.25
"""Least share of an object's visible points that lie above its support."""

FOOTHOLD = 0.01
"""Distance by which a support reaches beyond the middle of the object on it [m]."""

DEEPEST = 0.12
"""Greatest depth that may be added to a box for that [m]."""

EDGE = 0.01
"""Distance by which they may lie beyond its edge [m]."""


def fit_segments(
    frame: Frame, support: SupportSurface, segmentation: Segmentation, report: Progress
) -> tuple[dict[int, FittedShape], dict[int, int], tuple[str, ...]]:
    """Fit every segment from the bottom up; also return each one's support, 0 for the table."""
    shapes: dict[int, FittedShape] = {}
    carriers: dict[int, int] = {}
    skipped: list[str] = []
    order = _bottom_up(segmentation)
    for done, k in enumerate(order):
        report(f"shape {k}", done / max(len(order), 1))
        carriers[k] = _carrier(frame, support, segmentation, shapes, k)
        base_z = _top(shapes[carriers[k]]) if carriers[k] else 0.0
        try:
            shape = fit_shape(frame, support, segmentation.labels == k, base_z, labels=segmentation.labels)
        except CaptureError as error:
            skipped.append(f"segment {k}: {error.message}")
            continue
        if shape.confidence < DOUBTFUL:
            skipped.append(f"segment {k}: no shape explains it (confidence {shape.confidence:.2f})")
            continue
        shapes[k] = shape
        if carriers[k]:
            shapes[carriers[k]] = deepened(shapes[carriers[k]], shape, support.X_WC.p)
    return dict(sorted(shapes.items())), carriers, tuple(skipped)


def _bottom_up(segmentation: Segmentation) -> list[int]:
    """Order object numbers so that each follows its support."""
    numbers = [int(k) for k in np.unique(segmentation.labels) if k > 0]

    def level(k: int, seen: frozenset[int] = frozenset()) -> int:
        on = segmentation.supports.get(k, 0)
        return 0 if on == 0 or k in seen else 1 + level(on, seen | {k})

    return sorted(numbers, key=lambda k: (level(k), k))


def _carrier(
    frame: Frame, support: SupportSurface, segmentation: Segmentation, shapes: dict[int, FittedShape], k: int
) -> int:
    """Return the fitted object that ``k`` stands on, 0 for the support.

    The support graph is believed only if the supporting solid lies below a good part of the visible points of ``k``:
    a foot that is merely hidden by a neighbor does not stand on it.
    """
    import shapely

    on = segmentation.supports.get(k, 0)
    if on not in shapes:
        return 0
    seen = support.X_WC.apply(frame.points[(segmentation.labels == k) & np.isfinite(frame.depth)])
    if not len(seen) or np.percentile(seen[:, 2], 5) < _top(shapes[on]) - SUNK:
        return 0
    below = shapely.MultiPoint(footprint(shapes[on])).convex_hull.buffer(EDGE)
    return on if shapely.contains(below, shapely.points(seen[:, :2])).mean() >= CARRIED else 0


def deepened(carrier: FittedShape, carried: FittedShape, eye: Array) -> FittedShape:
    """Return a box made deep enough to reach under the middle of the object on it.

    The far side of a box is never seen, and an object on it hides its top. Objects rest, so a depth that would let
    them fall is wrong. ``eye`` [m] is the camera in the world; the seen side stays where it is.
    """
    if not isinstance(carrier.geometry, Box):
        return carrier
    X_WO, size = carrier.X_WO, np.array(carrier.geometry.size)
    away = X_WO.rotation.T @ (X_WO.p - eye)
    axis = int(np.argmax(np.abs(away[:2])))
    middle = X_WO.inverse().apply(np.append(footprint(carried).mean(axis=0), X_WO.p[2]))
    need = float(np.sign(away[axis]) * middle[axis]) + FOOTHOLD - size[axis] / 2
    if not 0 < need <= DEEPEST:
        return carrier
    shift = np.zeros(3)
    shift[axis] = np.sign(away[axis]) * need / 2
    size[axis] += need
    return replace(carrier, geometry=Box(frozen_array(size)), X_WO=X_WO @ Pose.of(shift))


def footprint(shape: FittedShape) -> NDArray[np.float64]:
    """Corners of a fitted shape seen from above, in world xy [m], shape (n, 2)."""
    return shape.X_WO.apply(tessellate(shape.geometry).vertices)[:, :2]


def _top(shape: FittedShape) -> float:
    """Height of the highest point of a fitted shape above the support [m]."""
    return float(shape.X_WO.apply(tessellate(shape.geometry).vertices)[:, 2].max())
