"""Edit the profiles of solids of revolution, and create vessels with walls of uniform thickness."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from simfoundry.geometry.frames import Array
from simfoundry.spec.models.shapes import LatheShape

Rng = np.random.Generator

# Minimum depth of a cavity as a fraction of the height.
HOLLOW = 0.12

# Minimum number of bands in a curved wall; each band is split into convex parts.
LEVELS = 5

# Maximum ratios of height to rim radius for dishes, bowls and pots. Taller vessels are cups.
FLAT, LOW, WIDE = 0.4, 0.8, 1.4

# Minimum wall thickness [m].
THINNEST = 0.0015

# Minimum fraction of a wall's thickness that must remain after the wall is curved. A wall that is a third thinner still
# looks plausible.
KEPT_WALL = 0.6

# Fractions of a curve's deviation from a straight line to try, in this order.
FLATTER = (1.0, 0.75, 0.5, 0.25, 0.0)


@dataclass(frozen=True, eq=False)
class Profile:
    """The profile of a solid of revolution as two chains of points (radius, height) [m].

    ``outer`` is an array of shape (k, 2) that runs from the axis at the foot up to the rim. ``inner`` is an array of
    shape (m, 2) that runs from the rim down to the axis. For a solid body, ``inner`` is the flat or domed top.
    """

    outer: Array
    inner: Array

    @classmethod
    def of(cls, shape: LatheShape) -> Profile:
        """Split the profile of a shape into its two chains."""
        rings = np.array(shape.lathe.profile)
        if rings[0, 1] > rings[-1, 1]:
            rings = rings[::-1]
        rim = int(np.flatnonzero(rings[:, 1] >= rings[:, 1].max() - 1e-9)[0])
        return cls(rings[: rim + 1], rings[rim + 1 :])

    @property
    def shape(self) -> LatheShape:
        """The shape for an asset document that has this profile."""
        rings = np.round(np.concatenate([self.outer, self.inner]), 6) + 0.0
        kept = [rings[0], *(b for a, b in pairwise(rings) if np.abs(a - b).max() > 1e-6)]
        return LatheShape.model_validate({"lathe": {"profile": tuple((float(r), float(h)) for r, h in kept)}})

    @property
    def foot(self) -> float:
        """The height of the lowest point [m]."""
        return float(self.outer[:, 1].min())

    @property
    def rim(self) -> float:
        """The height of the rim [m]."""
        return float(self.outer[-1, 1])

    @property
    def height(self) -> float:
        """The height from the foot to the rim [m]."""
        return self.rim - self.foot

    @property
    def depth(self) -> float:
        """The depth of the cavity on the axis, measured from the rim down to the floor [m].

        The depth of a solid body is about 0.
        """
        return self.rim - float(self.inner[-1, 1]) if len(self.inner) else 0.0

    @property
    def is_hollow(self) -> bool:
        """True if the body has a cavity."""
        return self.depth > HOLLOW * self.height and len(self.inner) >= 3

    @property
    def wall(self) -> float:
        """The wall thickness at the rim [m].

        The thickness of a solid body is 0.
        """
        return float(self.outer[-1, 0] - self.inner[0, 0]) if self.is_hollow else 0.0

    @property
    def thinnest(self) -> float:
        """The minimum distance from a corner of the inner chain to the outer chain [m].

        This distance can be less than the thickness at the rim, for example for a plate.
        """
        a, b = self.outer[:-1], self.outer[1:]
        way = b - a
        points = self.inner[:, None, :] - a
        along = np.einsum("ijk,jk->ij", points, way) / np.einsum("jk,jk->j", way, way)
        apart = points - np.clip(along, 0.0, 1.0)[..., None] * way
        return float(np.linalg.norm(apart, axis=2).min())

    def radius(self, height: Array | float) -> Array:
        """Return the outer radius [m] at the given heights [m]."""
        rings = self.outer[1:] if len(self.outer) > 1 else self.outer
        order = np.argsort(rings[:, 1], kind="stable")
        return np.asarray(np.interp(height, rings[order, 1], rings[order, 0]))


def _finer(chain: Array, gap: float) -> Array:
    out = [chain[0]]
    for a, b in pairwise(chain):
        steps = max(1, round(abs(b[1] - a[1]) / gap))
        out += [a + (b - a) * (k / steps) for k in range(1, steps + 1)]
    return np.array(out)


def swelled(profile: Profile, grow: Array) -> Profile:
    """Scale the outer radius of a body by a curve, and move the inner surface along with the outer surface.

    Curving an almost horizontal wall, such as that of a plate, makes it thinner. If necessary, the curve is flattened
    until at least the fraction :data:`KEPT_WALL` of the thickness remains.

    Args:
        profile: The profile.
        grow: Factors at equal steps from the foot to the rim, shape (k,). The values in between are interpolated
            linearly.
    """
    straight = np.linspace(grow[0], grow[-1], len(grow))
    made = profile
    for share in FLATTER if len(grow) > 2 else (1.0,):
        made = _swelled(profile, straight + share * (grow - straight))
        if not profile.is_hollow or made.thinnest >= KEPT_WALL * profile.thinnest:
            break
    return made


def _swelled(profile: Profile, grow: Array) -> Profile:
    fine, gap = profile, profile.height / LEVELS
    if len(grow) > 2:  # long walls need more rings to bend
        fine = Profile(_finer(fine.outer, gap), _finer(fine.inner, gap) if fine.is_hollow else fine.inner)
    steps = np.linspace(0.0, 1.0, len(grow))
    # Add a ring to both chains, including the edge that connects them, wherever a chain or the curve bends. All points
    # at the same height then move by the same distance, so edges that do not cross before cannot cross afterward.
    bends = {*fine.outer[:, 1], *fine.inner[:, 1], *(fine.foot + steps * fine.height)} if fine.is_hollow else ()
    inner = np.concatenate([fine.outer[-1:], fine.inner])
    outer = fine.outer
    for height in sorted(bends):
        outer, inner = _ring_at(outer, height), _ring_at(inner, height)
    fine = Profile(outer, inner[1:])

    def delta(heights: Array) -> Array:
        shares = (heights - fine.foot) / fine.height
        return fine.radius(heights) * (np.interp(shares, steps, grow) - 1.0)

    return _shifted(fine, delta)


def flared(profile: Profile, out: float, band: float) -> Profile:
    """Bend the rim outward by ``out`` [m], starting ``band`` [m] below it."""
    at = profile.rim - band

    def delta(heights: Array) -> Array:
        return out * np.clip((heights - at) / band, 0.0, 1.0) ** 2

    made = Profile(_ring_at(profile.outer, at), _ring_at(profile.inner, at))
    return _shifted(made, delta)


def thickened(profile: Profile, more: float) -> Profile:
    """Make the wall and the floor thicker by ``more`` [m], which may be negative.

    Material is added or removed on the inside. The wall never becomes thinner than :data:`THINNEST`.
    """
    more = max(more, THINNEST - profile.wall)
    inner = profile.inner.copy()
    on_wall = inner[:, 0] > 0
    inner[on_wall, 0] = np.maximum(inner[on_wall, 0] - more, 1e-4)
    floor = inner[:, 1] < profile.rim - 1e-9
    inner[floor, 1] = np.minimum(inner[floor, 1] + more, profile.rim - THINNEST)
    return Profile(profile.outer, inner)


def raised_foot(profile: Profile, up: float, inset: float) -> Profile:
    """Raise the body by ``up`` [m] and add a ring foot whose radius is ``inset`` [m] smaller than the old one."""
    radius = float(profile.outer[1, 0]) - inset
    lift = np.array([0.0, up])
    foot = np.array([[0.0, profile.foot], [radius, profile.foot], [radius, profile.foot + up]])
    return Profile(np.concatenate([foot, profile.outer[1:] + lift]), profile.inner + lift)


def _shifted(profile: Profile, delta: Callable[[Array], Array]) -> Profile:
    """Shift the radii of a chain by ``delta`` [m], a function of the height [m].

    Points on the axis do not move.
    """
    chains = profile.outer.copy(), profile.inner.copy()
    for chain in chains:
        by, off = delta(chain[:, 1]), chain[:, 0] > 0
        chain[off, 0] = np.maximum(chain[off, 0] + by[off], 5e-4)
    return Profile(*chains)


def _ring_at(chain: Array, height: float) -> Array:
    """Return the chain with a point inserted wherever it crosses the given height [m]."""
    out = [chain[0]]
    for a, b in pairwise(chain):
        if min(a[1], b[1]) + 1e-6 < height < max(a[1], b[1]) - 1e-6:
            out.append(a + (b - a) * ((height - a[1]) / (b[1] - a[1])))
        out.append(b)
    return np.array(out)


# -- silhouettes -------------------------------------------------------------------------------------------------------

# Number of rings in a curved wall. For a bulge of 10% of a cup's radius, the error is then less than 0.1 mm.
POINTS = 13

# Normalized profile: a function that maps heights from 0 (foot) to 1 (rim), shape (k,), to outer radii that are scaled
# so that the foot is 0 and the rim is 1, shape (k,).
Form = Callable[[Array, Rng], Array]

# Forms by name: range of the foot radius as a fraction of the rim radius, and the normalized profile.
Forms = dict[str, tuple[tuple[float, float], Form]]


def forms_of(slender: float) -> Forms:
    """Return the possible forms for vessels whose height is ``slender`` times their rim radius."""
    if slender < FLAT:
        return DISHES
    if slender < LOW:
        return BOWLS
    return {name: CUPS[name] for name in POTS} if slender < WIDE else CUPS


def outside(form: Form, foot: float, rim: float, height: float, rng: Rng) -> Array:
    """Return evenly spaced points (radius, height) on an outer wall from foot to rim [m].

    Args:
        form: Normalized profile.
        foot: Foot radius [m].
        rim: Rim radius [m].
        height: Height of the rim above the foot [m].
        rng: Random generator for the form.

    Returns:
        Array of shape (POINTS, 2).
    """
    t = np.linspace(0.0, 1.0, 101)
    return resampled(np.column_stack([foot + (rim - foot) * form(t, rng), t * height]), POINTS)


def arc_lengths(chain: Array) -> Array:
    """Return the distance of each point on a chain from the first point, measured along the chain [m]."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(chain, axis=0), axis=1))])


