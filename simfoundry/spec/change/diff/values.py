"""Describe document values: numbers with units, colors, shapes, places, and motion between poses."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from simfoundry.spec.models.base import Model
from simfoundry.spec.models.types import models_at
from simfoundry.spec.yaml.write import number

# Maximum length of a displayed text [characters], so that two texts fit on one line.
LONGEST = 48

# Maximum number of items in a list that is shown in full; a quaternion has four.
FEW = 4

# Fields that contain prose.
FREE_TEXTS = ("description", "instruction", "note")

_UNIT = re.compile(r"\[([^\]]+)\]")
# Lists that are formatted as ``a × b``.
_TIMES = ("size", "grid", "box")


def joined(items: Iterable[str]) -> str:
    """Join items into a text such as ``(a, b, c)``."""
    return f"({', '.join(items)})"


def _definitions(model: type[Model] | None, path: tuple[str, ...]) -> Iterator[FieldInfo]:
    """Yield the possible definitions of the field at ``path``."""
    return (owner.model_fields[path[-1]] for owner in models_at(model, path[:-1]) if path[-1] in owner.model_fields)


@lru_cache(maxsize=4096)
def unit(model: type[Model] | None, path: tuple[str, ...]) -> str:
    """Return the unit given in brackets in a field's description, or an empty string if there is none."""
    found = (_UNIT.search(info.description or "") for info in _definitions(model, path))
    return next((match[1].partition(",")[0] for match in found if match), "")


@lru_cache(maxsize=4096)
def default(model: type[Model] | None, path: tuple[str, ...]) -> Any:
    """Return the default of a field if it is a plain value, or None otherwise."""
    found = (info.default for info in _definitions(model, path))
    return next((v for v in found if v is not PydanticUndefined and not isinstance(v, Model | dict)), None)


def pair(key: str, old: Any, new: Any, unit: str = "") -> str:
    """Describe a change, such as ``0.20 → 0.31 kg``. Both values use the same format, and the unit appears once."""
    if _is_number(old) and _is_number(new):
        left, right = _same_digits(old, new)
    else:
        left, right = value(key, old), value(key, new)
    if left == right and not isinstance(old, str):
        left, right = str(old), str(new)
    return f"{left} → {with_unit(right, unit)}"


def value(key: str, item: Any) -> str:
    """Describe ``item``, which is the value of a field called ``key``."""
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
    """Insert a unit after a number but before any text in parentheses."""
    if not unit or text.endswith("°") or not text or not (text[0].isdigit() or text[0] in "-.("):
        return text
    plain, bracket, rest = text.partition(" (")
    return f"{plain} {unit}{bracket}{rest}"


def shape(item: Any) -> str:
    """Describe a shape, such as ``box 0.1 × 0.1 × 0.2 m`` or ``cylinder of radius 0.04 and height 0.1 m``."""
    match item:
        case {"box": size}:
            return f"box {_list('box', size)} m"
        case {"sphere": radius}:
            return f"sphere of radius {number(radius)} m"
        case {"ellipsoid": radii}:
            return f"ellipsoid of radii {_list('box', radii)} m"
        case {"open_box": {"size": size, "wall": wall}}:
            return f"open box {_list('box', size)} m with {number(wall)} m walls"
        case {"compound": dict(parts)}:
            return f"compound of {len(parts)} part{'s' * (len(parts) != 1)}"
        case {"prism": {"outline": outline, "height": height}}:
            return f"prism of {len(outline)} corners and height {number(height)} m"
        case {"lathe": {"profile": profile}}:
            return f"lathe of {len(profile)} corners"
        case (
            {"cylinder": {"radius": r, "height": h}}
            | {"capsule": {"radius": r, "height": h}}
            | {"cone": {"radius": r, "height": h}}
        ):
            return f"{next(iter(item))} of radius {number(r)} and height {number(h)} m"
    return value("shape", item)


def place(item: dict[str, Any]) -> str:
    """Describe a place, such as ``on desk at (0.45, 0.1) m`` or ``on desk, left of plate``."""
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
    """Shorten a text to fit on one line."""
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
Quaternion = tuple[float, float, float, float]

# Smallest reported translation [m]; smaller values are rounding errors, because positions have six decimals.
STILL_M = 5e-7

# Smallest reported rotation [deg]; smaller values are rounding errors of quaternions with six decimals.
STILL_DEG = 5e-4

# Maximum angle [deg] between a rotation axis and a coordinate axis for the rotation to be reported as about x, y or z.
AXIS_DEG = 1.0

# Length units, each with the smallest length [m] reported in it, the number of units per meter, the symbol, and the
# number of decimals. The limits account for rounding, so that 0.9996 m is reported as 1.000 m.
_SCALES = ((0.9995, 1.0, "m", 3), (0.00995, 100.0, "cm", 1), (5e-5, 1000.0, "mm", 1), (0.0, 1e6, "µm", 1))


