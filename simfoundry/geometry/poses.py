"""Arrays of rigid poses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array, Pose

Index = NDArray[np.int64]


class Poses(NamedTuple):
    """n poses ``X_AB``: positions ``p`` [m], shape (n, 3), and rotation matrices ``R``, shape (n, 3, 3)."""

    p: Array
    R: Array

    @classmethod
    def of(cls, p: Array, q: Array) -> Poses:
        """Create poses from positions (n, 3) and non-zero wxyz quaternions (n, 4), which need not be normalized."""
        return cls(np.asarray(p, dtype=np.float64), rotations(np.asarray(q, dtype=np.float64)))

    @classmethod
    def constant(cls, pose: Pose, n: int) -> Poses:
        """Repeat one pose n times."""
        return cls(np.broadcast_to(pose.p, (n, 3)), np.broadcast_to(pose.rotation, (n, 3, 3)))

    def __matmul__(self, other: Poses) -> Poses:
        return Poses(self.p + rotate(self.R, other.p), self.R @ other.R)

    def times(self, pose: Pose) -> Poses:
        """Compose with a common ``X_BC``: n poses ``X_AC``."""
        if pose.is_identity:
            return self
        return Poses(self.p + self.R @ pose.p, self.R @ pose.rotation)

    def inverse(self) -> Poses:
        """Return the n inverse poses ``X_BA``."""
        turned = self.R.transpose(0, 2, 1)
        return Poses(-rotate(turned, self.p), turned)

    def at(self, index: Index) -> Poses:
        """Select the poses of some states."""
        return Poses(self.p[index], self.R[index])


def rotate(turn: Array, v: Array) -> Array:
    """Rotate each vector by its own rotation matrix: (n, 3, 3), (n, 3) to (n, 3)."""
    return np.asarray((turn @ v[:, :, None])[:, :, 0])


def rotations(q: Array) -> Array:
    """Rotation matrices, shape (n, 3, 3), of quaternions wxyz, shape (n, 4)."""
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    out = np.empty((len(q), 3, 3))
    out[:, 0, 0], out[:, 0, 1], out[:, 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    out[:, 1, 0], out[:, 1, 1], out[:, 1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    out[:, 2, 0], out[:, 2, 1], out[:, 2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return out


_UNTURNED = np.eye(3)


class Turn:
    """Rotations about one unit axis, shape (3,)."""

    def __init__(self, axis: Array) -> None:
        x, y, z = axis
        self._skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        self._square = self._skew @ self._skew

    def by(self, angle: Array) -> Array:
        """Return the rotation matrices for angles [rad], (n,), shape (n, 3, 3)."""
        s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
        return np.asarray(_UNTURNED + s * self._skew + (1 - c) * self._square)
