"""Detect infeasible `inside` placements from the original meshes, before a convex decomposition that takes minutes.

The convex parts of a mesh contain the mesh and fill its shallow hollows. If an object's mesh collides with its
container's mesh at every height at which the container has walls around the object, the convex parts of the two collide
as well.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.hulls import Hulls
from simfoundry.geometry.shapes import Mesh
from simfoundry.geometry.walls import FOOT, LEVELS
from simfoundry.scene.carriers import PlaceError
from simfoundry.scene.frames import FrameTree
from simfoundry.scene.model import Collider, Link, SceneObject
from simfoundry.scene.place import Placement, approach, misfit
from simfoundry.spec.models.reuse import FramedPose

# Number of surface points at which vertical lines are tested; one every few millimeters on a hand-sized mesh.
POINTS = 600

# Steps of the R2 sequence: powers of the inverse plastic number, which distribute points evenly over a square.
GOLDEN = np.array([0.7548776662466927, 0.5698402909980532])

# Maximum depth of hollows that a decomposition may fill, as a fraction of the longest side: CoACD splits only hollows
# deeper than 5% of half that side (`threshold` in :mod:`simfoundry.assets.convex`).
RESOLUTION = 0.02


def uncut(item: SceneObject) -> SceneObject:
    """Return the object with its visual meshes instead of their hulls as colliders."""
    return replace(item, links=tuple(_uncut_link(link) for link in item.links))


def _uncut_link(link: Link) -> Link:
    shown = [visual for visual in link.visuals if isinstance(visual.geometry, Mesh)]
    if not shown or len(link.colliders) != 1 or not isinstance(link.colliders[0].geometry, Mesh):
        return link
    one = link.colliders[0]
    meshes = (Collider(v.name, v.geometry, one.friction, one.restitution, v.X_LG) for v in shown)
    return replace(link, colliders=tuple(meshes))


def certain_misfits(
    objects: Mapping[str, SceneObject],
    places: Mapping[str, Placement],
    viewer: Pose | None,
    meshes: Collection[str],
    frames: FrameTree,
) -> dict[str, PlaceError]:
    """Return errors for objects that are certain not to fit inside their containers at any height.

    An object is tested only if its container has a pose, or is placed on an object that has a pose. ``meshes`` contains
    the names of objects whose meshes are used without decomposition (see :func:`uncut`).
    """
    placed = {name: item for name, item in objects.items() if name not in places}
    found = {}
    for name, place in places.items():
        if isinstance(place, FramedPose) or place.inside is None or name not in objects:
            continue
        container = place.inside.partition(".")[0]
        if container not in objects:
            continue
        # The object moves with its container, so the container's height does not matter.
        stands = {**placed, container: objects[container]}
        if place.xy is not None and container in places:
            continue
        try:
            held, carrier, _ = approach(objects[name], place, stands, viewer, frames)
        except PlaceError:
            continue
        cut = [shape for n, shape in ((name, held), (container, carrier.part)) if n in meshes]
        if cut and _is_blocked(held, carrier.part, RESOLUTION * max(float(shape.size().max()) for shape in cut)):
            found[name] = misfit(name, held, carrier, "inside")
    return found


def _is_blocked(held: Hulls, container: Hulls, slack: float) -> bool:
    """Return True if the object collides with the container at every height at which there are walls around its base.

    Collision-free height intervals shorter than ``slack`` [m] are ignored.
    """
    low, high = container.extent(np.array([0.0, 0.0, 1.0]))
    bottom, top = held.extent(np.array([0.0, 0.0, 1.0]))
    lowest, highest = low - bottom - max(LEVELS) * (top - bottom) - FOOT, high - bottom - max(FOOT, slack)
    reached = lowest
    for start, end in sorted(_blocked_lifts(held, container)):
        if start > reached + slack or reached >= highest:
            break
        reached = max(reached, end)
    return reached >= highest


def _blocked_lifts(held: Hulls, container: Hulls) -> Iterator[tuple[float, float]]:
    """Yield the intervals of lifts [m] that move a point on the object into a solid part of the container."""
    corners = container.corners[container.triangles]
    part = container.part[container.triangles[:, 0]]
    flat = corners[:, :, :2]
    low, high = flat.min(axis=1), flat.max(axis=1)
    for point in _surface_points(held):
        near = np.flatnonzero(((low <= point[:2]) & (point[:2] <= high)).all(axis=1))
        met, heights = _crossings(corners[near], point[:2])
        for one in set(part[near][met].tolist()):
            here = np.sort(heights[part[near][met] == one])
            if len(here) % 2 == 0:  # otherwise, the line grazes an edge, or the mesh is open
                for bottom, top in here.reshape(-1, 2) - point[2]:
                    yield float(bottom), float(top)


def _surface_points(shape: Hulls) -> Array:
    """Return :data:`POINTS` points [m] on a shape, as an array of shape (n, 3).

    The points are distributed over the faces of the shape and include some of its corners.
    """
    corners = shape.corners[:: max(1, len(shape.corners) // POINTS)]
    if not len(shape.triangles):
        return corners
    a, b, c = (shape.corners[shape.triangles[:, k]] for k in range(3))
    area = np.cumsum(np.linalg.norm(np.cross(b - a, c - a), axis=1))
    count = np.arange(POINTS)
    face = np.searchsorted(area, (count + 0.5) / POINTS * area[-1])
    s, t = (count[:, None] * GOLDEN % 1.0).T
    s, t = np.where(s + t > 1, 1 - s, s), np.where(s + t > 1, 1 - t, t)
    points = a[face] + s[:, None] * (b - a)[face] + t[:, None] * (c - a)[face]
    return np.concatenate([corners, points])


def _crossings(triangles: Array, point: Array) -> tuple[NDArray[np.bool_], Array]:
    """Intersect the vertical line through ``point`` with triangles.

    Args:
        triangles: Corners of the triangles [m], shape (k, 3, 3).
        point: A point on the line [m], shape (3,).

    Returns:
        A mask of the triangles that are hit, shape (k,), and the heights of the hits [m].
    """
    a, b, c = (triangles[:, k, :2] for k in range(3))
    u, v, w = b - a, c - a, point - a
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    steep = np.abs(area) < 1e-16  # the line hits the neighbors of a vertical triangle instead
    area = np.where(steep, 1.0, area)
    s = (w[:, 0] * v[:, 1] - w[:, 1] * v[:, 0]) / area
    t = (u[:, 0] * w[:, 1] - u[:, 1] * w[:, 0]) / area
    met = ~steep & (s >= 0) & (t >= 0) & (s + t <= 1)
    z = triangles[:, :, 2]
    heights = z[:, 0] + s * (z[:, 1] - z[:, 0]) + t * (z[:, 2] - z[:, 0])
    return met, heights[met]
