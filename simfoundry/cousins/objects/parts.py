"""Edits of an asset document part by part; nothing is changed in place."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from simfoundry.geometry.frames import Array
from simfoundry.scene.poses import pose
from simfoundry.spec.models.asset import AssetSpec, PartSpec
from simfoundry.spec.models.base import (
    BoxShape,
    CapsuleShape,
    CylinderShape,
    LatheShape,
    PoseSpec,
    PrismShape,
    Shape,
    SphereShape,
)

Key = tuple[str, str]
"""A part, by its link and its name."""

Parts = Mapping[Key, PartSpec]


def parts_of(spec: AssetSpec) -> dict[Key, PartSpec]:
    """Every part of every link."""
    return {(link, name): part for link, body in spec.links.items() for name, part in body.parts.items()}


def with_parts(spec: AssetSpec, parts: Parts) -> AssetSpec:
    """The spec with these parts and no others, each in its link, in their order."""
    links = {
        name: link.model_copy(update={"parts": {p: part for (owner, p), part in parts.items() if owner == name}})
        for name, link in spec.links.items()
    }
    return spec.model_copy(update={"links": links})


def each(spec: AssetSpec, change: Callable[[Key, PartSpec], PartSpec]) -> AssetSpec:
    """The spec with every part as ``change`` has it."""
    return with_parts(spec, {key: change(key, part) for key, part in parts_of(spec).items()})


def moved(part: PartSpec, xyz: Array) -> PartSpec:
    """The part with its frame at ``xyz`` [m], turned as it is."""
    return part.model_copy(update={"pose": part.pose.model_copy(update={"xyz": _vector(xyz)})})


def shaped(part: PartSpec, shape: Shape) -> PartSpec:
    """The part with another shape."""
    return part.model_copy(update={"shape": shape})


def at(part: PartSpec) -> Array:
    """Where its frame is in the link [m], shape (3,)."""
    return np.array(part.pose.xyz)


def aimed(xyz: Array, direction: Array) -> PoseSpec:
    """A pose at ``xyz`` [m] whose z points along ``direction``."""
    x, y, z = (float(v) for v in direction)
    pitch, yaw = math.degrees(math.atan2(math.hypot(x, y), z)), math.degrees(math.atan2(y, x))
    if abs(pitch) < 1e-9:
        return PoseSpec(xyz=_vector(xyz))
    return PoseSpec(xyz=_vector(xyz), rpy_deg=(0.0, round(pitch, 4), round(yaw, 4)))


def axis_of(part: PartSpec) -> Array:
    """The unit vector along the part's own z in the link's frame, shape (3,)."""
    return pose(part.pose).rotation[:, 2]


def is_level(direction: Array) -> bool:
    """Whether a direction lies in the plane of x and y."""
    return abs(float(direction[2])) < 1e-3


def rod(part: PartSpec) -> tuple[float, float] | None:
    """Radius and length [m] of a cylinder or capsule, its caps left out; None for any other part."""
    match part.shape:
        case CylinderShape():
            return part.shape.cylinder.radius, part.shape.cylinder.height
        case CapsuleShape():
            return part.shape.capsule.radius, part.shape.capsule.height
    return None


def with_rod(part: PartSpec, radius: float, height: float) -> PartSpec:
    """A cylinder or capsule with other sizes [m]."""
    kind = CylinderShape if isinstance(part.shape, CylinderShape) else CapsuleShape
    name = "cylinder" if kind is CylinderShape else "capsule"
    return shaped(part, kind.model_validate({name: {"radius": float(radius), "height": float(height)}}))


def corners(part: PartSpec) -> Array:
    """Points of the part's surface in the link's frame [m], shape (k, 3): their bounds are those of the part, or close.

    Of a mesh there is only its origin: its file is not read.
    """
    return pose(part.pose).apply(_own_corners(part.shape))


def _own_corners(shape: Shape | None) -> Array:
    match shape:
        case BoxShape():
            return _box(np.array(shape.box) / 2)
        case SphereShape():
            return _box(np.full(3, shape.sphere))
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


def bounds(parts: Iterator[PartSpec] | list[PartSpec]) -> tuple[Array, Array]:
    """The lowest and the highest corner [m] of parts of one link, shapes (3,)."""
    points = np.concatenate([corners(part) for part in parts])
    return points.min(axis=0), points.max(axis=0)


def _vector(xyz: Array) -> tuple[float, float, float]:
    x, y, z = (round(float(v), 6) + 0.0 for v in xyz)
    return x, y, z
