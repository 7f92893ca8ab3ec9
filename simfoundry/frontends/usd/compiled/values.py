"""Conversion of numbers, colors and names in a stage to readable document values."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from simfoundry.assets.mesh import srgb_of_linear
from simfoundry.frontends.draft import free_name


@dataclass(frozen=True)
class StageNote:
    """Note on content of a stage that the document cannot express: prim path, message, and remedy."""

    prim: str
    message: str
    hint: str = ""


def short(value: Any) -> Any:
    """Return data with the shortest numbers that are equal in single precision: 0.31, not 0.310000002."""
    if isinstance(value, dict):
        return {key: short(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return tuple(map(short, value))
    return float(format(value, ".6g"))


def srgb(linear: Iterable[float]) -> tuple[float, ...]:
    """Convert scene-linear red, green and blue to a display color with three digits per channel."""
    return tuple(round(srgb_of_linear(min(max(float(v), 0.0), 1.0)), 3) for v in linear)


def as_name(text: str, taken: Iterable[str]) -> str:
    """Return a valid document name for a prim that is not in ``taken``."""
    word = "".join(c if c.isascii() and c.isalnum() else "_" for c in text.lower()).strip("_")
    word = word[:60] if word[:1].isalpha() else f"thing_{word}"[:60].rstrip("_")
    return free_name(word, set(taken))
