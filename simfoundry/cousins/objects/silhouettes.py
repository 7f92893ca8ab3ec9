"""Silhouettes of vessels: other forms of cups, bowls and plates, each with a wall of even thickness."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from simfoundry.cousins.objects.components import Component
from simfoundry.cousins.objects.geometry import Edit, Rng, lathe_of, with_profile
from simfoundry.cousins.objects.parts import parts_of
from simfoundry.cousins.objects.profiles import THINNEST, Profile
from simfoundry.geometry.frames import Array
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.base import LatheShape

POINTS = 13
"""Rings of a curved wall: a belly of 10 % of a cup's radius then departs from its chords by less than 0.1 mm."""

FLAT, LOW, WIDE = 0.4, 0.8, 1.4
"""Height over the radius of the rim below which a vessel is a dish, a bowl, or a pot; above it is a cup."""

HEIGHTS, RIMS, WALLS = (0.74, 1.34), (0.84, 1.2), (0.85, 1.35)
"""Factors on the twin's height, rim radius and wall: shops sell cups that differ as much."""

SMALLEST_FOOT = 0.35
"""A foot has at least this share of the rim's radius, or the vessel topples when it is pushed."""

Form = Callable[[Array, Rng], Array]
"""Outer radius between foot (0) and rim (1) at heights between foot (0) and rim (1), shape (k,) to (k,)."""


