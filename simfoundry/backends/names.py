"""Validation of scene names before they are used as file names, XML names and dictionary keys."""

from __future__ import annotations

import re
from collections.abc import Iterable
from weakref import WeakSet

from simfoundry.errors import SimfoundryError
from simfoundry.scene.model import Scene, SceneObject

_NAME = re.compile(r"[a-z][a-z0-9_]*")


class InvalidSceneError(SimfoundryError, ValueError):
    """Raised if no backend can write a scene, for example because a name is invalid or not unique."""


def check_names(scene: Scene) -> None:
    """Raise :class:`InvalidSceneError` unless every name matches ``[a-z][a-z0-9_]*`` and is unique in its category."""
    if scene in _SOUND:
        return
    both = [*(o.name for o in scene.objects), *(r.name for r in scene.robots)]
    _check("the scene", "scene", [scene.name])
    _check("the scene", "object" if not scene.robots else "object or robot", both)
    _check("the scene", "camera", (c.name for c in (*scene.cameras, *(m.camera for m in scene.mounted))))
    _check("the scene", "light", (light.name for light in scene.lights))
    for item in (one for each in scene.objects for one in (each, *each.variants)):
        _check_object(item)
    _SOUND.add(scene)


# Scenes whose names have been validated, so that the check is not repeated for every target.
_SOUND: WeakSet[Scene] = WeakSet()


def _check_object(item: SceneObject) -> None:
    _check(item.name, "link", (link.name for link in item.links))
    _check(item.name, "joint", (joint.name for joint in item.joints))
    _check(item.name, "variant", (v.variant for v in (item, *item.variants) if item.variants))
    for link in item.links:
        where = f"{item.name}.{link.name}"
        _check(where, "visual", (visual.name for visual in link.visuals))
        _check(where, "collider", (collider.name for collider in link.colliders))


def _check(where: str, kind: str, names: Iterable[str]) -> None:
    known: set[str] = set()
    for name in names:
        if not _NAME.fullmatch(name):
            raise InvalidSceneError(
                f"{where}: {kind} name {name!r} is invalid; use a lower-case letter followed by "
                f"lower-case letters, digits and underscores"
            )
        if name in known:
            raise InvalidSceneError(f"{where}: two {kind}s are called {name!r}; rename one")
        known.add(name)
