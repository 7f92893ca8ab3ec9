"""Primitive shapes and colors for imported parts."""

from __future__ import annotations

from collections.abc import Iterable

from simfoundry.spec.models.shapes import (
    BoxShape,
    CapsuleShape,
    ConeShape,
    CylinderShape,
    EllipsoidShape,
    Round,
    SphereShape,
)

PrimitiveShape = BoxShape | SphereShape | EllipsoidShape | CylinderShape | CapsuleShape | ConeShape
Rgba = tuple[float, float, float, float]


def clamped_rgba(values: Iterable[float]) -> Rgba:
    """Return an RGBA color with each channel clamped to the range from 0 to 1."""
    r, g, b, a = (min(max(float(v), 0.0), 1.0) for v in values)
    return r, g, b, a


def primitive(kind: str, *size: float) -> PrimitiveShape:
    """Return a primitive shape of the given kind and size [m].

    The size consists of the extents for a `box`, the radius for a `sphere`, the three radii for an `ellipsoid`, and the
    radius and height for a `cylinder`, `capsule` or `cone`. An ellipsoid with equal radii becomes a sphere.
    """
    if kind == "box":
        x, y, z = size
        return BoxShape(box=(x, y, z))
    if kind == "sphere" or (kind == "ellipsoid" and len(set(size)) == 1):
        return SphereShape(sphere=size[0])
    if kind == "ellipsoid":
        x, y, z = size
        return EllipsoidShape(ellipsoid=(x, y, z))
    tube = Round(radius=size[0], height=size[1])
    if kind == "cone":
        return ConeShape(cone=tube)
    return CylinderShape(cylinder=tube) if kind == "cylinder" else CapsuleShape(capsule=tube)
