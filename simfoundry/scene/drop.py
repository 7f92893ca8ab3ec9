"""Drop an object straight down, or lift it straight up out of what it overlaps, onto what it then rests on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from simfoundry.geometry.hulls import Hulls
from simfoundry.geometry.vertical_contact import heights
from simfoundry.scene.place import CLEARANCE

# Depth [m] of an overlap that counts as touching: five times the clearance of placed objects, well above rounding.
TOUCHING = 5 * CLEARANCE


@dataclass(frozen=True)
class DropResult:
    """Resting place of an object that is dropped.

    Attributes:
        lift: The distance [m] by which the object moves up to rest just above its support; negative if it falls.
        support: The name of the object that it rests on.
        part: The index of the convex part of the support below it, in the support's :class:`Hulls`.
    """

    lift: float
    support: str
    part: int


def drop_onto(held: Hulls, others: Mapping[str, Hulls]) -> DropResult | None:
    """Return where an object comes to rest, or None if there is nothing below it.

    An object that overlaps others is lifted until it is free; any other object falls.

    Args:
        held: The posed shape of the object.
        others: The posed shapes of all objects that it may rest on, by name.
    """
    found = sorted(_obstacles(held, others), key=lambda o: o.low)
    lift, on = 0.0, None
    for each in found:  # by increasing lower end, so that one pass finds the end of the overlap that contains zero
        if each.low < lift - TOUCHING and each.high > lift + TOUCHING:
            lift, on = each.high, each
    if on is None:
        below = [each for each in found if each.high <= TOUCHING]
        if not below:
            return None
        on = max(below, key=lambda each: each.high)
    return DropResult(on.high + CLEARANCE, on.name, on.part)


@dataclass(frozen=True)
class _Obstacle:
    """A convex part with which an object overlaps if it is lifted by ``low`` to ``high`` [m]."""

    low: float
    high: float
    name: str
    part: int


def _obstacles(held: Hulls, others: Mapping[str, Hulls]) -> Iterator[_Obstacle]:
    low, high = held.bounds()
    flipped = held.flipped()
    for name, shape in others.items():
        least, most = shape.bounds()
        if (most[:2] < low[:2]).any() or (least[:2] > high[:2]).any():
            continue
        touching, leaving = heights(held, shape), -heights(flipped, shape.flipped())
        for part in np.flatnonzero(np.isfinite(touching).any(axis=0)).tolist():
            met = np.isfinite(touching[:, part])
            for bottom, top in zip(leaving[met, part].tolist(), touching[met, part].tolist(), strict=True):
                yield _Obstacle(bottom, top, name, part)
