"""Conversion of materials to MJCF default classes, and the collision geoms, excluded pairs and losses of a scene."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence

from simfoundry.backends.artifact import number, numbers
from simfoundry.backends.features import Loss, approximate, combination_reason
from simfoundry.backends.mjcf import contact_rules as rules
from simfoundry.backends.mjcf.contact_rules import ContactGeom, ContactSurface, UnlikeGroup
from simfoundry.scene.kinematics import excluded_link_pairs, weld_groups
from simfoundry.scene.model import Collider, Scene, SceneObject

# The default class for collision geoms, which is the parent of all material classes, and the class for visual geoms.
COLLISION, VISUAL = "collision", "visual"

# The geom group that cameras render. Colliders that are not visual are in group 3, which MuJoCo's viewer hides.
VISUAL_GROUP = "2"

_RESERVED = ("main", COLLISION, VISUAL)


class MaterialClasses:
    """The default class for each material. Geoms whose surface differs from their material override its values."""

    def __init__(self, scene: Scene) -> None:
        self._surfaces: dict[str, ContactSurface] = {}
        for collider in _colliders(scene):
            if collider.material:
                self._surfaces.setdefault(_class_name(collider.material), surface_of(collider))

    def add_defaults(self, collision: ET.Element) -> None:
        """Add the material classes as children of the class for collision geoms."""
        for name, surface in self._surfaces.items():
            ET.SubElement(ET.SubElement(collision, "default", {"class": name}), "geom", surface_attributes(surface))

    def attributes(self, collider: Collider) -> dict[str, str]:
        """Return a collider's class attribute, and its surface attributes if they differ from those of the class."""
        surface, name = surface_of(collider), _class_name(collider.material)
        own = self._surfaces.get(name)
        if own is None:
            return {"class": COLLISION} | surface_attributes(surface)
        return {"class": name} | ({} if own == surface else surface_attributes(surface, own))


def _colliders(scene: Scene) -> Iterator[Collider]:
    return (collider for item in scene.objects for link in item.links for collider in link.colliders)


def _class_name(material: str) -> str:
    return f"{material}_material" if material in _RESERVED else material or COLLISION


def surface_of(collider: Collider) -> ContactSurface:
    """Return the surface of a collider."""
    return ContactSurface(
        collider.friction, collider.restitution, collider.torsional_friction, collider.rolling_friction
    )


def surface_attributes(surface: ContactSurface, inherited: ContactSurface | None = None) -> dict[str, str]:
    """Return the attributes of a geom with the given surface whose class has the ``inherited`` surface.

    The restitution is stored in ``user``, which MuJoCo keeps but does not use, and ``solref`` approximates the
    restitution as closely as possible.
    """
    spinning, rolling = surface.spinning, surface.rolling
    resists = spinning or rolling or (inherited is not None and (inherited.spinning or inherited.rolling))
    attributes = {"friction": numbers([surface.friction, spinning, rolling]) if resists else number(surface.friction)}
    if resists:
        attributes["condim"] = str(rules.contact_dimensions(surface))
    if surface.restitution > 0 or (inherited is not None and inherited.restitution > 0):
        attributes |= {"solref": numbers(rules.solref(surface.restitution)), "user": number(surface.restitution)}
    return attributes


def resists_rolling(scene: Scene) -> bool:
    """Return true if any collider in the scene resists spinning or rolling."""
    return any(collider.torsional_friction or collider.rolling_friction for collider in _colliders(scene))


def contact_geoms(scene: Scene) -> list[ContactGeom]:
    """Return the collision geoms of a scene in link order."""
    return [geom for item in scene.objects for geom in object_geoms(item)]


def object_geoms(item: SceneObject) -> Iterator[ContactGeom]:
    """Yield the collision geoms of an object in link order."""
    welded = weld_groups(item)
    for link in item.links:
        body, static = item.qualified(link.name), item.fixed and welded[link.name] == item.root.name
        for collider in link.colliders:
            name, material = f"{body}.{collider.name}", _class_name(collider.material)
            yield ContactGeom(name, body, static, surface_of(collider), material)


def excluded_pairs(scene: Scene) -> list[tuple[str, str]]:
    """Return the pairs of bodies that do not collide, for example because they are connected by a joint."""
    own = [(item.qualified(a), item.qualified(b)) for item in scene.objects for a, b in excluded_link_pairs(item)]
    return [*own, *scene.no_contact]


def contact_losses(geoms: Sequence[ContactGeom], exact: bool) -> Iterator[Loss]:
    """Yield the friction loss if any contacts in the files use MuJoCo's own rule.

    The loss is illustrated by the pair with the largest error.
    """
    groups = rules.written_groups(geoms)[1] if exact else rules.unlike_groups(geoms)
    worst = max(groups, key=_native_error, default=None)
    if worst is None or not _native_error(worst):
        return
    a, b = (geoms[0].surface.friction for geoms in (worst.one, worst.other))
    reason = combination_reason("MuJoCo", "the larger", a, b, max(a, b), worst.contact.friction)
    if exact:
        count = sum(len(group.one) * len(group.other) for group in groups)
        reason = f"load.py makes all contacts exact; without it, {count} pairs of moving geoms are not exact: {reason}"
    yield approximate("friction", "", reason, _native_error(worst))


def _native_error(group: UnlikeGroup) -> float:
    return max(group.one[0].surface.friction, group.other[0].surface.friction) - group.contact.friction


def restitution_losses(scene: Scene) -> Iterator[Loss]:
    """Yield one loss per object with restitution, and one loss for all objects that rebound but should not."""
    reason = "MuJoCo has no restitution; contact damping keeps rebounds within 0.03 of it, but never below 0.14."
    for item in scene.objects:
        if any(collider.restitution for link in item.links for collider in link.colliders):
            yield approximate("restitution", item.name, reason, 0.03)
    if any(collider.restitution == 0 for collider in _colliders(scene)):
        still = "MuJoCo's soft contacts rebound at 0.10 to 0.14 of the impact speed even if the restitution is 0."
        yield approximate("restitution", "", still, 0.14)
