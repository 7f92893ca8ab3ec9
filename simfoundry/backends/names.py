"""Validation of names in a scene, which become file names, XML names and dictionary keys."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from weakref import WeakSet

from simfoundry.errors import SimfoundryError
from simfoundry.scene.model import Scene

_NAME = re.compile(r"[a-z][a-z0-9_]*")


class InvalidSceneError(SimfoundryError, ValueError):
    """Raised if a scene cannot be written by any backend, for example because a name is invalid or not unique."""


def check_names(scene: Scene) -> None:
    """Check that every name matches ``[a-z][a-z0-9_]*`` and is unique in its category.

    Raises:
        InvalidSceneError: If a name is invalid or not unique.
    """
    if scene in _VALID:
        return
    _check("the scene", "scene", [scene])
    _check("the scene", "object or robot" if scene.robots else "object", [*scene.objects, *scene.robots])
    _check("the scene", "camera", [*scene.cameras, *(mounted.camera for mounted in scene.mounted)])
    _check("the scene", "light", scene.lights)
    for item in (one for each in scene.objects for one in (each, *each.variants)):
        _check(item.name, "link", item.links)
        _check(item.name, "joint", item.joints)
        _check(item.name, "variant", (item, *item.variants) if item.variants else (), "variant")
        for link in item.links:
            _check(f"{item.name}.{link.name}", "visual", link.visuals)
            _check(f"{item.name}.{link.name}", "collider", link.colliders)
    _VALID.add(scene)


def check_timestep(timestep: float) -> None:
    """Raise :class:`InvalidSceneError` unless a time step [s] is positive and finite."""
    if not 0 < timestep < math.inf:
        raise InvalidSceneError(f"option `timestep` must be a positive number of seconds, not `{timestep:g}`")


# Scenes whose names have been validated, so that the check is not repeated for every target.
_VALID: WeakSet[Scene] = WeakSet()


def _check(where: str, kind: str, elements: Iterable[object], field: str = "name") -> None:
    known: set[str] = set()
    for name in (getattr(element, field) for element in elements):
        if not _NAME.fullmatch(name):
            rule = "use a lower-case letter followed by lower-case letters, digits and underscores"
            raise InvalidSceneError(f"{where}: {kind} name {name!r} is invalid; {rule}")
        if name in known:
            raise InvalidSceneError(f"{where}: two {kind}s are called {name!r}; rename one of them")
        known.add(name)