def reshape(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Another silhouette: of a family that fits a vessel of its height, with sizes, wall and foot of its own."""
    key = lathe_of(spec, component)
    if key is None or len(spec.links) > 1:  # a lid fits the rim that there is
        return None
    shape = parts_of(spec)[key].shape
    assert isinstance(shape, LatheShape)
    old = Profile.of(shape)
    if not old.is_hollow:
        return None
    widest = float(old.outer[:, 0].max())
    height, rim, wall = (v * _factor(rng, r) for v, r in ((old.height, HEIGHTS), (widest, RIMS), (old.thinnest, WALLS)))
    forms = _forms(old.height / widest)
    name = list(forms)[int(rng.integers(len(forms)))]
    share, form = forms[name]
    foot = rim * float(np.clip(rng.uniform(*share), SMALLEST_FOOT, 1.0))
    floor = max((old.height - old.depth) * float(rng.uniform(0.85, 1.2)), wall)
    made = walled(_outside(form, foot, rim, height, rng), max(wall, THINNEST), floor)
    if made is None:
        return None
    words = f"{name}, {height * 1000:.0f} mm high, {2 * rim * 1000:.0f} mm wide"
    return with_profile(spec, key, old, made), words


def _forms(slender: float) -> dict[str, tuple[tuple[float, float], Form]]:
    """The forms of vessels whose height is ``slender`` times the radius of their rim."""
    if slender < FLAT:
        return DISHES
    if slender < LOW:
        return BOWLS
    return {name: CUPS[name] for name in POTS} if slender < WIDE else CUPS


def _factor(rng: Rng, between: tuple[float, float]) -> float:
    return float(np.exp(rng.uniform(*np.log(between))))


def _outside(form: Form, foot: float, rim: float, height: float, rng: Rng) -> Array:
    """Points (radius, height) [m] of an outer wall from foot to rim, shape (k, 2), evenly spaced along it."""
    t = np.linspace(0.0, 1.0, 101)
    wall = np.column_stack([foot + (rim - foot) * form(t, rng), t * height])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(wall, axis=0), axis=1))])
    even = np.linspace(0.0, along[-1], POINTS)
    return np.column_stack([np.interp(even, along, wall[:, k]) for k in range(2)])


def walled(outside: Array, wall: float, floor: float) -> Profile | None:
    """A hollow profile: an outer wall [m], shape (k, 2), from foot to rim, and an inner one ``wall`` [m] away from it.

    The rim is rounded, and the inside ends on a level ``floor`` [m]. None where the wall bends more sharply than its
    thickness allows.
    """
    from shapely.geometry import Polygon

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
    down = (first[1] - floor) / max(float(run[1]), 0.3)  # along the wall down to the floor
    corner = np.array([float(first[0] - run[0] * down), floor])
    rings = np.concatenate([[[0.0, 0.0]], outside, [lip], inside[above][::-1], [corner, [0.0, floor]]])
    if (rings[1:-1, 0] <= 5e-4).any() or not Polygon(rings).is_valid:
        return None
    made = Profile.of(LatheShape.model_validate({"lathe": {"profile": tuple(map(tuple, rings.round(6).tolist()))}}))
    return made if made.is_hollow and made.thinnest > 0.6 * wall else None


def _straight(t: Array, _: Rng) -> Array:
    return t


def _rounded(t: Array, rng: Rng) -> Array:
    """A quarter of an ellipse below, straight above."""
    bend = rng.uniform(0.3, 0.6)
    return np.asarray(np.sqrt(1 - np.clip(1 - t / bend, 0.0, 1.0) ** 2))


def _flared(t: Array, rng: Rng) -> Array:
    return np.asarray(t ** rng.uniform(2.0, 3.5))


def _barrel(t: Array, rng: Rng) -> Array:
    return np.asarray(t + rng.uniform(0.6, 1.4) * np.sin(np.pi * t))


def _tulip(t: Array, rng: Rng) -> Array:
    """Full below, drawn in, and bent out at the rim."""
    return np.asarray(t + rng.uniform(0.5, 0.9) * np.sin(2 * np.pi * t**0.85))


def _waisted(t: Array, rng: Rng) -> Array:
    return np.asarray(t - rng.uniform(0.5, 1.0) * np.sin(np.pi * t))


def _shouldered(t: Array, rng: Rng) -> Array:
    """Two straight walls with a soft step between them."""
    at, soft = rng.uniform(0.3, 0.6), rng.uniform(0.05, 0.1)
    step = 1 / (1 + np.exp(-(t - at) / soft))
    return np.asarray((step - step[0]) / (step[-1] - step[0]))


def _round_bowl(t: Array, rng: Rng) -> Array:
    return np.asarray(np.sqrt(np.clip(1 - (1 - t) ** 2, 0.0, 1.0)) ** rng.uniform(0.8, 1.2))


def _bell(t: Array, rng: Rng) -> Array:
    """Round below, and bent out at the rim."""
    return np.asarray(0.72 * np.sqrt(np.clip(1 - (1 - t) ** 2, 0.0, 1.0)) + 0.28 * t ** rng.uniform(3.0, 6.0))


def _coupe(t: Array, rng: Rng) -> Array:
    return np.asarray(t ** rng.uniform(0.45, 0.65))


def _rimmed(t: Array, rng: Rng) -> Array:
    """A well with a wide rim that rises little."""
    at = rng.uniform(0.5, 0.7)
    well, rim = np.clip(t / at, 0.0, 1.0), np.clip((t - at) / (1 - at), 0.0, 1.0)
    share = rng.uniform(0.35, 0.5)
    return np.asarray(share * well**0.8 + (1 - share) * rim)


def _edged(t: Array, rng: Rng) -> Array:
    """Nearly flat, with an edge that turns up."""
    return np.asarray(np.clip(t / rng.uniform(0.45, 0.6), 0.0, 1.0) ** 0.9)


CUPS: dict[str, tuple[tuple[float, float], Form]] = {
    "straight": ((0.92, 1.0), _straight),
    "tapered": ((0.6, 0.8), _straight),
    "rounded": ((0.45, 0.7), _rounded),
    "flared": ((0.65, 0.8), _flared),
    "barrel-shaped": ((0.82, 0.9), _barrel),
    "tulip-shaped": ((0.78, 0.88), _tulip),
    "waisted": ((0.84, 0.92), _waisted),
    "shouldered": ((0.68, 0.82), _shouldered),
}
"""Forms of cups and mugs by name: the foot as a share of the rim's radius, and how the wall goes between them."""

POTS = ("straight", "tapered", "rounded", "flared", "barrel-shaped")

BOWLS: dict[str, tuple[tuple[float, float], Form]] = {
    "round": ((0.4, 0.6), _round_bowl),
    "conical": ((0.4, 0.6), _straight),
    "upright": ((0.6, 0.8), _rounded),
    "bell-shaped": ((0.42, 0.58), _bell),
    "shouldered": ((0.5, 0.68), _shouldered),
    "steep": ((0.8, 0.95), _straight),
}

DISHES: dict[str, tuple[tuple[float, float], Form]] = {
    "coupe": ((0.5, 0.62), _coupe),
    "rimmed": ((0.5, 0.62), _rimmed),
    "edged": ((0.62, 0.72), _edged),
    "conical": ((0.5, 0.64), _straight),
}
