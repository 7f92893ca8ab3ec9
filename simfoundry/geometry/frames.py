"""Rigid transforms (single poses and batches), and the project's only conversion between quaternion orders.

``X_AB`` is the pose of frame B in frame A: ``p_A = X_AB @ p_B``. Quaternions are ``wxyz`` everywhere in this project.
:func:`to_xyzw` and :func:`from_xyzw` convert to and from formats that use the ``xyzw`` order (PyBullet, numpy views of
USD quaternions).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def frozen_array(values: object, shape: tuple[int, ...] | None = None) -> Array:
    """Copy ``values`` into a read-only float64 array, reshaped to ``shape`` if it is given."""
    array = np.array(values, dtype=np.float64)
    if shape is not None and array.shape != shape:
        array = array.reshape(shape)
    array.setflags(write=False)
    return array


@dataclass(frozen=True, eq=False)
class Pose:
    """A rigid transform ``X_AB``.

    Attributes:
        p: Translation [m], shape (3,).
        q: Unit quaternion (wxyz), shape (4,).
    """

    p: Array
    q: Array

    @classmethod
    def of(cls, p: Iterable[float] = (0.0, 0.0, 0.0), q: Iterable[float] = (1.0, 0.0, 0.0, 0.0)) -> Pose:
        """Build a pose from any position and any nonzero quaternion, which is normalized so that ``w >= 0``."""
        w, x, y, z = map(float, q)  # for four numbers, plain Python is faster than numpy arrays
        norm = math.hypot(w, x, y, z)
        if not math.isfinite(norm) or norm < 1e-12:
            raise ValueError(f"a rotation needs a non-zero quaternion, got {[w, x, y, z]}")
        norm = -norm if w < 0 else norm
        position = frozen_array(p if isinstance(p, np.ndarray) else tuple(p), (3,))
        return cls(position, frozen_array((w / norm, x / norm, y / norm, z / norm)))

    @classmethod
    def from_matrix(cls, matrix: Array) -> Pose:
        """Build a pose from a homogeneous 4x4 matrix or a 3x3 rotation matrix."""
        matrix = np.asarray(matrix, dtype=np.float64)
        p = matrix[:3, 3] if matrix.shape == (4, 4) else np.zeros(3)
        return cls.of(p, quat_from_matrix(matrix[:3, :3]))

    @classmethod
    def about(cls, axis: Array, angle: float) -> Pose:
        """Build a rotation by ``angle`` [rad] about a unit axis."""
        return cls.of(q=(math.cos(angle / 2), *(axis * math.sin(angle / 2))))

    @property
    def matrix(self) -> Array:
        """The homogeneous 4x4 matrix of the transform."""
        out = np.eye(4)
        out[:3, :3] = self.rotation
        out[:3, 3] = self.p
        return out

    @cached_property
    def rotation(self) -> Array:
        """The 3x3 rotation matrix of the transform."""
        return frozen_array(matrix_from_quat(self.q))

    @cached_property
    def is_identity(self) -> bool:
        """True if the pose is exactly the identity."""
        return self is IDENTITY or (not any(self.p.tolist()) and bool(self.q[0] == 1.0))

    def inverse(self) -> Pose:
        """Return the inverse transform ``X_BA``."""
        q = self.q * np.array([1.0, -1.0, -1.0, -1.0])
        return Pose.of(-(matrix_from_quat(q) @ self.p), q)

    def __matmul__(self, other: Pose) -> Pose:
        """Compose two transforms: ``X_AC = X_AB @ X_BC``."""
        if other.is_identity:
            return self
        return Pose.of(self.p + self.rotation @ other.p, quat_multiply(self.q, other.q))

    def apply(self, points: Array) -> Array:
        """Transform points of shape (..., 3) from frame B to frame A."""
        return np.asarray(points) @ self.rotation.T + self.p

    def angle_about(self, axis: Array) -> float:
        """Return the twist angle of the rotation about a unit axis, in the range [-pi, pi] rad."""
        return 2.0 * math.atan2(float(self.q[1:] @ axis), float(self.q[0]))

    def angle_to(self, other: Pose) -> float:
        """Return the angle between the rotations of the two poses, in the range [0, pi] rad."""
        relative = quat_multiply(self.q * np.array([1.0, -1.0, -1.0, -1.0]), other.q)
        return 2.0 * math.atan2(float(np.linalg.norm(relative[1:])), abs(float(relative[0])))


IDENTITY = Pose.of()


def quat_multiply(a: Array, b: Array) -> Array:
    """Return the Hamilton product of two wxyz quaternions."""
    aw, ax, ay, az = map(float, a)
    bw, bx, by, bz = map(float, b)
    w = aw * bw - ax * bx - ay * by - az * bz
    x = aw * bx + ax * bw + ay * bz - az * by
    y = aw * by - ax * bz + ay * bw + az * bx
    z = aw * bz + ax * by - ay * bx + az * bw
    return np.array([w, x, y, z])


def matrix_from_quat(q: Array) -> Array:
    """Convert a unit wxyz quaternion to a 3x3 rotation matrix."""
    return np.array(_rotation_rows(*map(float, q)))  # numpy scalars are slower than Python floats


def _rotation_rows(w: Any, x: Any, y: Any, z: Any) -> list[list[Any]]:
    """Return the rows of the rotation matrix for a unit quaternion whose entries are numbers or arrays."""
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]


def quat_from_matrix(rotation: Array) -> Array:
    """Convert a rotation matrix to a unit wxyz quaternion.

    The computation branches on the largest diagonal element to remain stable near 180 degrees.
    """
    r = np.asarray(rotation, dtype=np.float64)
    trace = float(r[0, 0] + r[1, 1] + r[2, 2])
    candidates = np.array([trace, r[0, 0], r[1, 1], r[2, 2]])
    k = int(np.argmax(candidates))
    if k == 0:
        q = np.array([1 + trace, r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    else:
        i, j, m = [(0, 1, 2), (1, 2, 0), (2, 0, 1)][k - 1]
        q = np.zeros(4)
        q[0] = r[m, j] - r[j, m]
        q[1 + i] = 1 + r[i, i] - r[j, j] - r[m, m]
        q[1 + j] = r[j, i] + r[i, j]
        q[1 + m] = r[m, i] + r[i, m]
    return np.asarray(q / np.linalg.norm(q))


def quat_from_rpy(roll: float, pitch: float, yaw: float) -> Array:
    """Convert fixed-axis roll, pitch and yaw [rad] to a wxyz quaternion.

    The convention is the same as in URDF: ``R = Rz(yaw) Ry(pitch) Rx(roll)``.
    """
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    w, x = cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy
    y, z = cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy
    return np.array([w, x, y, z])


def rpy_from_quat(q: Array) -> Array:
    """Convert a unit wxyz quaternion to URDF's fixed-axis roll, pitch and yaw [rad]."""
    r = matrix_from_quat(q).tolist()
    level = math.hypot(r[0][0], r[1][0])
    pitch = math.atan2(-r[2][0], level)
    if level < 1e-9:  # gimbal lock: roll and yaw share one axis; assign the whole rotation to yaw
        return np.array([0.0, pitch, math.atan2(-r[0][1], r[1][1])])
    return np.array([math.atan2(r[2][1], r[2][2]), pitch, math.atan2(r[1][0], r[0][0])])


