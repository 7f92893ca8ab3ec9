"""The modality configuration of a GR00T server: the keys it takes and gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from simfoundry.evaluate.policies.base import PolicyError
from simfoundry.geometry.frames import Array, Pose

MANY = 64
"""More keys or steps than any policy has."""

DROID_HAND = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""The rotation of DROID's hand as GR00T counts it, in the hand's own frame."""


@dataclass(frozen=True)
class Modality:
    """The ``keys`` of one modality, and at which ``steps`` it is wanted, 0 now and negative before."""

    keys: tuple[str, ...]
    steps: tuple[int, ...]


def modality(found: Any, name: str) -> Modality:
    """One modality of an answer to ``get_modality_config``; raises :class:`PolicyError`."""
    described = found.get(name) if isinstance(found, dict) else None
    if not isinstance(described, dict):
        raise PolicyError(f"the server does not describe its `{name}`")
    keys, steps = described.get("modality_keys"), described.get("delta_indices")
    if not isinstance(keys, list) or not 0 < len(keys) <= MANY or not all(isinstance(k, str) for k in keys):
        raise PolicyError(f"`modality_keys` of the server's `{name}` is no list of names")
    if not isinstance(steps, list) or not 0 < len(steps) <= MANY or not all(type(s) is int for s in steps):
        raise PolicyError(f"`delta_indices` of the server's `{name}` is no list of steps")
    return Modality(tuple(keys), tuple(steps))


def eef_9d(X_BH: Pose) -> Array:
    """The hand in the base as GR00T was trained on DROID: position [m], then the first two rows of its rotation.

    The rotation is that of the hand times the fixed one of DROID; shape (9,).
    """
    rotation = X_BH.rotation @ DROID_HAND
    return np.concatenate([X_BH.p, rotation[0], rotation[1]])
