"""Levels beside the support as fixed objects: a lower table, a shelf, or a chest on which other objects stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from simfoundry.assets.solids import prism_mesh
from simfoundry.capture.description.support_object import DEFAULT_THICKNESS, EDGE, beneath, measured_thickness
from simfoundry.capture.frame import Frame, SupportLevel, SupportSurface
from simfoundry.capture.shapes.fit import FittedShape
from simfoundry.geometry.frames import Array, Pose, frozen_array
from simfoundry.geometry.shapes import Mesh

BAND = 0.02  # [m] height of the bands of a side, each of which must be visible for the side to reach the support
BAND_POINTS = 40  # minimum number of points in a band; stray depth at an edge has fewer


def level_shape(frame: Frame, support: SupportSurface, level: SupportLevel, footprints: Sequence[Array]) -> FittedShape:
    """Return the solid of a level: a prism beneath its outline, down to what is seen of its side.

    A level above the support whose side is visible down to it is a solid block. Otherwise its thickness is measured at
    its edge, or assumed.

    Args:
        frame: The image.
        support: The support.
        level: The level.
        footprints: Corners of the objects on it in the world [m], shape (n, 2) each, beneath which it extends.
    """
    outline = beneath(level.outline, list(footprints))
    raised = replace(support.at(level), outline=outline)
    thickness = measured_thickness(frame, raised) or DEFAULT_THICKNESS
    if level.height > 0:
        reaches = _reaches_down(frame, raised, level.height)
        thickness = level.height if reaches else min(thickness, level.height)
    middle = (outline.min(axis=0) + outline.max(axis=0)) / 2
    vertices, faces = prism_mesh(outline - middle, thickness)
    X_WO = Pose.of((*middle, level.height - thickness / 2))
    return FittedShape(Mesh(frozen_array(vertices), faces), X_WO, support.residual, 1.0, False)


def level_outline(shape: FittedShape) -> Array:
    """Return the outline of the solid of a level in its own frame [m], counterclockwise, shape (n, 2)."""
    assert isinstance(shape.geometry, Mesh)
    vertices = shape.geometry.vertices
    return np.asarray(vertices[len(vertices) // 2 :, :2])  # the upper half of a prism's vertices


def level_thickness(shape: FittedShape) -> float:
    """Return the height of the solid of a level [m]."""
    assert isinstance(shape.geometry, Mesh)
    return float(np.ptp(shape.geometry.vertices[:, 2]))


def _reaches_down(frame: Frame, raised: SupportSurface, height: float) -> bool:
    """Return True if the side of a level is visible down to the support, ``height`` [m] below it."""
    import shapely

    points = raised.X_WC.apply(frame.points_of(np.isfinite(frame.depth)))
    below = points[(points[:, 2] < -BAND) & (points[:, 2] > BAND - height)]
    if height < 3 * BAND or not len(below):
        return False
    ring = shapely.Polygon(raised.outline).exterior
    near = below[shapely.distance(ring, shapely.points(below[:, :2])) < EDGE]
    counts = np.histogram(-near[:, 2], bins=np.arange(BAND, height - BAND / 2, BAND))[0]
    return len(counts) > 0 and bool((counts >= BAND_POINTS).all())
