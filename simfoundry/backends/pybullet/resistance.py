"""Torsional and rolling friction for Bullet, which has one number a link and mixes it with the sliding friction.

A pair of Bullet's resists with the coefficient of each times the sliding friction of the other, summed; the scene's
with the larger of the two. Where a link that resists meets links of one friction only, one number makes that exact.
Where it meets several, the number lies in the middle, and :class:`Resistance` says how far the extremes are off.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import product

from simfoundry.scene.model import Link, Scene, pair_resistance


@dataclass(frozen=True)
class Resistance:
    """What is written for each link by qualified name, and the greatest relative error of a pair."""

    written: dict[str, float]
    error: float


@dataclass(frozen=True)
class _Surface:
    """A link's sliding friction as Bullet holds it, and the scene's resistance [m]."""

    friction: float
    resistance: float


def resistance(scene: Scene, friction: Callable[[Link], float], value: Callable[[Link], float]) -> Resistance:
    """What to write for the resistance ``value`` of each link [m], where it has the sliding ``friction`` in Bullet."""
    if not any(value(link) for item in scene.objects for link in item.links if link.colliders):
        return Resistance({}, 0.0)
    owners: dict[_Surface, set[str]] = {}
    surfaces: dict[str, _Surface] = {}
    for item in scene.objects:
        for link in item.links:
            if link.colliders:
                surface = _Surface(friction(link), value(link))
                surfaces[item.qualified(link.name)] = surface
                owners.setdefault(surface, set()).add(item.name)
    meetings = [(a, b) for a, b in product(owners, owners) if a != b or len(owners[a]) > 1]
    written = {a: _middle(_wanted(a, (b for one, b in meetings if one == a))) for a in owners}
    error = max((_error(a, b, written) for a, b in meetings if a.resistance or b.resistance), default=0.0)
    return Resistance({name: written[surface] for name, surface in surfaces.items()}, error)


def _wanted(a: _Surface, others: Iterable[_Surface]) -> list[float]:
    """What would be exact for ``a`` with each of the others, where both have a share if both resist."""
    if not a.resistance:
        return []
    return [
        pair_resistance(a.resistance, b.resistance) / (b.friction * (2 if b.resistance else 1))
        for b in others
        if b.friction > 0
    ]


def _middle(values: list[float]) -> float:
    """The number whose ratio to the least is that of the greatest to it; 0 of none."""
    return math.sqrt(min(values) * max(values)) if values else 0.0


def _error(a: _Surface, b: _Surface, written: dict[_Surface, float]) -> float:
    """How far Bullet's resistance of a pair is off, relative to the scene's."""
    found = written[a] * b.friction + written[b] * a.friction
    return abs(found / pair_resistance(a.resistance, b.resistance) - 1)
