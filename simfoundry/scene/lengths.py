"""Format lengths and coordinates in human-readable form."""

from __future__ import annotations

import math


def length(meters: float) -> str:
    """Format a length with a suitable unit, as in ``3.2 mm``, ``4.5 cm`` or ``1.25 m``."""
    if not math.isfinite(meters) or meters >= 1:
        return f"{meters:.2f} m"
    return f"{meters * 1000:.1f} mm" if meters < 0.0095 else f"{meters * 100:.1f} cm"


def number(value: float) -> str:
    """Format a coordinate [m] with a resolution of a tenth of a millimeter, without trailing zeros."""
    return f"{round(value, 4) + 0.0:.4f}".rstrip("0").rstrip(".")
