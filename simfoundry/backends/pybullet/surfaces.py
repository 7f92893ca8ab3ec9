"""Surfaces in Bullet: one friction, one restitution and one resistance per link, for all of its colliders.

Bullet multiplies the friction and restitution of two bodies; each link therefore has the square root of its own value,
which gives a pair the geometric mean.

For spinning and rolling, Bullet's resistance of a pair is the sum of each link's coefficient times the sliding friction
of the other link; the scene uses the larger of the two. If a resisting link only meets links with one friction, a
single number is exact. If it meets several, a middle value is used, and :class:`Resistance` states the error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import product

from simfoundry.backends.artifact import rounded
from simfoundry.scene.model import Link, Scene, SceneObject, pair_resistance


@dataclass(frozen=True)
class Resistance:
    """The value written for each link by qualified name, and the largest relative error of any pair."""

    written: dict[str, float]
    error: float


Resistances = dict[str, Resistance]
"""The resistance to spinning and rolling, by the field of a collider."""


@dataclass(frozen=True)
class _BulletSurface:
    """The sliding friction of a link as Bullet stores it, and the scene's resistance [m]."""

    friction: float
    resistance: float


def link_friction(link: Link) -> float:
    """Return the friction coefficient that represents all colliders of a link: their geometric mean."""
    return _geometric_mean([collider.friction for collider in link.colliders])


def link_restitution(link: Link) -> float:
    """Return the restitution that represents all colliders of a link: their geometric mean."""
    return _geometric_mean([collider.restitution for collider in link.colliders])


def _geometric_mean(values: list[float]) -> float:
    if not values or min(values) <= 0:
        return 0.0
    return values[0] if len(set(values)) == 1 else math.exp(math.fsum(map(math.log, values)) / len(values))


def robot_friction(link: Link, scene: Scene) -> float:
    """Return Bullet's friction for a link of a converted robot, so that its grip matches MuJoCo.

    MuJoCo uses the larger of the two frictions; Bullet multiplies this value by the square root of the object's. The
    result is exact if all objects have the same friction, and a middle value if they do not.
    """
    own = link_friction(link)
    met = {link_friction(k) for item in scene.objects for k in item.links if k.colliders} - {0.0}
    wanted = [max(own, other) / math.sqrt(other) for other in met]
    return math.sqrt(min(wanted) * max(wanted)) if own and wanted else math.sqrt(own)


def surface_data(item: SceneObject, link: Link, resistances: Resistances) -> dict[str, float]:
    """Return the arguments of ``changeDynamics`` for a link."""
    surface = {
        "lateral_friction": rounded(math.sqrt(link_friction(link))),
        "restitution": rounded(math.sqrt(link_restitution(link))),
    }
    for field, found in resistances.items():  # Bullet calls torsional friction spinning friction
        if value := found.written.get(item.qualified(link.name)):
            surface[field.replace("torsional", "spinning")] = rounded(value)
    return surface


def scene_resistances(scene: Scene) -> Resistances:
    """Return the resistance to spinning and rolling of all links of a scene."""

    def of(field: str) -> Resistance:
        return _resistance(scene, lambda link: max(getattr(c, field) for c in link.colliders))

    return {field: of(field) for field in ("torsional_friction", "rolling_friction")}


def _resistance(scene: Scene, value: Callable[[Link], float]) -> Resistance:
    """Return the values to write for the resistance ``value`` of each link [m]."""
    links = [(item, link) for item in scene.objects for link in item.links if link.colliders]
    if not any(value(link) for _, link in links):
        return Resistance({}, 0.0)
    owners: dict[_BulletSurface, set[str]] = {}
    surfaces: dict[str, _BulletSurface] = {}
    for item, link in links:
        surface = _BulletSurface(math.sqrt(link_friction(link)), value(link))
        surfaces[item.qualified(link.name)] = surface
        owners.setdefault(surface, set()).add(item.name)
    meetings = [(a, b) for a, b in product(owners, owners) if a != b or len(owners[a]) > 1]
    written = {a: _middle(_exact_values(a, (b for one, b in meetings if one == a))) for a in owners}
    error = max((_error(a, b, written) for a, b in meetings if a.resistance or b.resistance), default=0.0)
    return Resistance({name: written[surface] for name, surface in surfaces.items()}, error)


def _exact_values(a: _BulletSurface, others: Iterable[_BulletSurface]) -> list[float]:
    """Return the value that is exact for ``a`` with each of the others; if both resist, each contributes its share."""
    if not a.resistance:
        return []
    return [
        pair_resistance(a.resistance, b.resistance) / (b.friction * (2 if b.resistance else 1))
        for b in others
        if b.friction > 0
    ]


def _middle(values: list[float]) -> float:
    """Return the geometric middle of the smallest and the largest value, 0 if there are none."""
    return math.sqrt(min(values) * max(values)) if values else 0.0


def _error(a: _BulletSurface, b: _BulletSurface, written: dict[_BulletSurface, float]) -> float:
    """Return the relative error of Bullet's resistance for a pair."""
    found = written[a] * b.friction + written[b] * a.friction
    return abs(found / pair_resistance(a.resistance, b.resistance) - 1)
