"""Bounds on how far a link is from one that is a single box, as table tops are: they decide nearly all such pairs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from simfoundry.predicates.shapes import Form
from simfoundry.scene.frames import Array
from simfoundry.scene.model import Box

ROUNDING = 1e-6
"""What single precision may be off [m]."""


@dataclass(frozen=True, eq=False)
class BoxField:
    """The distance from one box; ``middle`` and ``axes`` are its pose in the link, ``half`` its half extents."""

    middle: NDArray[np.float32]
    axes: NDArray[np.float32]
    half: NDArray[np.float32]

    def bounds(self, points: NDArray[np.float32], radius: NDArray[np.float32]) -> tuple[Array, Array]:
        """A lower and an upper bound [m], (n,) each, for hulls of balls at points in the link's frame, (n, m, 3).

        The one is the widest gap across a face of the box, the other the distance of the nearest ball.
        """
        local = (points - self.middle) @ self.axes
        off = np.abs(local) - self.half
        outside = np.maximum(off, 0)
        away = np.sqrt(np.einsum("...i,...i->...", outside, outside)) + np.minimum(off.max(axis=-1), 0) - radius
        low, high = (local - radius[:, None]).min(axis=1), (local + radius[:, None]).max(axis=1)
        gap = np.maximum(low - self.half, -self.half - high).max(axis=1)
        return gap - np.float32(ROUNDING), away.min(axis=1) + np.float32(ROUNDING)


@lru_cache(maxsize=256)
def box_field(form: Form) -> BoxField | None:
    """The field of a link that is one box; None for any other."""
    colliders = form.link.colliders
    if len(colliders) != 1 or not isinstance(box := colliders[0].geometry, Box):
        return None
    pose = colliders[0].X_LG
    return BoxField(*(np.asarray(v, dtype=np.float32) for v in (pose.p, pose.rotation, np.asarray(box.size) / 2)))