@dataclass(frozen=True)
class PoseChange:
    """The motion between two poses in the same parent frame.

    Attributes:
        shift: The translation [m].
        angle: The angle of the rotation [deg].
        axis: The axis of the rotation, a unit vector.
    """

    shift: Vector
    angle: float
    axis: Vector

    @property
    def moved(self) -> bool:
        """Return True if the positions differ by more than rounding errors."""
        return math.hypot(*self.shift) > STILL_M

    @property
    def turned(self) -> bool:
        """Return True if the rotations differ by more than rounding errors."""
        return self.angle > STILL_DEG


def motion(old: Mapping[str, Any], new: Mapping[str, Any]) -> PoseChange:
    """Return the motion between two poses, which are given as document data."""
    if any(isinstance(pose.get("look_at"), str) for pose in (old, new)):
        # The rotation depends on the position of another object.
        return PoseChange(_minus(_xyz(new), _xyz(old)), 0.0, (0.0, 0.0, 1.0))
    return PoseChange(_minus(_xyz(new), _xyz(old)), *_turn(_rotation(old), _rotation(new)))


def motion_words(found: PoseChange) -> list[str]:
    """Describe a motion with phrases such as ``moved 3.2 cm (+x 3.0, +y 1.1)`` and ``turned 12.0° about z``."""
    moved, turned = f"moved {_distance(found.shift)}", f"turned {_angle(found.angle, found.axis)}"
    return [moved] * found.moved + [turned] * found.turned


def _xyz(pose: Mapping[str, Any]) -> Vector:
    x, y, z = pose.get("xyz") or (0.0, 0.0, 0.0)
    return x, y, z


def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _rotation(pose: Mapping[str, Any]) -> Quaternion:
    """Return the rotation of a pose as a quaternion (w, x, y, z), which is normalized except for rounding errors."""
    if pose.get("quat_wxyz") is not None:
        w, x, y, z = pose["quat_wxyz"]
        return w, x, y, z
    angles = pose.get("rpy_deg") or (0.0, 0.0, pose.get("yaw_deg") or 0.0)
    if isinstance(pose.get("look_at"), tuple | list):
        angles = _view_angles(_minus(pose["look_at"], _xyz(pose)))
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(math.radians(v) / 2), math.sin(math.radians(v) / 2)) for v in angles)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def _view_angles(direction: Vector) -> Vector:
    """Return the roll, pitch and yaw [deg] of an upright camera that looks along ``direction``.

    The x axis of the camera points right, its y axis down and its z axis forward. If the camera looks straight up, its
    x axis points along the parent's -x axis. If it looks straight down, its x axis points along +x.
    """
    x, y, z = direction
    level = math.hypot(x, y)
    if level < 1e-6 * math.hypot(level, z):
        return (0.0, 0.0, 180.0) if z > 0 else (180.0, 0.0, 0.0)
    return math.degrees(math.atan2(z, level)) - 90, 0.0, math.degrees(math.atan2(y, x)) - 90


def _turn(a: Quaternion, b: Quaternion) -> tuple[float, Vector]:
    """Return the angle [deg] and the unit axis (in the parent frame) of the rotation from ``a`` to ``b``."""
    (aw, ax, ay, az), (bw, bx, by, bz) = a, b
    w = bw * aw + bx * ax + by * ay + bz * az
    x = bx * aw - bw * ax + bz * ay - by * az
    y = by * aw - bw * ay + bx * az - bz * ax
    z = bz * aw - bw * az + by * ax - bx * ay
    sine = math.hypot(x, y, z)
    if sine < 1e-6:
        return math.degrees(2 * math.atan2(sine, abs(w))), (0.0, 0.0, 1.0)
    # For a rotation by 180 deg, both axis directions are equivalent; choose the one with a positive largest component.
    scale = math.copysign(1 / sine, w if abs(w) > 5e-7 else max(x, y, z, key=abs))
    return math.degrees(2 * math.atan2(sine, abs(w))), (scale * x, scale * y, scale * z)


def _distance(shift: Vector) -> str:
    length = math.hypot(*shift)
    factor, unit, digits = next((f, u, d) for least, f, u, d in _SCALES if length >= least)
    parts = [(name, factor * v) for name, v in zip("xyz", shift, strict=True)]
    shown = [f"{'+' if v > 0 else '-'}{name} {abs(v):.{digits}f}" for name, v in parts if round(abs(v), digits) > 0]
    return f"{factor * length:.{digits}f} {unit}" + (f" ({', '.join(shown)})" if shown else "")


def _angle(angle: float, axis: Vector) -> str:
    digits = 1 if angle >= 0.05 else 4
    for k, name in enumerate("xyz"):
        if abs(axis[k]) > math.cos(math.radians(AXIS_DEG)):
            half = angle > 180 - 10**-digits / 2  # both directions are equivalent
            return f"{'-' if axis[k] < 0 and not half else ''}{angle:.{digits}f}° about {name}"
    return f"{angle:.{digits}f}° about {joined([f'{v:z.2f}' for v in axis])}"
