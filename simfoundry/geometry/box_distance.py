"""Bounds on how far a link is from one that is a single box, as table tops are: they decide nearly all such pairs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.form import Form
from simfoundry.geometry.frames import Array
from simfoundry.geometry.shapes import Box

ROUNDING = 1e-6
"""What single precision may be off [m]."""


@dataclass(frozen=True, eq=False)
class BoxField:
    """The distance from one box; ``middle`` and ``axes`` are its pose in the link, ``half`` its half extents."""

    middle: NDArray[np.float32]
    axes: NDArray[np.float32]
    half: NDArray[np.float32]

    def local(self, points: NDArray[np.float32]) -> NDArray[np.float32]:
        """Points in the link's frame, (..., 3), in that of the box."""
        return np.asarray((points - self.middle) @ self.axes)

    def lower(self, low: NDArray[np.float32], high: NDArray[np.float32]) -> Array:
        """A lower bound [m], (n,), of what reaches from ``low`` to ``high`` in the frame of the box, (n, 3) each.

        It is the widest gap across a face of the box.
        """
        return np.asarray(np.maximum(low - self.half, -self.half - high).max(axis=1) - np.float32(ROUNDING))

    def upper(self, local: NDArray[np.float32], radius: NDArray[np.float32]) -> Array:
        """An upper bound [m], (n,): how far the nearest of balls at points in the frame of the box, (n, m, 3), is."""
        off = np.abs(local) - self.half
        outside = np.maximum(off, 0)
        away = np.sqrt(np.einsum("...i,...i->...", outside, outside)) + np.minimum(off.max(axis=-1), 0) - radius
        return np.asarray(away.min(axis=1) + np.float32(ROUNDING))


@lru_cache(maxsize=256)
def box_field(form: Form) -> BoxField | None:
    """The field of a link that is one box; None for any other."""
    if not form.solid or len(form.shapes) != 1 or not isinstance(box := form.shapes[0][0], Box):
        return None
    pose = form.shapes[0][1]
    return BoxField(*(np.asarray(v, dtype=np.float32) for v in (pose.p, pose.rotation, np.asarray(box.size) / 2)))
