"""Conversion of materials to MJCF default classes, and the collision geoms, excluded pairs and losses of a scene."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from simfoundry.backends.artifact import number, numbers
from simfoundry.backends.losses import Loss, approximate, combination_reason
from simfoundry.backends.mjcf import contact_rules as rules
from simfoundry.backends.mjcf.contact_rules import ContactGeom, ContactSurface, UnlikeGroup
from simfoundry.scene.kinematics import excluded_link_pairs, weld_groups
from simfoundry.scene.model import Collider, Scene, SceneObject

if TYPE_CHECKING:
    import mujoco

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


def exact_model(files: Mapping[str, bytes]) -> mujoco.MjModel:
    """Compile the files of a build into a model with exact contacts, as the build's `load()` does."""
    import mujoco

    assets = {path.removeprefix("assets/"): data for path, data in files.items() if path.startswith("assets/")}
    include = {rules.CONTACTS_FILE: rules.EMPTY.encode()}
    spec = mujoco.MjSpec.from_string(files["scene.xml"].decode(), include=include, assets=assets)
    rules.make_exact(spec)
    return spec.compile()


def contact_losses(geoms: Sequence[ContactGeom], exact: bool) -> Iterator[Loss]:
    """Yield the friction and restitution losses if any contacts in the files use MuJoCo's own rule.

    Each loss is illustrated by the pair with the largest error.
    """
    groups = rules.written_groups(geoms)[1] if exact else rules.unlike_groups(geoms)
    count = sum(len(group.one) * len(group.other) for group in groups)
    about = f"load.py makes all contacts exact; without it, {count} pairs of geoms are not exact: " if exact else ""
    worst = max(groups, key=_friction_error, default=None)
    if worst is not None and _friction_error(worst):
        a, b = (geoms[0].surface.friction for geoms in (worst.one, worst.other))
        reason = combination_reason("MuJoCo", "the larger", a, b, max(a, b), worst.contact.friction)
        yield approximate("friction", "", about + reason, _friction_error(worst))
    worst = max(groups, key=_restitution_error, default=None)
    if worst is not None and _restitution_error(worst):
        a, b = (geoms[0].surface.restitution for geoms in (worst.one, worst.other))
        time, ratio = _native_damping(worst)
        reason = (
            f"MuJoCo averages the damping of a pair: it rebounds at {rules.rebound(ratio):.3g} for {a:.3g} and "
            f"{b:.3g}; the scene specifies {worst.contact.restitution:.3g}. "
            f"An impact sinks in by up to {1000 * _depth(time, ratio):.2g} mm per m/s of its speed."
        )
        yield approximate("restitution", "", about + reason, _restitution_error(worst))


def _friction_error(group: UnlikeGroup) -> float:
    return max(group.one[0].surface.friction, group.other[0].surface.friction) - group.contact.friction


def _restitution_error(group: UnlikeGroup) -> float:
    """Return the error of MuJoCo's own rebound, or zero if both surfaces have the same damping."""
    one, other = (rules.damping_ratio(geoms[0].surface.restitution) for geoms in (group.one, group.other))
    return 0.0 if one == other else abs(rules.rebound((one + other) / 2) - group.contact.restitution)


def _native_damping(group: UnlikeGroup) -> tuple[float, float]:
    """Return the time constant [s] and the damping ratio of MuJoCo's own contact, which averages both surfaces."""
    one, other = (rules.solref(geoms[0].surface.restitution) for geoms in (group.one, group.other))
    return (one[0] + other[0]) / 2, (one[1] + other[1]) / 2


def _depth(time: float, ratio: float) -> float:
    """Return the depth [m] to which an impact at 1 m/s sinks into a push-only spring-damper."""
    return time * ratio * math.sqrt(rules.rebound(min(ratio, 1 - 1e-9)))  # the turning point, half of the contact


def restitution_losses(scene: Scene) -> Iterator[Loss]:
    """Yield one loss per object with restitution, and one loss for all objects that rebound but should not."""
    for item in scene.objects:
        largest = max((c.restitution for link in item.links for c in link.colliders), default=0.0)
        if largest:
            depth = 1000 * _depth(*rules.solref(largest))
            reason = (
                "MuJoCo has no restitution; contact damping keeps rebounds within 0.03 of it, but never below 0.14. "
                f"Contacts are soft: an impact sinks in by up to {depth:.2g} mm per m/s of its speed, "
                "so a fast object passes through a thin one."
            )
            yield approximate("restitution", item.name, reason, 0.03)
    if any(collider.restitution == 0 for collider in _colliders(scene)):
        still = "MuJoCo's soft contacts rebound at 0.10 to 0.14 of the impact speed even if the restitution is 0, and "
        still += f"an impact sinks in by up to {1000 * _depth(*rules.solref(0.0)):.2g} mm per m/s of its speed."
        yield approximate("restitution", "", still, 0.14)
