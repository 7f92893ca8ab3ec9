"""Rotations of an object about its vertical axis that do not change its shape."""

from __future__ import annotations

import math

import numpy as np

from simfoundry.geometry.frames import IDENTITY, Array
from simfoundry.scene.model import SceneObject
from simfoundry.scene.object_shapes import hulls

# Number of directions around the axis in which a shape is measured: a multiple of all orders in ORDERS.
DIRECTIONS = 48

# Elevations of these directions [rad]: across the axis, and between it and the axis, where a taper or a base differs.
ELEVATIONS = (-math.pi / 4, 0.0, math.pi / 4)

# Orders of rotational symmetry that are looked for, from the highest on: a full circle, a square and a rectangle.
ORDERS = (DIRECTIONS, 4, 2)

# Largest difference [m] between a shape and the rotated shape, and the same as a fraction of its largest extent. A
# round object that is approximated by a prism with 16 sides deviates by 2 %.
DIFFERS, DIFFERS_SHARE = 0.002, 0.03


def symmetry_order(item: SceneObject) -> int:
    """Return the number of rotations about the vertical axis of an object that do not change its convex hull.

    The axis passes through the center of its bounding box. Round objects have :data:`DIRECTIONS` such rotations, and
    objects without symmetry have one.
    """
    shape = hulls(item, X_WO=IDENTITY)
    low, high = shape.bounds()
    center = (low + high) / 2
    extents = np.array([_extents(shape.corners - center, shape.radius[shape.part], tilt) for tilt in ELEVATIONS])
    tolerance = max(DIFFERS, DIFFERS_SHARE * float((high - low).max()) / 2)
    for order in ORDERS:
        step = DIRECTIONS // order
        turned = [np.abs(extents - np.roll(extents, k * step, axis=1)).max() for k in range(1, order)]
        if max(turned) <= tolerance:
            return order
    return 1


def _extents(corners: Array, radius: Array, elevation: float) -> Array:
    """Return the extent of a shape in directions around the vertical axis [m], shape (DIRECTIONS,)."""
    angles = np.arange(DIRECTIONS) * 2 * math.pi / DIRECTIONS
    level = math.cos(elevation)
    rows = np.column_stack([level * np.cos(angles), level * np.sin(angles), np.full(DIRECTIONS, math.sin(elevation))])
    return np.asarray((corners @ rows.T + radius[:, None]).max(axis=0))
