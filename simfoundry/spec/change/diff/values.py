"""Describe document values: numbers with units, colors, shapes, places, and motion between poses."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from pydantic_core import PydanticUndefined

from simfoundry.spec.models.base import Model
from simfoundry.spec.models.types import models_at
from simfoundry.spec.yaml.write import number

# Maximum length of a displayed text [characters], so that two texts fit on one line.
LONGEST = 48

# Maximum length of a list of numbers that is written out, which is the length of a quaternion.
FEW = 4

# Fields that contain prose.
FREE_TEXTS = ("description", "instruction", "note")

_UNIT = re.compile(r"\[([^\]]+)\]")
# Lists that are formatted as ``a × b``.
_TIMES = ("size", "grid", "box")


def joined(items: Iterable[str]) -> str:
    """Join items as ``(a, b, c)``."""
    return f"({', '.join(items)})"


@lru_cache(maxsize=4096)
def unit(model: type[Model] | None, path: tuple[str, ...]) -> str:
    """Return the unit in the brackets of a field's description, or an empty string if the field has no unit."""
    for owner in models_at(model, path[:-1]) if model is not None else ():
        info = owner.model_fields.get(path[-1])
        found = _UNIT.search(info.description or "") if info is not None else None
        if found is not None:
            return found[1].partition(",")[0]
    return ""


@lru_cache(maxsize=4096)
def default(model: type[Model] | None, path: tuple[str, ...]) -> Any:
    """Return the default of a field if it is a plain value, else None."""
    for owner in models_at(model, path[:-1]) if model is not None else ():
        info = owner.model_fields.get(path[-1])
        if info is not None and info.default is not PydanticUndefined and not isinstance(info.default, Model | dict):
            return info.default
    return None


def pair(key: str, old: Any, new: Any, unit: str = "") -> str:
    """Describe a change as ``0.20 → 0.31 kg``: both values in the same format, with the unit only once."""
    if _is_number(old) and _is_number(new):
        left, right = _same_digits(old, new)
    else:
        left, right = value(key, old), value(key, new)
    if left == right and not isinstance(old, str):
        left, right = str(old), str(new)
    return f"{left} → {with_unit(right, unit)}"


def value(key: str, item: Any) -> str:
    """Describe the value ``item`` of ``key``."""
    match item:
        case None:
            return "none"
        case bool():
            return "yes" if item else "no"
        case int() | float():
            return number(item)
        case str():
            return f'"{shortened(item)}"' if key in FREE_TEXTS or " " in item or not item else shortened(item)
        case tuple() | list():
            return _list(key, tuple(item))
        case {"deg": degrees, **rest} if not rest:
            return f"{number(degrees)}°"
        case {"value": plain}:
            return f"{number(plain)} {_doubt(item)}"
    return ", ".join(f"{k} {value(k, v)}" for k, v in item.items()) if isinstance(item, dict) else str(item)


def with_unit(text: str, unit: str) -> str:
    """Insert a unit after a number and before anything in brackets."""
    if not unit or text.endswith("°") or not text or not (text[0].isdigit() or text[0] in "-.("):
        return text
    plain, bracket, rest = text.partition(" (")
    return f"{plain} {unit}{bracket}{rest}"


def shape(item: Any) -> str:
    """Describe a shape: ``box 0.1 × 0.1 × 0.2 m``, ``cylinder of radius 0.04 and height 0.1 m``."""
    match item:
        case {"box": size}:
            return f"box {_list('box', size)} m"
        case {"sphere": radius}:
            return f"sphere of radius {number(radius)} m"
        case {"prism": {"outline": outline, "height": height}}:
            return f"prism of {len(outline)} corners and height {number(height)} m"
        case {"lathe": {"profile": profile}}:
            return f"lathe of {len(profile)} corners"
        case {"cylinder": {"radius": r, "height": h}} | {"capsule": {"radius": r, "height": h}}:
            return f"{next(iter(item))} of radius {number(r)} and height {number(h)} m"
    return value("shape", item)


def place(item: dict[str, Any]) -> str:
    """Describe a place: ``on desk at (0.45, 0.1), left of plate``."""
    words = [f"{key} {item[key]}" for key in ("on", "inside") if key in item]
    for key, frame in (("xy", ""), ("local_xy", " of its frame")):
        if key in item:
            words = [" ".join([*words, f"at {_list(key, item[key])} m{frame}"])]
    for key in ("left_of", "right_of", "in_front_of", "behind"):
        if key in item:
            gap = f" with a gap of {number(item['gap'])} m" if "gap" in item else ""
            words.append(f"{key.replace('_', ' ')} {item[key]}{gap}")
    return ", ".join(words)


def shortened(text: str) -> str:
    """Shorten a text so that it fits on a line."""
    return text if len(text) <= LONGEST else text[: LONGEST - 1] + "…"


def _doubt(estimate: dict[str, Any]) -> str:
    range_ = estimate.get("range")
    between = f", {number(range_[0])} to {number(range_[1])}" if range_ else ""
    return f"(estimated{between} by {shortened(str(estimate.get('source', 'unknown')))})"


def _list(key: str, items: tuple[Any, ...]) -> str:
    if key == "color" and len(items) in (3, 4) and all(_is_number(v) and 0 <= v <= 1 for v in items):
        return "#" + "".join(f"{round(255 * v):02x}" for v in items)
    if key in _TIMES:
        return " × ".join(value("", v) for v in items)
    if len(items) > FEW or any(isinstance(v, tuple | list | dict) for v in items):
        return f"{len(items)} value{'s' if len(items) != 1 else ''}"
    return joined(value("", v) for v in items)


def _is_number(item: Any) -> bool:
    return isinstance(item, int | float) and not isinstance(item, bool)


def _same_digits(old: float, new: float) -> tuple[str, str]:
    texts = number(old), number(new)
    if any("e" in t or "n" in t for t in texts):
        return texts
    digits = max(len(t.partition(".")[2]) for t in texts)
    return f"{old:.{digits}f}", f"{new:.{digits}f}"


Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]

# Smallest reported translation [m]; smaller values are rounding errors, because positions have six decimals.
STILL_M = 5e-7

# Smallest reported rotation [deg]; smaller values are rounding errors of quaternions with six decimals.
STILL_DEG = 5e-4

# Maximum angle [deg] between a rotation axis and x, y or z at which the rotation is reported as about that axis.
AXIS_DEG = 1.0


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


def motion_words(found: PoseChange) -> list[str]:
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
    """Return a readable unit for a length, with the conversion factor from meters and the number of decimals."""
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
