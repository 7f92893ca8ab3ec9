"""Plausible densities, which reveal masses in grams and sizes in millimeters."""

from __future__ import annotations

import math
from itertools import pairwise

from simfoundry.spec.models.base import BoxShape, CapsuleShape, CylinderShape, LatheShape, Shape, SphereShape

LIGHTEST, HEAVIEST = 5.0, 23_000.0
"""Range of plausible densities [kg/m^3], from foam to osmium; the volume of a hollow object includes its cavity."""


def implausible(density: float) -> str:
    """Return a hint for an implausible density [kg/m^3]; empty for a plausible one."""
    if LIGHTEST <= density <= HEAVIEST:
        return ""
    return f"densities range from {LIGHTEST:g} to {HEAVIEST:g} kg/m^3; are all masses in kg and all lengths in m?"


def volume(shape: Shape) -> float:
    """Return the volume of a primitive [m^3]; infinite if it overflows."""
    try:
        value = _volume(shape)
    except OverflowError:
        return math.inf
    return value if math.isfinite(value) else math.inf


def _volume(shape: Shape) -> float:
    match shape:
        case BoxShape():
            return math.prod(shape.box)
        case SphereShape():
            return 4 / 3 * math.pi * shape.sphere**3
        case CylinderShape():
            return math.pi * shape.cylinder.radius**2 * shape.cylinder.height
        case CapsuleShape():
            r, h = shape.capsule.radius, shape.capsule.height
            return math.pi * r**2 * (h + 4 / 3 * r)
        case LatheShape():
            rings = shape.lathe.profile
            thirds = ((a[0] ** 2 + a[0] * b[0] + b[0] ** 2) * (a[1] - b[1]) for a, b in pairwise(rings))
            return abs(math.pi / 3 * sum(thirds))  # frusta; inner ones are subtracted from outer ones
    corners = shape.prism.outline
    doubled = sum(a[0] * b[1] - a[1] * b[0] for a, b in zip(corners, (*corners[1:], corners[0]), strict=True))
    return abs(doubled) / 2 * shape.prism.height