def principal_inertia(inertia: Array) -> tuple[Array, Array]:
    """Return the principal moments and axes of a symmetric inertia ``I = R diag(moments) R^T``.

    If the inertia is already diagonal, its axes are kept so that rounding does not rotate symmetric bodies.

    Returns:
        The moments [kg m^2], shape (3,), and R as a wxyz quaternion, shape (4,).
    """
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia.tolist()
    if max(abs(xy), abs(xz), abs(yz)) <= 1e-12 * (xx + yy + zz):
        return frozen_array((xx, yy, zz)), IDENTITY.q
    moments, axes = np.linalg.eigh(inertia)
    for k in range(3):  # the sign of an eigenvector is arbitrary, so make its largest entry positive
        if axes[np.argmax(np.abs(axes[:, k])), k] < 0:
            axes[:, k] = -axes[:, k]
    if np.linalg.det(axes) < 0:
        axes[:, 2] = -axes[:, 2]
    return frozen_array(moments), Pose.from_matrix(axes).q


def cross(a: Array, b: Array) -> Array:
    """Return cross products along the last axis. For a few vectors, this is five times as fast as ``np.cross``.

    Swapping the arguments changes only the sign, so two triangles compute the same values for a shared edge.
    """
    ax, ay, az = np.moveaxis(a, -1, 0)
    bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def look_at(eye: Array, target: Array, up: Array | None = None) -> Pose:
    """Return the pose ``X_WC`` of a camera at ``eye`` that looks at ``target``.

    The camera frame uses OpenCV axes: x points right, y points down, and z points forward.
    """
    forward = np.asarray(target, dtype=np.float64) - np.asarray(eye, dtype=np.float64)
    norm = float(np.linalg.norm(forward))
    if norm < 1e-9:
        raise ValueError("a camera cannot look at its own position")
    z = forward / norm
    x = np.cross(z, np.array([0.0, 0.0, 1.0]) if up is None else up)
    if np.linalg.norm(x) < 1e-6:  # looking straight up or down: keep image x along world x
        x = np.cross(z, np.array([0.0, 1.0, 0.0]))
    x = x / np.linalg.norm(x)
    return Pose.of(eye, quat_from_matrix(np.column_stack([x, np.cross(z, x), z])))


