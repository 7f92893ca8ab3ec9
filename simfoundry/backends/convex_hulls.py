"""Convex hulls that replace colliding ellipsoids and cones in formats without these primitives."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from itertools import permutations, product

import numpy as np

from simfoundry.backends.losses import Loss, approximate
from simfoundry.geometry.frames import Array
from simfoundry.geometry.shapes import Cone, Ellipsoid, Faces, Geometry, Mesh, closed_mesh, hull_mesh
from simfoundry.scene.model import Collider, Link, Scene, SceneObject

# The primitives that each backend writes as convex hulls. PhysX ignores the scale of a sphere along single axes.
REPLACED: Mapping[str, tuple[type[Geometry], ...]] = {
    "mjcf": (Cone,),
    "pybullet": (Ellipsoid, Cone),
    "urdf": (Ellipsoid, Cone),
    "usd": (Ellipsoid,),
}

# Number of sides of the pyramid that replaces a cone; with the tip, it has 64 corners, which is PhysX's limit.
_SIDES = 63

# Directions to the corners of a hull of the unit sphere, from which permutations and signs give all 60. Each pole is
# below a flat face, so an ellipsoid stands on its poles as on the true surface instead of tipping. The numbers minimize
# the distance between the hull and the sphere.
_DIRECTIONS = ((0.0, 0.3, 1.0), (0.6, 0.6, 1.0), (0.0, 1.0, 1.0))

# Distance of the corners from the center, for which the faces at the poles touch the unit sphere.
_REACH = math.hypot(*_DIRECTIONS[0])


def with_hulls(scene: Scene, kinds: tuple[type[Geometry], ...]) -> Scene:
    """Return a copy of the scene in which colliders of the given kinds are replaced by their convex hulls."""
    return replace(scene, objects=tuple(_object_with_hulls(item, kinds) for item in scene.objects))


def _object_with_hulls(item: SceneObject, kinds: tuple[type[Geometry], ...]) -> SceneObject:
    if not any(True for each in (item, *item.variants) for _ in _replaced(each, kinds)):
        return item

    def collider_with(c: Collider) -> Collider:
        return replace(c, geometry=hull_of(c.geometry)[0]) if isinstance(c.geometry, kinds) else c

    def link_with(link: Link) -> Link:
        return replace(link, colliders=tuple(map(collider_with, link.colliders)))

    variants = tuple(_object_with_hulls(variant, kinds) for variant in item.variants)
    return replace(item, links=tuple(map(link_with, item.links)), variants=variants)


def _replaced(item: SceneObject, kinds: tuple[type[Geometry], ...]) -> Iterator[Geometry]:
    return (c.geometry for link in item.links for c in link.colliders if isinstance(c.geometry, kinds))


def hull_losses(scene: Scene, kinds: tuple[type[Geometry], ...]) -> Iterator[Loss]:
    """Yield one loss for each object and each kind of primitive that is replaced by its hull."""
    for item in scene.objects:
        for kind in kinds:
            every = (geometry for each in (item, *item.variants) for geometry in _replaced(each, (kind,)))
            errors = [hull_of(geometry)[1] for geometry in every]
            if errors:
                off, name = 1000 * max(errors), kind.__name__
                reason = f"{name}s collide as convex hulls, whose surface is up to {off:.2g} mm away."
                yield approximate(name.lower(), item.name, reason, off, "mm")


@lru_cache(maxsize=256)
def hull_of(geometry: Geometry) -> tuple[Mesh, float]:
    """Return the convex hull that replaces an ellipsoid or a cone, and its distance from the surface [m].

    The corners of a cone's hull are on its surface. The faces of an ellipsoid's hull touch the surface at the poles,
    and its corners are outside. Upright objects therefore stand exactly at their height.
    """
    if isinstance(geometry, Cone):
        turn = np.arange(_SIDES) * (2 * math.pi / _SIDES)
        ring = np.column_stack([np.cos(turn), np.sin(turn)]) * geometry.radius
        base = np.column_stack([ring, np.full(_SIDES, -geometry.height / 2)])
        inside = geometry.radius * (1 - math.cos(math.pi / _SIDES))
        return closed_mesh(np.vstack([base, [[0.0, 0.0, geometry.height / 2]]]), _pyramid_faces()), inside
    assert isinstance(geometry, Ellipsoid)
    sphere = _sphere_hull()  # scaled afterwards, because the hull of an extremely thin ellipsoid is not robust
    return closed_mesh(sphere.vertices * geometry.radii, sphere.faces), (_REACH - 1) * float(geometry.radii.max())


def _pyramid_faces() -> Faces:
    """Return the triangles of a pyramid whose corners are those of its base, followed by its tip."""
    here = np.arange(_SIDES)
    base = np.column_stack([np.zeros(_SIDES - 2, int), here[2:], here[1:-1]])
    walls = np.column_stack([here, (here + 1) % _SIDES, np.full(_SIDES, _SIDES)])
    return np.concatenate([base, walls]).astype(np.int32)


@lru_cache(maxsize=1)
def _sphere_hull() -> Mesh:
    mesh = hull_mesh(_sphere_points())
    assert mesh is not None  # the points span a volume
    return mesh


def _sphere_points() -> Array:
    """Return the corners of the hull of the unit sphere, shape (60, 3)."""
    found = {
        tuple(side * v / math.hypot(*direction) * _REACH for side, v in zip(signs, turned, strict=True))
        for direction in _DIRECTIONS
        for turned in permutations(direction)
        for signs in product((1.0, -1.0), repeat=3)
    }
    return np.array(sorted({tuple(v + 0.0 for v in point) for point in found}))
