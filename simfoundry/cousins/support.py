"""The level top of what carries things: where on it something may stand."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simfoundry.cousins.outline import Complex, hull
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
    def bounds(self) -> tuple[Array, Array]:
        """Lowest and highest corner [m], shape (2,) each."""
        return self.corners.min(axis=0), self.corners.max(axis=0)

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

    def holds(self, centre: Array, turn: Complex, spread: Array) -> NDArray[np.bool_]:
        """Whether whole shadows are over the level, (n,).

        The centres of their rectangles [m], (n, 2); their turns about z as unit complex numbers, (n,); and the
        :attr:`Outline.spread` of one for all, (2, m), or of each, (n, 2, m).
        """
        # Sides turned back into the thing's frame, where the shadow's farthest corner along each is found.
        sides = (self._sides * turn.conj()[:, None]).view(np.float64).reshape(len(turn), -1, 2)
        reach = (sides @ spread).max(axis=-1)
        within: NDArray[np.bool_] = (centre @ self.normals.T + reach <= self.offsets).all(axis=1)
        if self.plane is not None and within.any():
            import shapely

            each = np.broadcast_to(spread, (len(turn), *spread.shape[-2:]))[within]
            corners = (each[:, 0] + 1j * each[:, 1]) * turn[within, None]
            points = corners.view(np.float64).reshape(*corners.shape, 2) + centre[within, None]
            within[within] = shapely.covers(self.plane, shapely.polygons(points))
        return within

    @cached_property
    def _sides(self) -> Complex:
        return np.ascontiguousarray(self.normals).view(np.complex128)[:, 0]


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
