"""Describe translations and rotations between poses in any form that documents support."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from simfoundry.spec.change.diff.values import joined

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]

STILL_M = 5e-7
"""Smallest reported translation [m]: positions are written with six decimals, so less is rounding."""

STILL_DEG = 5e-4
"""Smallest reported rotation [deg]: less is rounding of a quaternion with six decimals."""

AXIS_DEG = 1.0
"""Largest angle [deg] from x, y or z at which a rotation axis is reported as that axis."""


@dataclass(frozen=True)
class PoseChange:
    """Motion between two poses in the same parent frame.

    It consists of a translation ``shift`` [m] and a rotation by ``angle`` [deg] about the unit vector ``axis``.
    """

    shift: Vector
    angle: float
    axis: Vector

    @property
    def moved(self) -> bool:
        """Return True if the positions differ by more than rounding."""
        return math.hypot(*self.shift) > STILL_M

    @property
    def turned(self) -> bool:
        """Return True if the rotations differ by more than rounding."""
        return self.angle > STILL_DEG


def motion(old: Mapping[str, Any], new: Mapping[str, Any]) -> PoseChange:
    """Return the motion from the pose ``old`` to the pose ``new``, both as documents write them."""
    before, after = _xyz(old), _xyz(new)
    angle, axis = _turn(rotation(old), rotation(new))
    return PoseChange((after[0] - before[0], after[1] - before[1], after[2] - before[2]), angle, axis)


def words(found: PoseChange) -> list[str]:
    """Describe a motion: ``moved 3.2 cm (+x 3.0, +y 1.1)``, ``turned 12.0° about z``, or both."""
    out = []
    if found.moved:
        out.append(f"moved {_distance(found.shift)}")
    if found.turned:
        out.append(f"turned {_angle(found.angle, found.axis)}")
    return out


def rotation(pose: Mapping[str, Any]) -> Matrix:
    """Return the rotation matrix of a pose, row by row."""
    if pose.get("quat_wxyz") is not None:
        return _of_quaternion(pose["quat_wxyz"])
    if pose.get("look_at") is not None:
        return _of_look_at(_xyz(pose), pose["look_at"])
    roll, pitch, yaw = (math.radians(v) for v in pose.get("rpy_deg") or (0.0, 0.0, pose.get("yaw_deg") or 0.0))
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(v), math.sin(v)) for v in (roll, pitch, yaw))
    return (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )


def _xyz(pose: Mapping[str, Any]) -> Vector:
    x, y, z = pose.get("xyz") or (0.0, 0.0, 0.0)
    return x, y, z


def _of_quaternion(quaternion: tuple[float, float, float, float]) -> Matrix:
    norm = math.hypot(*quaternion)
    w, x, y, z = (v / norm for v in quaternion)
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def _of_look_at(eye: Vector, target: Vector) -> Matrix:
    """Return the axes (x right, y down, z forward) of an upright camera; looking along z keeps x along x."""
    forward = _unit((target[0] - eye[0], target[1] - eye[1], target[2] - eye[2]))
    right = _cross(forward, (0.0, 0.0, 1.0))
    if math.hypot(*right) < 1e-6:
        right = _cross(forward, (0.0, 1.0, 0.0))
    right = _unit(right)
    x, y, z = zip(right, _cross(forward, right), forward, strict=True)
    return x, y, z


def _turn(a: Matrix, b: Matrix) -> tuple[float, Vector]:
    """Return the angle [deg] and unit axis (in the parent frame) of the rotation ``b a^T`` from ``a`` to ``b``."""
    r = [[sum(b[i][k] * a[j][k] for k in range(3)) for j in range(3)] for i in range(3)]
    odd = (r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1])  # 2 sin(angle) axis
    sine, cosine = math.hypot(*odd) / 2, (r[0][0] + r[1][1] + r[2][2] - 1) / 2
    angle = math.degrees(math.atan2(sine, cosine))
    if sine > 1e-6:
        return angle, _unit(odd)
    if cosine > 0:
        return angle, (0.0, 0.0, 1.0)
    # Rotation by 180 deg: the symmetric part is 2 axis axis^T - 1; its largest column is the best conditioned.
    k = max(range(3), key=lambda i: r[i][i])
    return angle, _unit((r[0][k] + (k == 0), r[1][k] + (k == 1), r[2][k] + (k == 2)))


def _distance(shift: Vector) -> str:
    length = math.hypot(*shift)
    factor, unit, digits = _scale(length)
    parts = [(name, factor * v) for name, v in zip("xyz", shift, strict=True)]
    shown = [f"{'+' if v > 0 else '-'}{name} {abs(v):.{digits}f}" for name, v in parts if round(abs(v), digits) > 0]
    return f"{factor * length:.{digits}f} {unit}" + (f" ({', '.join(shown)})" if shown else "")


def _scale(length: float) -> tuple[float, str, int]:
    """Return the factor from meters, the unit, and the decimals that make a length easy to read."""
    if length >= 0.9995:
        return 1.0, "m", 3
    if length >= 0.00995:
        return 100.0, "cm", 1
    return (1000.0, "mm", 1) if length >= 5e-5 else (1e6, "µm", 1)


def _angle(angle: float, axis: Vector) -> str:
    digits = 1 if angle >= 0.05 else 4
    for k, name in enumerate("xyz"):
        if abs(axis[k]) > math.cos(math.radians(AXIS_DEG)):
            half = angle > 180 - 10**-digits / 2  # both directions are equivalent
            return f"{'-' if axis[k] < 0 and not half else ''}{angle:.{digits}f}° about {name}"
    return f"{angle:.{digits}f}° about {joined([f'{v:.2f}' for v in axis])}"


def _unit(v: Vector) -> Vector:
    norm = math.hypot(*v)
    return v[0] / norm, v[1] / norm, v[2] / norm


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
