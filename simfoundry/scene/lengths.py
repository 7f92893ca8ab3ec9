"""Format lengths and coordinates for people."""

from __future__ import annotations

import math


def length(metres: float) -> str:
    """Format a length with a suitable unit: ``3.2 mm``, ``4.5 cm``, ``1.25 m``."""
    if not math.isfinite(metres) or metres >= 1:
        return f"{metres:.2f} m"
    return f"{metres * 1000:.1f} mm" if metres < 0.0095 else f"{metres * 100:.1f} cm"


def number(value: float) -> str:
    """Format a coordinate [m] to a tenth of a millimetre, without trailing zeros."""
    return f"{round(value, 4) + 0.0:.4f}".rstrip("0").rstrip(".")
