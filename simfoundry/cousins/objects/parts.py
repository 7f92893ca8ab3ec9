"""Edits of an asset document at the level of parts; every edit returns a new document."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from simfoundry.geometry.frames import Array
from simfoundry.scene.state import pose
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
"""Identifier of a part: the names of its link and of itself."""

Parts = Mapping[Key, PartSpec]


def parts_of(spec: AssetSpec) -> dict[Key, PartSpec]:
    """Return every part of every link."""
    return {(link, name): part for link, body in spec.links.items() for name, part in body.parts.items()}


def with_parts(spec: AssetSpec, parts: Parts) -> AssetSpec:
    """Return the spec with exactly these parts, each in its link, in the given order."""
    links = {
        name: link.model_copy(update={"parts": {p: part for (owner, p), part in parts.items() if owner == name}})
        for name, link in spec.links.items()
    }
    return spec.model_copy(update={"links": links})


def each(spec: AssetSpec, change: Callable[[Key, PartSpec], PartSpec]) -> AssetSpec:
    """Return the spec with ``change`` applied to every part."""
    return with_parts(spec, {key: change(key, part) for key, part in parts_of(spec).items()})


def moved(part: PartSpec, xyz: Array) -> PartSpec:
    """Return the part with its frame at ``xyz`` [m] and its rotation unchanged."""
    return part.model_copy(update={"pose": part.pose.model_copy(update={"xyz": _vector(xyz)})})


def shaped(part: PartSpec, shape: Shape) -> PartSpec:
    """Return the part with another shape."""
    return part.model_copy(update={"shape": shape})


def at(part: PartSpec) -> Array:
    """Position of the part's frame in the link [m], shape (3,)."""
    return np.array(part.pose.xyz)


def aimed(xyz: Array, direction: Array) -> PoseSpec:
    """Pose at ``xyz`` [m] whose z axis points along ``direction``."""
    x, y, z = (float(v) for v in direction)
    pitch, yaw = math.degrees(math.atan2(math.hypot(x, y), z)), math.degrees(math.atan2(y, x))
    if abs(pitch) < 1e-9:
        return PoseSpec(xyz=_vector(xyz))
    return PoseSpec(xyz=_vector(xyz), rpy_deg=(0.0, round(pitch, 4), round(yaw, 4)))


def axis_of(part: PartSpec) -> Array:
    """Unit vector along the part's own z axis in the link's frame, shape (3,)."""
    return pose(part.pose).rotation[:, 2]


def is_level(direction: Array) -> bool:
    """Return whether a direction lies in the x-y plane."""
    return abs(float(direction[2])) < 1e-3


def rod(part: PartSpec) -> tuple[float, float] | None:
    """Radius and length [m] of a cylinder or capsule, excluding caps; None for any other part."""
    match part.shape:
        case CylinderShape():
            return part.shape.cylinder.radius, part.shape.cylinder.height
        case CapsuleShape():
            return part.shape.capsule.radius, part.shape.capsule.height
    return None


def with_rod(part: PartSpec, radius: float, height: float) -> PartSpec:
    """Return a cylinder or capsule with other sizes [m]."""
    kind = CylinderShape if isinstance(part.shape, CylinderShape) else CapsuleShape
    name = "cylinder" if kind is CylinderShape else "capsule"
    return shaped(part, kind.model_validate({name: {"radius": float(radius), "height": float(height)}}))


def corners(part: PartSpec) -> Array:
    """Points on the part's surface in the link's frame [m], shape (k, 3), whose bounds equal or approximate the part's.

    A mesh is represented by its origin only, because its file is not read.
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
    """Lowest and highest corner [m] of the bounding box of parts of one link, shapes (3,)."""
    points = np.concatenate([corners(part) for part in parts])
    return points.min(axis=0), points.max(axis=0)


def _vector(xyz: Array) -> tuple[float, float, float]:
    x, y, z = (round(float(v), 6) + 0.0 for v in xyz)
    return x, y, z


HOLLOW = 0.12
"""Minimum depth of a cavity as a share of the height."""

LEVELS = 5
"""Minimum number of rings of a curved wall; each band between rings becomes convex parts."""

FLAT, LOW, WIDE = 0.4, 0.8, 1.4
"""Upper limits of the ratio of height to rim radius for dishes, bowls and pots; above the last, a vessel is a cup."""

THINNEST = 0.0015
"""Minimum wall thickness [m]."""

KEPT_WALL = 0.6
"""Minimum share of its thickness that a wall keeps when curved: a third less still looks like the same ware."""

FLATTER = (1.0, 0.75, 0.5, 0.25, 0.0)
"""Shares of a curve's deviation from a straight line that are tried in order, the full curve first."""


