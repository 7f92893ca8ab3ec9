"""Numbers of a stage as people write them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class StageNote:
    """Something in a stage that the document cannot say: the path of the prim, what it is, and what to do."""

    prim: str
    message: str
    hint: str = ""


def short(value: float) -> float:
    """The shortest number that is the same in single precision, in which USD keeps most: 0.31, not 0.310000002."""
    return float(format(value, ".6g"))


def srgb(linear: Iterable[float]) -> tuple[float, ...]:
    """A colour as displayed, each part to three digits, of scene-linear red, green and blue."""
    rgb = np.clip(np.array(list(linear), dtype=np.float64), 0.0, 1.0)
    shown = np.where(rgb <= 0.0031308, rgb * 12.92, 1.055 * np.maximum(rgb, 0.0031308) ** (1 / 2.4) - 0.055)
    return tuple(round(float(v), 3) for v in shown)


def as_name(text: str, taken: Iterable[str]) -> str:
    """A name of the language for a prim, which none of ``taken`` has."""
    word = "".join(c if c.isascii() and c.isalnum() else "_" for c in text.lower()).strip("_")
    word = word[:60] if word[:1].isalpha() else f"thing_{word}"[:60].rstrip("_")
    used, k, name = set(taken), 2, word
    while name in used:
        name, k = f"{word}_{k}", k + 1
    return name