def to_xyzw(q: Array) -> Array:
    """Convert quaternions from wxyz to xyzw order."""
    return np.asarray(q)[..., [1, 2, 3, 0]]


def from_xyzw(q: object) -> Array:
    """Convert quaternions from xyzw to wxyz order."""
    return np.asarray(q, dtype=np.float64)[..., [3, 0, 1, 2]]


Index = NDArray[np.int64]


class Poses(NamedTuple):
    """A batch of n poses ``X_AB``.

    Attributes:
        p: Positions [m], shape (n, 3).
        R: Rotation matrices, shape (n, 3, 3).
    """

    p: Array
    R: Array

    @classmethod
    def of(cls, p: Array, q: Array) -> Poses:
        """Create poses from n positions and n nonzero wxyz quaternions.

        The quaternions do not need to be normalized.
        """
        return cls(np.asarray(p, dtype=np.float64), rotations(np.asarray(q, dtype=np.float64)))

    @classmethod
    def constant(cls, pose: Pose, n: int) -> Poses:
        """Repeat one pose n times."""
        return cls(np.broadcast_to(pose.p, (n, 3)), np.broadcast_to(pose.rotation, (n, 3, 3)))

    def __matmul__(self, other: Poses) -> Poses:
        return Poses(self.p + rotate(self.R, other.p), self.R @ other.R)

    def times(self, pose: Pose) -> Poses:
        """Compose each pose with the same ``X_BC`` and return the n poses ``X_AC``."""
        if pose.is_identity:
            return self
        return Poses(self.p + self.R @ pose.p, self.R @ pose.rotation)

    def inverse(self) -> Poses:
        """Return the n inverse poses ``X_BA``."""
        turned = self.R.transpose(0, 2, 1)
        return Poses(-rotate(turned, self.p), turned)

    def at(self, index: Index) -> Poses:
        """Select poses by index."""
        return Poses(self.p[index], self.R[index])


def rotate(turn: Array, v: Array) -> Array:
    """Rotate each vector in ``v`` by the corresponding matrix in ``turn``.

    Args:
        turn: Rotation matrices, shape (n, 3, 3).
        v: Vectors, shape (n, 3).

    Returns:
        Rotated vectors, shape (n, 3).
    """
    return np.asarray((turn @ v[:, :, None])[:, :, 0])


def rotations(q: Array) -> Array:
    """Convert wxyz quaternions of shape (n, 4) to rotation matrices of shape (n, 3, 3)."""
    rows = np.array(_rotation_rows(*(q / np.linalg.norm(q, axis=1, keepdims=True)).T))
    return np.ascontiguousarray(np.moveaxis(rows, -1, 0))


class Turn:
    """Rotations about a fixed unit axis."""

    def __init__(self, axis: Array) -> None:
        x, y, z = axis
        self._skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        self._square = self._skew @ self._skew

    def by(self, angle: Array) -> Array:
        """Return the rotation matrices for an array of angles.

        Args:
            angle: Angles [rad], shape (n,).

        Returns:
            Rotation matrices, shape (n, 3, 3).
        """
        s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
        return np.asarray(np.eye(3) + s * self._skew + (1 - c) * self._square)
