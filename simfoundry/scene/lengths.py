"""Lengths and coordinates as people write them."""

from __future__ import annotations

import math


def length(metres: float) -> str:
    """A length with a unit that suits it: ``3.2 mm``, ``4.5 cm``, ``1.25 m``."""
    if not math.isfinite(metres) or metres >= 1:
        return f"{metres:.2f} m"
    return f"{metres * 1000:.1f} mm" if metres < 0.0095 else f"{metres * 100:.1f} cm"


def number(value: float) -> str:
    """A coordinate [m] to a tenth of a millimetre, without zeros at its end."""
    return f"{round(value, 4) + 0.0:.4f}".rstrip("0").rstrip(".")
