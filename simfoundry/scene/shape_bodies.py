"""Shapes of the language as bodies: visuals, solids and colliders."""

from __future__ import annotations

import io
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from simfoundry.assets import mass
from simfoundry.assets.cache import Cache, key_of
from simfoundry.geometry.frames import Array
from simfoundry.geometry.frames import frozen_array as frozen
from simfoundry.geometry.shapes import Box, Capsule, Cylinder, Geometry, Mesh, Sphere
from simfoundry.geometry.tessellate import Faces, closed_mesh
from simfoundry.spec.models.base import (
    BoxShape,
    CapsuleShape,
    CylinderShape,
    LatheShape,
    PrismShape,
    SphereShape,
)

ShapeSpec = BoxShape | SphereShape | CylinderShape | CapsuleShape | PrismShape | LatheShape

CUT_VERSION = "cut shape 1"
"""Version of the convex decomposition of lathes and prisms; part of the cache key."""


class ShapeBody(NamedTuple):
    """A shape in its own frame: the ``visual``, the ``solid`` of density 1, and the ``colliders``.

    ``error`` [m] is the maximum distance between the colliders and the shape.
    """

    visual: Geometry
    solid: mass.SolidMoments
    colliders: tuple[Geometry, ...]
    error: float = 0.0


@lru_cache(maxsize=1024)
def shape_body(shape: ShapeSpec, cache: Cache | None = None) -> ShapeBody:
    """Return the body of a shape; raises :class:`MeshError` for a profile or outline that encloses no area.

    The decomposition of a lathe or prism takes up to 40 ms and loads two large libraries; ``cache`` keeps the parts
    between runs.
    """
    geometry: Geometry
    match shape:
        case BoxShape():
            geometry, solid = Box(frozen(shape.box)), mass.box(np.array(shape.box))
        case SphereShape():
            geometry, solid = Sphere(shape.sphere), mass.sphere(shape.sphere)
        case CylinderShape(cylinder=c):
            geometry, solid = Cylinder(c.radius, c.height), mass.cylinder(c.radius, c.height)
        case CapsuleShape(capsule=c):
            geometry, solid = Capsule(c.radius, c.height), mass.capsule(c.radius, c.height)
        case PrismShape(prism=p):
            from simfoundry.assets.solids import prism_mesh

            outline, parts, _ = _cut(shape, cache)
            whole = prism_mesh(outline, p.height)
            return ShapeBody(closed_mesh(*whole), mass.mesh(*whole), parts)
        case LatheShape():
            from simfoundry.assets.solids import lathe_mesh

            profile, parts, error = _cut(shape, cache)
            return ShapeBody(closed_mesh(*lathe_mesh(profile)), mass.revolution(profile), parts, error)
    return ShapeBody(geometry, solid, (geometry,))


_Cut = tuple[Array, tuple[Geometry, ...], float]
"""A checked outline or profile, the convex parts of its solid, and their maximum distance from it [m]."""


def _cut(shape: PrismShape | LatheShape, cache: Cache | None) -> _Cut:
    key = key_of(CUT_VERSION, repr(shape))
    stored = cache.get(key) if cache is not None else None
    if stored is not None and (found := _unpack(stored)) is not None:
        return found
    parts: list[tuple[Array, Faces]]
    if isinstance(shape, PrismShape):
        from simfoundry.assets.solids import checked_outline, convex_outlines, prism_mesh

        outline, error = checked_outline(np.array(shape.prism.outline)), 0.0
        parts = [prism_mesh(p, shape.prism.height) for p in convex_outlines(outline)]
    else:
        from simfoundry.assets.convex import hull
        from simfoundry.assets.solids import checked_profile, lathe_error, lathe_parts

        outline = checked_profile(np.array(shape.lathe.profile))
        parts = [hull(points) for points in lathe_parts(outline)]
        error = lathe_error(outline, parts)
    if cache is not None:
        cache.put(key, _pack(outline, parts, error))
    return outline, tuple(closed_mesh(*part) for part in parts), error


def _pack(outline: Array, parts: list[tuple[Array, Faces]], error: float) -> bytes:
    stream = io.BytesIO()
    counts = np.array([[len(corners), len(faces)] for corners, faces in parts])
    corners, faces = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    np.savez(stream, allow_pickle=False, outline=outline, corners=corners, faces=faces, counts=counts, error=error)
    return stream.getvalue()


def _unpack(data: bytes) -> _Cut | None:
    """Read a cache entry; return None if it is damaged, so that it is computed again."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            ends = np.cumsum(arrays["counts"], axis=0)[:-1]
            corners, faces = (np.split(arrays[name], ends[:, k]) for k, name in enumerate(("corners", "faces")))
            parts: tuple[Mesh, ...] = tuple(map(closed_mesh, corners, faces))
            return arrays["outline"], parts, float(arrays["error"])
    except Exception:  # a damaged archive raises OSError, KeyError, ValueError, or errors of zipfile and zlib
        return None
