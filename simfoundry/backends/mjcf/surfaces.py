"""What MuJoCo's geoms feel like, and what a contact of two of them should and would feel like."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from simfoundry.backends.artifact import number, numbers
from simfoundry.backends.mjcf.restitution import solref
from simfoundry.scene.model import (
    Collider,
    JointType,
    Scene,
    SceneObject,
    pair_friction,
    pair_resistance,
    pair_restitution,
)


class Surface(NamedTuple):
    """Friction, restitution, and resistance against spinning and rolling [m]: of a collider, or of a contact."""

    friction: float
    restitution: float
    spinning: float
    rolling: float


class Way(NamedTuple):
    """How a surface is written: with which priority, and as what."""

    priority: int
    surface: Surface


@dataclass(frozen=True)
class Felt:
    """A collision geom: its name, its link's, whether it can never move, and its own surface."""

    geom: str
    link: str
    static: bool
    surface: Surface


def surface_of(collider: Collider) -> Surface:
    """The surface of a collider."""
    return Surface(collider.friction, collider.restitution, collider.torsional_friction, collider.rolling_friction)


def felt(item: SceneObject) -> Iterator[Felt]:
    """The collision geoms of an object, in the order of its links."""
    static_links = {item.root.name} if item.fixed else set()
    by_child = {joint.child: joint for joint in item.joints}
    for link in item.links:
        joint = by_child.get(link.name)
        if joint is not None and joint.type is JointType.FIXED and joint.parent in static_links:
            static_links.add(link.name)
        name, static = item.qualified(link.name), link.name in static_links
        for collider in link.colliders:
            yield Felt(f"{name}.{collider.name}", name, static, surface_of(collider))


def meant(a: Surface, b: Surface) -> Surface:
    """What a contact between two surfaces should feel like."""
    if a == b:
        return a
    return Surface(
        pair_friction(a.friction, b.friction),
        pair_restitution(a.restitution, b.restitution),
        pair_resistance(a.spinning, b.spinning),
        pair_resistance(a.rolling, b.rolling),
    )


def alike(a: Surface, b: Surface) -> bool:
    """Whether MuJoCo feels no difference between two surfaces."""
    same = number(a.friction) == number(b.friction) and a[2:] == b[2:]
    return same and (a.restitution == b.restitution or solref(a.restitution) == solref(b.restitution))


def happens(a: Way, b: Way, contact: Surface) -> bool:
    """Whether MuJoCo makes ``contact`` of two geoms by its own rules.

    That of the higher priority counts alone; of two with equal ones each larger friction, and the mean of the damping.
    """
    if a.priority != b.priority:
        return alike(max(a, b, key=lambda way: way.priority).surface, contact)
    one, other = a.surface, b.surface
    larger = Surface(
        max(one.friction, other.friction),
        contact.restitution,
        max(one.spinning, other.spinning),
        max(one.rolling, other.rolling),
    )
    damped = all(solref(s.restitution) == solref(contact.restitution) for s in (one, other))
    return damped and alike(larger, contact)


def geom_attributes(surface: Surface, resisting: bool) -> dict[str, str]:
    """A geom that feels like ``surface``; ``resisting`` is whether any of the scene resists spinning or rolling."""
    # MuJoCo takes the larger resistance of a pair, so where one counts, the defaults of all others must not.
    spinning, rolling = surface.spinning, surface.rolling
    resistance = f"{number(spinning)} {number(rolling)}" if resisting else "0.005 0.0001"
    attributes = {"friction": f"{number(surface.friction)} {resistance}"}
    if spinning or rolling:
        attributes["condim"] = contact_dimensions(surface)
    if surface.restitution > 0:
        attributes["solref"] = numbers(solref(surface.restitution))
    return attributes


def pair_attributes(surface: Surface) -> dict[str, str]:
    """A ``<pair>`` that feels like ``surface``: pairs take nothing from their geoms."""
    mu, spinning, rolling = number(surface.friction), number(surface.spinning), number(surface.rolling)
    attributes = {"friction": f"{mu} {mu} 0.005 0.0001 0.0001"}
    if surface.spinning or surface.rolling:
        friction = f"{mu} {mu} {spinning} {rolling} {rolling}"
        attributes = {"condim": contact_dimensions(surface), "friction": friction}
    if surface.restitution > 0:
        attributes["solref"] = numbers(solref(surface.restitution))
    return attributes


def contact_dimensions(surface: Surface) -> str:
    """MuJoCo's ``condim`` of a contact that resists sliding, and spinning or rolling as well."""
    return "6" if surface.rolling else "4" if surface.spinning else "3"


def resists(scene: Scene) -> bool:
    """Whether any contact of the scene resists spinning or rolling."""
    colliders = (collider for item in scene.objects for link in item.links for collider in link.colliders)
    return any(collider.torsional_friction or collider.rolling_friction for collider in colliders)