@dataclass(frozen=True, eq=False)
class Profile:
    """A profile as two chains of (radius, height) [m]: ``outer`` from the axis at the foot up to the rim, shape (k, 2),
    and ``inner`` from the rim down to the axis, shape (m, 2), which for a solid body is its flat or domed top.
    """

    outer: Array
    inner: Array

    @classmethod
    def of(cls, shape: LatheShape) -> Profile:
        """Split the profile of a shape into its chains."""
        rings = np.array(shape.lathe.profile)
        if rings[0, 1] > rings[-1, 1]:
            rings = rings[::-1]
        rim = int(np.flatnonzero(rings[:, 1] >= rings[:, 1].max() - 1e-9)[0])
        return cls(rings[: rim + 1], rings[rim + 1 :])

    @property
    def shape(self) -> LatheShape:
        """Return the profile as a shape of the spec."""
        rings = np.round(np.concatenate([self.outer, self.inner]), 6) + 0.0
        kept = [rings[0], *(b for a, b in pairwise(rings) if np.abs(a - b).max() > 1e-6)]
        return LatheShape.model_validate({"lathe": {"profile": tuple((float(r), float(h)) for r, h in kept)}})

    @property
    def foot(self) -> float:
        """Lowest height [m]."""
        return float(self.outer[:, 1].min())

    @property
    def rim(self) -> float:
        """Greatest height [m]."""
        return float(self.outer[-1, 1])

    @property
    def height(self) -> float:
        """Height from foot to rim [m]."""
        return self.rim - self.foot

    @property
    def depth(self) -> float:
        """Depth from the rim down to the floor on the axis [m]; about 0 for a solid body."""
        return self.rim - float(self.inner[-1, 1]) if len(self.inner) else 0.0

    @property
    def is_hollow(self) -> bool:
        """Return whether the body has a cavity."""
        return self.depth > HOLLOW * self.height and len(self.inner) >= 3

    @property
    def wall(self) -> float:
        """Wall thickness at the rim [m]; 0 for a solid body."""
        return float(self.outer[-1, 0] - self.inner[0, 0]) if self.is_hollow else 0.0

    @property
    def thinnest(self) -> float:
        """Minimum distance from a corner of the inside to the outside [m]; a plate's is not at its rim."""
        a, b = self.outer[:-1], self.outer[1:]
        way = b - a
        points = self.inner[:, None, :] - a
        along = np.einsum("ijk,jk->ij", points, way) / np.einsum("jk,jk->j", way, way)
        apart = points - np.clip(along, 0.0, 1.0)[..., None] * way
        return float(np.linalg.norm(apart, axis=2).min())

    def radius(self, height: Array | float) -> Array:
        """Outer radius [m] at the given heights [m]."""
        rings = self.outer[1:] if len(self.outer) > 1 else self.outer
        order = np.argsort(rings[:, 1], kind="stable")
        return np.asarray(np.interp(height, rings[order, 1], rings[order, 0]))

    def share(self, height: Array) -> Array:
        """Convert heights [m] to shares of the total height, 0 at the foot."""
        return np.asarray((height - self.foot) / self.height)


def finer(profile: Profile, levels: int = LEVELS) -> Profile:
    """Add rings to long walls of the body so that they can bend."""
    gap = profile.height / levels
    return Profile(_finer(profile.outer, gap), _finer(profile.inner, gap) if profile.is_hollow else profile.inner)


def _finer(chain: Array, gap: float) -> Array:
    out = [chain[0]]
    for a, b in pairwise(chain):
        steps = max(1, round(abs(b[1] - a[1]) / gap))
        out += [a + (b - a) * (k / steps) for k in range(1, steps + 1)]
    return np.array(out)


