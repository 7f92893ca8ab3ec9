"""Distance bounds between a link and a single-box link, such as a table top; they settle nearly all such pairs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.form import Form
from simfoundry.geometry.frames import Array
from simfoundry.geometry.shapes import Box

ROUNDING = 1e-6
"""Upper bound on single-precision rounding errors [m]."""


@dataclass(frozen=True, eq=False)
class BoxField:
    """Distance field of a box.

    ``middle`` and ``axes`` are its pose in the link, ``half`` its half extents.
    """

    middle: NDArray[np.float32]
    axes: NDArray[np.float32]
    half: NDArray[np.float32]

    def local(self, points: NDArray[np.float32]) -> NDArray[np.float32]:
        """Transform points in the link's frame, (..., 3), to the frame of the box."""
        return np.asarray((points - self.middle) @ self.axes)

    def lower(self, low: NDArray[np.float32], high: NDArray[np.float32]) -> Array:
        """Lower bound [m], (n,), of the distance to regions from ``low`` to ``high`` in the box frame, (n, 3) each.

        It is the largest gap across a face of the box.
        """
        return np.asarray(np.maximum(low - self.half, -self.half - high).max(axis=1) - np.float32(ROUNDING))

    def upper(self, local: NDArray[np.float32], radius: NDArray[np.float32]) -> Array:
        """Upper bound [m], (n,): distance of the nearest of the balls at points in the box frame, (n, m, 3)."""
        off = np.abs(local) - self.half
        outside = np.maximum(off, 0)
        away = np.sqrt(np.einsum("...i,...i->...", outside, outside)) + np.minimum(off.max(axis=-1), 0) - radius
        return np.asarray(away.min(axis=1) + np.float32(ROUNDING))


@lru_cache(maxsize=256)
def box_field(form: Form) -> BoxField | None:
    """Return the distance field of a link that is a single box, or None for any other link."""
    if not form.solid or len(form.shapes) != 1 or not isinstance(box := form.shapes[0][0], Box):
        return None
    pose = form.shapes[0][1]
    return BoxField(*(np.asarray(v, dtype=np.float32) for v in (pose.p, pose.rotation, np.asarray(box.size) / 2)))
