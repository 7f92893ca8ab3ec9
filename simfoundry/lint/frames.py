"""Vectors and rigid poses in plain Python: importing numpy would cost more time than a whole check may take."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from simfoundry.spec.models import base

Vec = tuple[float, float, float]
Rotation = tuple[float, float, float, float, float, float, float, float, float]
"""A rotation matrix, row by row."""

UNTURNED: Rotation = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


class Frame(NamedTuple):
    """The pose ``X_AB`` of a frame B in a frame A: rotation and position [m]."""

    r: Rotation = UNTURNED
    p: Vec = (0.0, 0.0, 0.0)

    def __matmul__(self, other: Frame) -> Frame:
        """``X_AC = X_AB @ X_BC``."""
        if other.r is UNTURNED:
            return Frame(self.r, self.apply(other.p))
        a, b, c, d, e, f, g, h, i = self.r
        m = other.r
        return Frame(
            (
                a * m[0] + b * m[3] + c * m[6],
                a * m[1] + b * m[4] + c * m[7],
                a * m[2] + b * m[5] + c * m[8],
                d * m[0] + e * m[3] + f * m[6],
                d * m[1] + e * m[4] + f * m[7],
                d * m[2] + e * m[5] + f * m[8],
                g * m[0] + h * m[3] + i * m[6],
                g * m[1] + h * m[4] + i * m[7],
                g * m[2] + h * m[5] + i * m[8],
            ),
            self.apply(other.p),
        )

    def apply(self, v: Vec) -> Vec:
        """A point of B in A."""
        a, b, c, d, e, f, g, h, i = self.r
        x, y, z = v
        px, py, pz = self.p
        return (a * x + b * y + c * z + px, d * x + e * y + f * z + py, g * x + h * y + i * z + pz)

    def axis(self, k: int) -> Vec:
        """The k-th axis of B in A."""
        return (self.r[k], self.r[3 + k], self.r[6 + k])

    def turn(self, v: Vec) -> Vec:
        """A direction of B in A."""
        a, b, c, d, e, f, g, h, i = self.r
        x, y, z = v
        return (a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z)

    def local(self, v: Vec) -> Vec:
        """A point of A in B."""
        a, b, c, d, e, f, g, h, i = self.r
        x, y, z = v[0] - self.p[0], v[1] - self.p[1], v[2] - self.p[2]
        return (a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z)


WORLD = Frame()


def dot(a: Vec, b: Vec) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vec, b: Vec) -> Vec:
    """Vector product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def minus(a: Vec, b: Vec) -> Vec:
    """``a - b``."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def unit(a: Vec) -> Vec:
    """The vector at length 1; x where it has none."""
    length = math.hypot(*a)
    return (a[0] / length, a[1] / length, a[2] / length) if length > 1e-15 else (1.0, 0.0, 0.0)


def frame_of(pose: base.PoseSpec) -> Frame:
    """The frame that a document writes."""
    if pose.quat_wxyz is not None:
        return Frame(turned(pose.quat_wxyz), pose.xyz)
    return Frame(rotation_of(pose.rpy_deg, pose.yaw_deg), pose.xyz)


def rotation_of(rpy_deg: Vec | None, yaw_deg: float | None) -> Rotation:
    """``Rz(yaw) Ry(pitch) Rx(roll)``."""
    if rpy_deg is None and not yaw_deg:
        return UNTURNED
    roll, pitch, yaw = rpy_deg or (0.0, 0.0, yaw_deg or 0.0)
    cr, sr, cp, sp, cy, sy = (f(math.radians(v)) for v in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return (
        *(cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        *(sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        *(-sp, cp * sr, cp * cr),
    )


def turned(quat_wxyz: Sequence[float]) -> Rotation:
    """The rotation of a quaternion of any length but 0."""
    length = math.hypot(*quat_wxyz)
    w, x, y, z = (v / length for v in quat_wxyz)
    return (
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def about(axis: Vec, angle: float) -> Rotation:
    """A rotation by ``angle`` [rad] about a direction."""
    s = math.sin(angle / 2)
    x, y, z = unit(axis)
    return turned((math.cos(angle / 2), s * x, s * y, s * z))


def looking(eye: Vec, target: Vec) -> Frame:
    """A camera (x right, y down, z forward) at ``eye`` that looks at ``target``, its picture upright."""
    z = unit(minus(target, eye))
    x = cross(z, (0.0, 0.0, 1.0))
    x = unit(x if math.hypot(*x) > 1e-6 else cross(z, (0.0, 1.0, 0.0)))
    y = cross(z, x)
    return Frame((x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]), eye)
