"""Posed shapes of scene objects, to be measured by :mod:`simfoundry.geometry`."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import numpy as np

from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.hulls import Hulls, hulls_of
from simfoundry.geometry.shapes import Box, Capsule, Cone, Cylinder, Ellipsoid, Geometry, Mesh, Sphere
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import SceneObject
from simfoundry.scene.state import SceneState

if TYPE_CHECKING:
    from simfoundry.geometry.crossings import HalfSpaces


def hulls(*items: SceneObject, X_WO: Pose | None = None) -> Hulls:
    """Return the posed colliders of all links in these objects. For links without colliders, visuals are used.

    If ``X_WO`` is given, the objects have this pose instead of their own.
    """
    return hulls_of(
        (piece.geometry, (item.X_WO if X_WO is None else X_WO) @ X_OL @ piece.X_LG, number)
        for item in items
        for number, (link, X_OL) in enumerate(zip(item.links, link_poses(item).values(), strict=True))
        for piece in link.colliders or link.visuals
    )


def solid(
    item: SceneObject,
    state: SceneState | None = None,
    links: Iterable[str] | None = None,
    keep: Callable[[Array], bool] = lambda corners: True,
) -> HalfSpaces:
    """Return the colliders of an object in a given state.

    Args:
        item: The object.
        state: The state; by default, the initial state of the scene.
        links: Names of the links to include; by default, all links.
        keep: Predicate on the corners [m] of a collider. Colliders that do not satisfy the predicate are excluded.
    """
    from simfoundry.geometry.crossings import solid_of

    chosen = None if links is None else set(links)
    X_OL = link_poses(item) if state is None else link_poses(item, state.of_object(item))
    X_WO = item.X_WO if state is None else state.poses[item.name]
    return solid_of(
        (
            (piece.geometry, X_WO @ X_OL[link.name] @ piece.X_LG)
            for link in item.links
            if chosen is None or link.name in chosen
            for piece in link.colliders
        ),
        keep,
    )


def link_bounds(item: SceneObject, part: str = "") -> list[tuple[Array, Array]]:
    """Return the minimum and maximum corners [m] of the world-aligned bounding box of each link with a shape.

    ``part`` is the name of a link or of the joint that moves it, and limits the result to this link.
    """
    moved = {joint.name: joint.child for joint in item.joints}
    links = [link for link in item.links if link.name == moved.get(part, part)] or list(item.links)
    poses = link_poses(item)
    return [
        hulls_of((piece.geometry, item.X_WO @ poses[link.name] @ piece.X_LG, 0) for piece in shown).bounds()
        for link in links
        if (shown := link.colliders or link.visuals)
    ]


def bounds(item: SceneObject) -> tuple[Array, Array]:
    """Return the minimum and maximum corners [m] of an object in its own frame.

    The bounds enclose the colliders, or the visuals if there are no colliders.
    """
    poses = link_poses(item)
    parts = [(part, poses[link.name]) for link in item.links for part in link.colliders or link.visuals]
    spans = [geometry_bounds(part.geometry, X_OL @ part.X_LG) for part, X_OL in parts]
    if not spans:
        return np.zeros(3), np.zeros(3)
    return np.min([low for low, _ in spans], axis=0), np.max([high for _, high in spans], axis=0)


def geometry_bounds(geometry: Geometry, X_OG: Pose) -> tuple[Array, Array]:
    """Return the minimum and maximum corners [m] of a posed geometry, in the frame in which the pose is expressed."""
    axes = np.abs(X_OG.rotation)
    match geometry:
        case Mesh():
            points = X_OG.apply(geometry.vertices)
            return points.min(axis=0), points.max(axis=0)
        case Box():
            half = axes @ (geometry.size / 2)
        case Sphere():
            half = np.full(3, geometry.radius)
        case Ellipsoid():
            half = np.sqrt(((X_OG.rotation * geometry.radii) ** 2).sum(axis=1))
        case Cone():
            spread = geometry.radius * np.sqrt(np.maximum(0.0, 1 - axes[:, 2] ** 2))
            tip = X_OG.rotation[:, 2] * geometry.height / 2
            low, high = np.minimum(-tip - spread, tip), np.maximum(-tip + spread, tip)
            return X_OG.p + low, X_OG.p + high
        case Cylinder():
            half = axes[:, 2] * geometry.height / 2 + geometry.radius * np.sqrt(np.maximum(0.0, 1 - axes[:, 2] ** 2))
        case Capsule():
            half = axes[:, 2] * geometry.height / 2 + geometry.radius
    return X_OG.p - half, X_OG.p + half


def world_bounds(item: SceneObject, X_WO: Pose) -> tuple[Array, Array]:
    """Return the minimum and maximum world coordinates [m] of an object's local bounding box at the pose ``X_WO``."""
    low, high = bounds(item)
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    moved = X_WO.apply(corners)
    return moved.min(axis=0), moved.max(axis=0)
