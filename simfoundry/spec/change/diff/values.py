"""Describe values of documents: numbers with their units, colors, shapes, places."""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import lru_cache
from typing import Any

from pydantic_core import PydanticUndefined

from simfoundry.spec.models.base import Model
from simfoundry.spec.models.types import models_at
from simfoundry.spec.yaml.write import number

LONGEST = 48
"""Longest text shown [characters]; two of them fit on one line of changes."""

FEW = 4
"""Length of the longest list of numbers that is written out: a quaternion."""

FREE_TEXTS = ("description", "instruction", "note")
"""Fields that contain prose."""

_UNIT = re.compile(r"\[([^\]]+)\]")
_TIMES = ("size", "grid", "box")
"""Lists that are formatted as ``a × b``."""


def joined(items: Iterable[str]) -> str:
    """Join items as ``(a, b, c)``."""
    return f"({', '.join(items)})"


@lru_cache(maxsize=4096)
def unit(model: type[Model] | None, path: tuple[str, ...]) -> str:
    """Return the unit of a field from the brackets in its description; empty if it has none."""
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
            return _text(item) if key in FREE_TEXTS or " " in item or not item else shortened(item)
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


def _text(text: str) -> str:
    return f'"{shortened(text)}"'


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
