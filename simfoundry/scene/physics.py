"""Tell apart what changes the physics of a scene from what changes only its pictures.

A recorded demonstration can be replayed in a scene that differs only in its pictures: all states are the same.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import PurePath
from typing import Any

import numpy as np

from simfoundry.geometry.shapes import Mesh
from simfoundry.scene.model import Link, Scene, SceneObject

# Fields that no engine reads for its physics: pictures, names of documents, and annotations. The viewer stays, because
# left and right in goals depend on it.
_NOT_PHYSICAL: Mapping[type, frozenset[str]] = {
    Scene: frozenset(
        {"name", "cameras", "lights", "mounted", "background", "relations", "left_out", "source", "random_values"}
    ),
    SceneObject: frozenset({"labels", "category", "variants"}),
    Link: frozenset({"visuals"}),
}
# The shape of a mesh, without its colors and textures.
_OF_MESH = ("vertices", "faces")


def physics_digest(scene: Scene) -> str:
    """Return a hash of everything in a scene that can affect its states.

    Two scenes with the same digest go through the same states, to the last bit, in the same engine and under the same
    actions. Cameras, lights, colors, textures, visuals and the background do not affect the digest.
    """
    hasher = hashlib.sha256()
    _add(scene, hasher)
    return hasher.hexdigest()


def differs_only_in_pictures(a: Scene, b: Scene) -> bool:
    """Return True if two scenes differ only in their pictures, so that what happens in one happens in the other."""
    return physics_digest(a) == physics_digest(b)


def _add(value: Any, hasher: Any) -> None:
    """Add a value to a hash. Each value starts with its type and its size, so that no two values look alike."""
    hasher.update(f"{type(value).__name__}:".encode())
    if is_dataclass(value) and not isinstance(value, type):
        skipped = _NOT_PHYSICAL.get(type(value), frozenset())
        names = _OF_MESH if isinstance(value, Mesh) else [f.name for f in fields(value) if f.name not in skipped]
        for name in names:
            hasher.update(f"{name}=".encode())
            _add(getattr(value, name), hasher)
    elif isinstance(value, np.ndarray):
        hasher.update(f"{value.shape}{value.dtype}".encode())
        hasher.update(np.ascontiguousarray(value).tobytes())
    elif isinstance(value, Mapping):
        hasher.update(f"{len(value)}".encode())
        for key in sorted(value, key=repr):
            _add(key, hasher)
            _add(value[key], hasher)
    elif isinstance(value, tuple | list | frozenset | set):
        hasher.update(f"{len(value)}".encode())
        for item in value if isinstance(value, tuple | list) else sorted(value, key=repr):
            _add(item, hasher)
    elif isinstance(value, str | bytes | int | float | bool | Enum | PurePath | None):
        text = repr(str(value) if isinstance(value, Enum | PurePath) else value)
        hasher.update(f"{len(text)}:{text}".encode())
    else:
        raise TypeError(f"a scene contains {type(value).__name__}, which has no digest")