def swelled(profile: Profile, grow: Array, levels: int = LEVELS) -> Profile:
    """Scale the body's outer radius by a smooth curve; the inside moves with the outside.

    ``grow`` are factors at equal steps from the foot to the rim, shape (k,), interpolated linearly. On a wall that
    leans far out, such as a plate's, a curve is a steep step that would thin the wall: there the curve is flattened
    between its ends until the wall keeps :data:`KEPT_WALL` of its thickness.
    """
    straight = np.linspace(grow[0], grow[-1], len(grow))
    made = profile
    for share in FLATTER if len(grow) > 2 else (1.0,):
        made = _swelled(profile, straight + share * (grow - straight), levels)
        if not profile.is_hollow or made.thinnest >= KEPT_WALL * profile.thinnest:
            break
    return made


def _swelled(profile: Profile, grow: Array, levels: int) -> Profile:
    fine = finer(profile, levels) if len(grow) > 2 else profile
    steps = np.linspace(0.0, 1.0, len(grow))
    # The whole section, including the edge that joins its chains, gets a ring wherever a chain or the curve bends. All
    # points at one height then move by the same distance, inside and outside, so edges that did not cross before cannot
    # cross afterwards.
    bends = {*fine.outer[:, 1], *fine.inner[:, 1], *(fine.foot + steps * fine.height)} if fine.is_hollow else ()
    inner = np.concatenate([fine.outer[-1:], fine.inner])
    outer = fine.outer
    for height in sorted(bends):
        outer, inner = _ring_at(outer, height), _ring_at(inner, height)
    fine = Profile(outer, inner[1:])

    def delta(heights: Array) -> Array:
        return fine.radius(heights) * (np.interp(fine.share(heights), steps, grow) - 1.0)

    return _shifted(fine, delta(fine.outer[:, 1]), delta(fine.inner[:, 1]))


def flared(profile: Profile, out: float, band: float) -> Profile:
    """Bend the rim outward by ``out`` [m] over the topmost ``band`` [m]."""
    at = profile.rim - band

    def delta(heights: Array) -> Array:
        return out * np.clip((heights - at) / band, 0.0, 1.0) ** 2

    outer, inner = _ring_at(profile.outer, at), _ring_at(profile.inner, at)
    made = Profile(outer, inner)
    return _shifted(made, delta(outer[:, 1]), delta(inner[:, 1]))


def thickened(profile: Profile, more: float) -> Profile:
    """Thicken the wall and the floor inward by ``more`` [m], or thin them; a wall keeps :data:`THINNEST`."""
    more = max(more, THINNEST - profile.wall)
    inner = profile.inner.copy()
    on_wall = inner[:, 0] > 0
    inner[on_wall, 0] = np.maximum(inner[on_wall, 0] - more, 1e-4)
    floor = inner[:, 1] < profile.rim - 1e-9
    inner[floor, 1] = np.minimum(inner[floor, 1] + more, profile.rim - THINNEST)
    return Profile(profile.outer, inner)


def raised_foot(profile: Profile, up: float, inset: float) -> Profile:
    """Raise the body by ``up`` [m] onto a narrower ring foot, ``inset`` [m] inside its old foot."""
    base = float(profile.outer[1, 0])
    radius = base - inset
    lift = np.array([0.0, up])
    foot = np.array([[0.0, profile.foot], [radius, profile.foot], [radius, profile.foot + up]])
    return Profile(np.concatenate([foot, profile.outer[1:] + lift]), profile.inner + lift)


def _shifted(profile: Profile, outer: Array, inner: Array) -> Profile:
    """Shift radii by the given amounts [m]; points on the axis stay there."""

    def chain(points: Array, by: Array) -> Array:
        moved = points.copy()
        off = points[:, 0] > 0
        moved[off, 0] = np.maximum(points[off, 0] + by[off], 5e-4)
        return moved

    return Profile(chain(profile.outer, outer), chain(profile.inner, inner))


def _ring_at(chain: Array, height: float) -> Array:
    """Return the chain with a ring inserted where it passes through a height [m]."""
    out = [chain[0]]
    for a, b in pairwise(chain):
        if min(a[1], b[1]) + 1e-6 < height < max(a[1], b[1]) - 1e-6:
            out.append(a + (b - a) * ((height - a[1]) / (b[1] - a[1])))
        out.append(b)
    return np.array(out)
