"""The modality configuration of a GR00T server: the keys of its inputs and outputs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from simfoundry.evaluate.policies.base import PolicyError
from simfoundry.geometry.frames import Array, Pose

MANY = 64
"""Upper limit of keys and steps, above those of any known policy."""

DROID_HAND = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Rotation of DROID's hand in GR00T's convention, relative to the hand's own frame."""


@dataclass(frozen=True)
class Modality:
    """The ``keys`` of one modality and its time ``steps``, 0 for the present and negative for earlier ones."""

    keys: tuple[str, ...]
    steps: tuple[int, ...]


def modality(found: Any, name: str) -> Modality:
    """Parse one modality of an answer to ``get_modality_config``; raises :class:`PolicyError`."""
    described = found.get(name) if isinstance(found, dict) else None
    if not isinstance(described, dict):
        raise PolicyError(f"the server does not describe its `{name}`")
    keys, steps = described.get("modality_keys"), described.get("delta_indices")
    if not isinstance(keys, list) or not 0 < len(keys) <= MANY or not all(isinstance(k, str) for k in keys):
        raise PolicyError(f"`modality_keys` of the server's `{name}` is not a list of names")
    if not isinstance(steps, list) or not 0 < len(steps) <= MANY or not all(type(s) is int for s in steps):
        raise PolicyError(f"`delta_indices` of the server's `{name}` is not a list of steps")
    return Modality(tuple(keys), tuple(steps))


def eef_9d(X_BH: Pose) -> Array:
    """Hand pose in the base frame as in GR00T's training on DROID: position [m], then the first two rows of the
    rotation.

    The rotation is the hand's times a fixed one of DROID; shape (9,).
    """
    rotation = X_BH.rotation @ DROID_HAND
    return np.concatenate([X_BH.p, rotation[0], rotation[1]])
