"""Measure and edit parts of asset documents. Each edit returns a new part."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from simfoundry.geometry.frames import Array
from simfoundry.scene.state import pose
from simfoundry.spec.models.asset import PartSpec
from simfoundry.spec.models.base import PoseSpec
from simfoundry.spec.models.shapes import (
    BoxShape,
    CapsuleShape,
    ConeShape,
    CylinderShape,
    EllipsoidShape,
    LatheShape,
    OpenBox,
    OpenBoxShape,
    PartShape,
    PrismShape,
    Round,
    SphereShape,
)

UP = np.array([0.0, 0.0, 1.0])


def moved(part: PartSpec, xyz: Array) -> PartSpec:
    """Return the part with its frame at ``xyz`` [m] and its rotation unchanged."""
    return part.model_copy(update={"pose": part.pose.model_copy(update={"xyz": _vector(xyz)})})


def shaped(part: PartSpec, shape: PartShape) -> PartSpec:
    """Return the part with its shape replaced."""
    return part.model_copy(update={"shape": shape})


def at(part: PartSpec) -> Array:
    """Return the position of the part's frame in the link [m], as an array of shape (3,)."""
    return np.array(part.pose.xyz)


def aimed(xyz: Array, direction: Array) -> PoseSpec:
    """Return a pose at ``xyz`` [m] with its z axis along ``direction``."""
    x, y, z = (float(v) for v in direction)
    pitch, yaw = math.degrees(math.atan2(math.hypot(x, y), z)), math.degrees(math.atan2(y, x))
    if abs(pitch) < 1e-9:
        return PoseSpec(xyz=_vector(xyz))
    return PoseSpec(xyz=_vector(xyz), rpy_deg=(0.0, round(pitch, 4), round(yaw, 4)))


def axis_of(part: PartSpec) -> Array:
    """Return the z axis of the part in the link frame, as a unit vector of shape (3,)."""
    return pose(part.pose).rotation[:, 2]


def rod(part: PartSpec) -> tuple[float, float] | None:
    """Return the radius [m] and the length [m] of a cylinder or capsule.

    The length excludes the caps of a capsule. For any other part, the result is None.
    """
    match part.shape:
        case CylinderShape(cylinder=size) | CapsuleShape(capsule=size):
            return size.radius, size.height
    return None


def cylinder(radius: float, height: float) -> CylinderShape:
    """Return a cylinder with the given radius and height [m]."""
    return CylinderShape(cylinder=Round(radius=float(radius), height=float(height)))


def capsule(radius: float, height: float) -> CapsuleShape:
    """Return a capsule with the given radius and height [m].

    The height excludes the caps.
    """
    return CapsuleShape(capsule=Round(radius=float(radius), height=float(height)))


def with_rod(part: PartSpec, radius: float, height: float) -> PartSpec:
    """Return a cylinder or capsule part with different dimensions [m]."""
    return shaped(part, (cylinder if isinstance(part.shape, CylinderShape) else capsule)(radius, height))


def corners(part: PartSpec) -> Array:
    """Return points on the surface of the part in the link frame [m], as an array of shape (k, 3).

    The bounds of the points equal or approximate the bounds of the part. A mesh is represented by its origin because
    its file is not read.
    """
    return pose(part.pose).apply(_own_corners(part.shape))


def _own_corners(shape: PartShape | None) -> Array:
    match shape:
        case BoxShape():
            return _box(np.array(shape.box) / 2)
        case SphereShape():
            return _box(np.full(3, shape.sphere))
        case EllipsoidShape():
            return _box(np.array(shape.ellipsoid))
        case OpenBoxShape():
            return _box(np.array(shape.open_box.size) / 2)
        case ConeShape():
            return _ring([(shape.cone.radius, -shape.cone.height / 2), (0.0, shape.cone.height / 2)])
        case CylinderShape():
            c = shape.cylinder
            return _ring([(c.radius, -c.height / 2), (c.radius, c.height / 2)])
        case CapsuleShape():
            c, half = shape.capsule, shape.capsule.height / 2
            return _ring([(0.0, -half - c.radius), (c.radius, -half), (c.radius, half), (0.0, half + c.radius)])
        case PrismShape():
            half = shape.prism.height / 2
            return np.array([(x, y, z) for z in (-half, half) for x, y in shape.prism.outline])
        case LatheShape():
            return _ring(list(shape.lathe.profile))
    return np.zeros((1, 3))


def _box(half: Array) -> Array:
    return np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]) * half


def _ring(profile: list[tuple[float, float]]) -> Array:
    turns = np.arange(16) * (math.pi / 8)
    return np.array([(r * math.cos(a), r * math.sin(a), z) for r, z in profile for a in turns])


def bounds(parts: Iterable[PartSpec]) -> tuple[Array, Array]:
    """Return the minimum and maximum corners [m] of the box around parts of a single link.

    Returns:
        Two arrays of shape (3,).
    """
    points = np.concatenate([corners(part) for part in parts])
    return points.min(axis=0), points.max(axis=0)


def _vector(xyz: Array) -> tuple[float, float, float]:
    x, y, z = (round(float(v), 6) + 0.0 for v in xyz)
    return x, y, z


def scaled(shape: PartShape, f: Array) -> PartShape:
    """Return a shape scaled along its own axes by ``f``, an array of shape (3,)."""
    x, y, z = (float(v) for v in f)
    across = float(np.sqrt(x * y))
    match shape:
        case BoxShape():
            a, b, c = shape.box
            return BoxShape(box=(a * x, b * y, c * z))
        case SphereShape():
            return SphereShape(sphere=shape.sphere * float(np.cbrt(x * y * z)))
        case EllipsoidShape():
            a, b, c = shape.ellipsoid
            return EllipsoidShape(ellipsoid=(a * x, b * y, c * z))
        case ConeShape(cone=size):
            return ConeShape(cone=Round(radius=size.radius * across, height=size.height * z))
        case OpenBoxShape(open_box=box):
            a, b, c = box.size
            return OpenBoxShape(open_box=OpenBox(size=(a * x, b * y, c * z), wall=box.wall * min(x, y, z)))
        case LatheShape():
            rings = tuple((r * across, h * z) for r, h in shape.lathe.profile)
            return LatheShape.model_validate({"lathe": {"profile": rings}})
        case PrismShape():
            outline = tuple((u * x, v * y) for u, v in shape.prism.outline)
            return PrismShape.model_validate({"prism": {"outline": outline, "height": shape.prism.height * z}})
        case CylinderShape(cylinder=size):
            return cylinder(size.radius * across, size.height * z)
        case CapsuleShape(capsule=size):
            return capsule(size.radius * across, size.height * z)


def is_radial(part: PartSpec) -> bool:
    """Return True if a part is a horizontal rod that points away from the z axis of its link."""
    p, axis = at(part), axis_of(part)
    off, is_level = float(np.hypot(*p[:2])), abs(float(axis[2])) < 1e-3
    return rod(part) is not None and off > 1e-3 and is_level and abs(float(axis[:2] @ p[:2])) / off > 0.9
