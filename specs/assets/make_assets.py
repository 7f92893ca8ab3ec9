"""Makes the mesh assets of this folder: ``python specs/assets/make_assets.py``. The same files on every machine."""

from __future__ import annotations

import math
from pathlib import Path

HERE = Path(__file__).parent
SIDES = 40


def lathe(profile: list[tuple[float, float]]) -> str:
    """OBJ text of a closed profile of (radius, height) [m], revolved about z; it starts and ends on the axis."""
    lines = [f"v 0 0 {profile[0][1]:.6g}"]
    for radius, height in profile[1:-1]:
        for k in range(SIDES):
            angle = 2 * math.pi * k / SIDES
            lines.append(f"v {radius * math.cos(angle):.6f} {radius * math.sin(angle):.6f} {height:.6g}")
    lines.append(f"v 0 0 {profile[-1][1]:.6g}")
    rings = len(profile) - 2
    last = 2 + rings * SIDES
    for k in range(SIDES):
        here, after = k, (k + 1) % SIDES
        lines.append(f"f 1 {2 + after} {2 + here}")
        for ring in range(rings - 1):
            low, high = 2 + ring * SIDES, 2 + (ring + 1) * SIDES
            lines.append(f"f {low + here} {low + after} {high + after}")
            lines.append(f"f {low + here} {high + after} {high + here}")
        top = 2 + (rings - 1) * SIDES
        lines.append(f"f {last} {top + here} {top + after}")
    return "\n".join(lines) + "\n"


def bowl() -> str:
    """A bowl of 16 cm across and 6 cm high with 4 mm walls: up the outside, over the rim, down the inside."""
    levels = [0.0, 0.15, 0.35, 0.6, 0.85, 1.0]
    outside = [(0.035 + 0.045 * math.sqrt(t), 0.06 * t) for t in levels]
    inside = [(r - 0.004, max(z, 0.004)) for r, z in reversed(outside)]
    return lathe([(0.0, 0.0), *outside, *inside, (0.0, 0.004)])


if __name__ == "__main__":
    (HERE / "bowl.obj").write_text(bowl(), encoding="utf-8")