def resampled(chain: Array, count: int, margin: float = 0.0) -> Array:
    """Return evenly spaced points on a chain, as an array of shape (count, d).

    A ``margin`` [m] is left free at both ends.
    """
    along = arc_lengths(chain)
    even = np.linspace(margin, along[-1] - margin, count)
    return np.column_stack([np.interp(even, along, values) for values in chain.T])


def walled(outside: Array, wall: float, floor: float) -> Profile | None:
    """Return a hollow profile with a rounded rim and a level floor.

    Args:
        outside: Outer wall from foot to rim [m], shape (k, 2).
        wall: Wall thickness [m]. Values below :data:`THINNEST` are increased to that thickness.
        floor: Height of the inner floor [m].

    Returns:
        The profile, or None if the wall bends too sharply for its thickness.
    """
    from shapely.geometry import Polygon

    wall = max(wall, THINNEST)
    tangent = np.gradient(outside, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    inward = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    inside = outside + wall * inward
    lip = (outside[-1] + inside[-1]) / 2 + 0.4 * wall * tangent[-1]
    above = np.flatnonzero(inside[:, 1] > floor + 0.3 * wall)
    if len(above) < 2 or (np.diff(above) > 1).any():
        return None
    first = inside[above[0]]
    run = tangent[above[0]]
    down = (first[1] - floor) / max(float(run[1]), 0.3)  # follow the wall down to the floor
    corner = np.array([float(first[0] - run[0] * down), floor])
    rings = np.concatenate([[[0.0, 0.0]], outside, [lip], inside[above][::-1], [corner, [0.0, floor]]])
    if (rings[1:-1, 0] <= 5e-4).any() or not Polygon(rings).is_valid:
        return None
    made = Profile.of(LatheShape.model_validate({"lathe": {"profile": tuple(map(tuple, rings.round(6).tolist()))}}))
    return made if made.is_hollow and made.thinnest > 0.6 * wall else None


def _straight(t: Array, _: Rng) -> Array:
    return t


def _rounded(t: Array, rng: Rng) -> Array:
    """Return an outline that is a quarter ellipse at the bottom and straight above."""
    bend = rng.uniform(0.3, 0.6)
    return np.asarray(np.sqrt(1 - np.clip(1 - t / bend, 0.0, 1.0) ** 2))


def _shouldered(t: Array, rng: Rng) -> Array:
    """Return an outline of two straight walls with a smooth step between them."""
    at, soft = rng.uniform(0.3, 0.6), rng.uniform(0.05, 0.1)
    step = 1 / (1 + np.exp(-(t - at) / soft))
    return np.asarray((step - step[0]) / (step[-1] - step[0]))


def _rimmed(t: Array, rng: Rng) -> Array:
    """Return the outline of a well with a wide, slightly rising rim."""
    at = rng.uniform(0.5, 0.7)
    well, rim = np.clip(t / at, 0.0, 1.0), np.clip((t - at) / (1 - at), 0.0, 1.0)
    share = rng.uniform(0.35, 0.5)
    return np.asarray(share * well**0.8 + (1 - share) * rim)


def _quarter(t: Array) -> Array:
    """Return a quarter circle."""
    return np.asarray(np.sqrt(np.clip(1 - (1 - t) ** 2, 0.0, 1.0)))


CUPS: Forms = {
    "straight": ((0.92, 1.0), _straight),
    "tapered": ((0.6, 0.8), _straight),
    "rounded": ((0.45, 0.7), _rounded),
    "flared": ((0.65, 0.8), lambda t, rng: t ** rng.uniform(2.0, 3.5)),
    "barrel-shaped": ((0.82, 0.9), lambda t, rng: t + rng.uniform(0.6, 1.4) * np.sin(np.pi * t)),
    # Wide at the bottom, narrower in the middle, and flared at the rim.
    "tulip-shaped": ((0.78, 0.88), lambda t, rng: t + rng.uniform(0.5, 0.9) * np.sin(2 * np.pi * t**0.85)),
    "waisted": ((0.84, 0.92), lambda t, rng: t - rng.uniform(0.5, 1.0) * np.sin(np.pi * t)),
    "shouldered": ((0.68, 0.82), _shouldered),
}
POTS = ("straight", "tapered", "rounded", "flared", "barrel-shaped")
BOWLS: Forms = {
    "round": ((0.4, 0.6), lambda t, rng: _quarter(t) ** rng.uniform(0.8, 1.2)),
    "conical": ((0.4, 0.6), _straight),
    "upright": ((0.6, 0.8), _rounded),
    "bell-shaped": ((0.42, 0.58), lambda t, rng: 0.72 * _quarter(t) + 0.28 * t ** rng.uniform(3.0, 6.0)),
    "shouldered": ((0.5, 0.68), _shouldered),
    "steep": ((0.8, 0.95), _straight),
}
DISHES: Forms = {
    "coupe": ((0.5, 0.62), lambda t, rng: t ** rng.uniform(0.45, 0.65)),
    "rimmed": ((0.5, 0.62), _rimmed),
    # Nearly flat, with an upturned edge.
    "edged": ((0.62, 0.72), lambda t, rng: np.clip(t / rng.uniform(0.45, 0.6), 0.0, 1.0) ** 0.9),
    "conical": ((0.5, 0.64), _straight),
}
