"""The level top of what carries things: where on it something may stand."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simfoundry.cousins.outline import Outline, hull
from simfoundry.scene.frames import Array
from simfoundry.scene.hulls import Hulls

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

UPWARD = 0.999
"""A face whose unit normal has at least this along z is level."""

STEP = 1e-3
"""Faces whose heights differ by less than this [m] are one level."""


@dataclass(frozen=True, eq=False)
class Support:
    """A level at ``height`` [m] of the object called ``name``.

    ``corners`` [m] of the convex hull of its ``area`` [m^2], counter-clockwise, shape (m, 2); ``plane`` is the area
    itself where it is not convex. ``plain`` where the object is one convex part: nothing of it stands out of the level.
    """

    name: str
    height: float
    corners: Array
    area: float
    plane: BaseGeometry | None
    plain: bool

    @cached_property
    def normals(self) -> Array:
        """Outward unit normals of the sides of the hull, shape (m, 2)."""
        edges = np.roll(self.corners, -1, axis=0) - self.corners
        outward = np.column_stack([edges[:, 1], -edges[:, 0]])
        return np.asarray(outward / np.linalg.norm(outward, axis=1, keepdims=True))

    @cached_property
    def offsets(self) -> Array:
        """Of the sides along their normals [m], shape (m,)."""
        return np.asarray(np.einsum("ij,ij->i", self.normals, self.corners))

    def holds(self, x: Array, y: Array, cos: Array, sin: Array, outline: Outline) -> NDArray[np.bool_]:
        """Whether the whole shadow is over the level, (n,), its rectangle's centre at x, y [m] and turned about z."""
        nx, ny = self.normals.T
        turned = np.stack([np.outer(cos, nx) + np.outer(sin, ny), np.outer(cos, ny) - np.outer(sin, nx)], axis=-1)
        reach = (turned @ outline.spread).max(axis=-1)
        within = (np.outer(x, nx) + np.outer(y, ny) + reach <= self.offsets).all(axis=1)
        if self.plane is None or not within.any():
            return np.asarray(within)
        import shapely

        sx, sy = outline.spread
        px = x[:, None] + np.outer(cos, sx) - np.outer(sin, sy)
        py = y[:, None] + np.outer(sin, sx) + np.outer(cos, sy)
        shadows = shapely.polygons(np.stack([px, py], axis=-1)[within])
        within[within] = shapely.covers(self.plane, shadows)
        return np.asarray(within)


def support_of(name: str, shape: Hulls, near: float | None = None) -> Support | None:
    """The level of an object nearest to the height ``near`` [m], or its largest; None where no face is level."""
    import shapely

    level = shape.normals[:, 2] > UPWARD
    triangles = shape.corners[shape.triangles[level]]
    if not len(triangles):
        return None
    height = triangles[:, :, 2].mean(axis=1)
    area = np.abs(_areas(triangles[:, :, :2]))
    heights = np.unique(np.round(height / STEP).astype(np.int64))
    if near is not None:
        chosen = float(height[np.argmin(np.abs(height - near))])
    else:
        sums = [area[np.abs(height - h * STEP) < STEP].sum() for h in heights]
        chosen = float(heights[int(np.argmax(sums))] * STEP)
        chosen = float(height[np.argmin(np.abs(height - chosen))])
    here = np.abs(height - chosen) < STEP
    plane = shapely.union_all(shapely.polygons(triangles[here & (area > 1e-12)][:, :, :2]), grid_size=1e-9)
    corners = hull(triangles[here].reshape(-1, 3)[:, :2])
    whole = float(shapely.area(shapely.polygons(corners)))
    convex = float(plane.area) >= 0.999 * whole
    shapely.prepare(plane)
    plain = len(shape.radius) == 1
    return Support(
        name, float(triangles[here][:, :, 2].max()), corners, float(plane.area), None if convex else plane, plain
    )


def _areas(triangles: Array) -> Array:
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return np.asarray((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2)
