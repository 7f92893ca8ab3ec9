"""Which MuJoCo geoms touch, and how: pairs where two surfaces differ, links that do not touch, restitution."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, product

from simfoundry.backends.artifact import Fidelity, Loss, number, numbers
from simfoundry.scene.model import (
    JointType,
    Scene,
    SceneObject,
    pair_friction,
    pair_resistance,
    pair_restitution,
)
from simfoundry.scene.touching import silent_pairs

_CONTACT_TIME = 0.02
"""Time constant of a contact [s]: MuJoCo's own default. At 0.008 a bowl that falls by 2 cm sinks 1.5 mm into a table,
not 4, but below 0.012 a can on its side rolls away."""

CRITICAL_REBOUND = math.exp(-2)
"""Restitution of a critically damped contact."""


@dataclass(frozen=True)
class _Surface:
    """A collision geom: its name, its link's, its object's, whether it can never move, and what it feels like.

    ``material`` is friction and restitution, ``resistance`` torsional and rolling friction [m].
    """

    geom: str
    link: str
    owner: str
    static: bool
    material: tuple[float, float]
    resistance: tuple[float, float]


def add_contacts(root: ET.Element, scene: Scene) -> None:
    """Add ``<contact>``: the pairs whose surfaces differ, and those of links that do not touch."""
    contact = ET.SubElement(root, "contact")
    silent = [(o.qualified(a), o.qualified(b)) for o in scene.objects for a, b in silent_pairs(o)]
    silent += scene.no_contact
    for a, b in silent:
        ET.SubElement(contact, "exclude", body1=a, body2=b)
    unheard = {frozenset(pair) for pair in silent}
    by_material: dict[tuple[float, float], list[_Surface]] = {}
    for item in scene.objects:
        for surface in _surfaces(item):
            by_material.setdefault(surface.material, []).append(surface)
    for (material_a, group_a), (material_b, group_b) in combinations(by_material.items(), 2):
        mu = number(pair_friction(material_a[0], material_b[0]))
        restitution = pair_restitution(material_a[1], material_b[1])
        bounce = {"solref": numbers(solref(restitution))} if restitution > 0 else {}
        for one, other in product(group_a, group_b):
            if one.link == other.link or (one.static and other.static):
                continue
            if not unheard or frozenset((one.link, other.link)) not in unheard:
                attributes = _resistance(mu, one, other) | bounce
                ET.SubElement(contact, "pair", {"geom1": one.geom, "geom2": other.geom} | attributes)


def _resistance(mu: str, a: _Surface, b: _Surface) -> dict[str, str]:
    """Friction of an explicit pair, against sliding, spinning and rolling: explicit pairs take nothing from geoms."""
    spinning, rolling = (pair_resistance(*values) for values in zip(a.resistance, b.resistance, strict=True))
    if not spinning and not rolling:
        return {"friction": f"{mu} {mu} 0.005 0.0001 0.0001"}
    friction = f"{mu} {mu} {number(spinning)} {number(rolling)} {number(rolling)}"
    return {"condim": contact_dimensions(spinning, rolling), "friction": friction}


def contact_dimensions(spinning: float, rolling: float) -> str:
    """MuJoCo's ``condim`` of a contact that resists sliding, and spinning or rolling as well [m]."""
    return "6" if rolling else "4" if spinning else "3"


def resists(scene: Scene) -> bool:
    """Whether any contact of the scene resists spinning or rolling."""
    colliders = (collider for item in scene.objects for link in item.links for collider in link.colliders)
    return any(collider.torsional_friction or collider.rolling_friction for collider in colliders)


def _surfaces(item: SceneObject) -> Iterator[_Surface]:
    static_links = {item.root.name} if item.fixed else set()
    by_child = {joint.child: joint for joint in item.joints}
    for link in item.links:
        joint = by_child.get(link.name)
        if joint is not None and joint.type is JointType.FIXED and joint.parent in static_links:
            static_links.add(link.name)
        for collider in link.colliders:
            yield _Surface(
                geom=f"{item.qualified(link.name)}.{collider.name}",
                link=item.qualified(link.name),
                owner=item.name,
                static=link.name in static_links,
                material=(collider.friction, collider.restitution),
                resistance=(collider.torsional_friction, collider.rolling_friction),
            )


def solref(restitution: float) -> tuple[float, float]:
    """MuJoCo's time constant [s] and damping ratio of a contact that rebounds at ``restitution``.

    The stiffness is that of MuJoCo's default contact; only the damping follows the restitution.
    """
    ratio = damping_ratio(restitution)
    return _CONTACT_TIME / ratio, ratio


@lru_cache(maxsize=256)
def damping_ratio(restitution: float) -> float:
    """Damping ratio of a spring and damper that only push and rebound at ``restitution``.

    The bodies part when the force, not the depth, reaches zero (Schwager and Poeschel, Granular Matter 9, 2007), so
    critical damping still rebounds at exp(-2): less than that is out of reach and gets ratio 1.
    """
    if restitution <= CRITICAL_REBOUND:
        return 1.0
    low, high = 1e-3, 1.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if rebound(middle) > restitution else (low, middle)
    return (low + high) / 2


def rebound(ratio: float) -> float:
    """Restitution of a spring and damper of a damping ratio below 1 that only push."""
    root = math.sqrt(1 - ratio * ratio)
    return math.exp(-ratio / root * math.atan2(2 * ratio * root, 2 * ratio * ratio - 1))


def restitution_losses(scene: Scene) -> tuple[Loss, ...]:
    """One loss for each object that bounces, and one for all that should not and do a little."""
    reason = "MuJoCo has no restitution: a contact is damped to rebound within 0.03 of it, but never below 0.14"
    bouncing = {o.name: [c.restitution for link in o.links for c in link.colliders] for o in scene.objects}
    losses = [Loss(f"{name}.restitution", Fidelity.APPROXIMATED, reason) for name, es in bouncing.items() if any(es)]
    if any(e == 0 for es in bouncing.values() for e in es):
        still = "MuJoCo's soft contacts rebound with 0.10 to 0.14 of the speed of impact where the scene says 0"
        losses.append(Loss("restitution", Fidelity.APPROXIMATED, still))
    return tuple(losses)
