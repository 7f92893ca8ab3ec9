"""Names and masses of objects without a model: from shape and color, by tables.

The bulk densities are ranges of filled household packages and vessels, in which the published masses and sizes of the
YCB objects lie (cracker box 160 kg/m^3, sugar box 700, soup can 940, bleach bottle 1,000). They are estimates: the spec
says so, with the range.
"""

from __future__ import annotations

import colorsys
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from simfoundry.geometry.shapes import Box, Capsule, Cylinder, Geometry, Sphere


class ShapeKind(StrEnum):
    """Kind of an object as its shape suggests it."""

    BOX = "box"
    CAN = "can"
    BALL = "ball"
    BOWL = "bowl"
    OBJECT = "object"


@dataclass(frozen=True)
class MaterialPrior:
    """A row of the material table: densities [kg/m^3] over the solid volume, and the Coulomb friction coefficient."""

    name: str
    density: float
    lowest: float
    highest: float
    friction: float


# Densities: the range of YCB objects of the kind (see above); frictions: estimates for such surfaces on wood.
TABLE = {
    ShapeKind.BOX: MaterialPrior("carton", 400, 150, 750, 0.4),
    ShapeKind.CAN: MaterialPrior("can", 700, 300, 1050, 0.35),
    ShapeKind.BALL: MaterialPrior("fruit", 800, 100, 1050, 0.5),
    ShapeKind.BOWL: MaterialPrior("crockery", 1800, 900, 2500, 0.35),
    ShapeKind.OBJECT: MaterialPrior("package", 600, 150, 1100, 0.4),
}
SUPPORT = MaterialPrior("table_top", 700, 500, 900, 0.5)

# Upper limits of hue [deg] of the English color words, read off the HSV circle.
_HUES = ((15, "red"), (40, "orange"), (68, "yellow"), (165, "green"), (195, "cyan"), (260, "blue"), (320, "purple"))


def kind_of(geometry: Geometry, hollow: bool) -> ShapeKind:
    """Classify a fitted shape."""
    match geometry:
        case Box():
            return ShapeKind.BOX
        case Cylinder() | Capsule():
            return ShapeKind.CAN
        case Sphere():
            return ShapeKind.BALL
    return ShapeKind.BOWL if hollow else ShapeKind.OBJECT


def color_word(rgb: tuple[float, float, float]) -> str:
    """Return a plain English word for an sRGB color in [0, 1]."""
    hue, saturation, value = colorsys.rgb_to_hsv(*rgb)
    if value < 0.2:
        return "black"
    if saturation < 0.18:
        return "white" if value > 0.65 else "gray"
    degrees = hue * 360
    if 10 <= degrees < 45 and value < 0.6:
        return "brown"
    if (degrees >= 320 or degrees < 15) and saturation < 0.45 and value > 0.6:
        return "pink"
    return next((word for limit, word in _HUES if degrees < limit), "red")


def unique_names(wanted: Iterable[str], taken: Iterable[str] = ()) -> list[str]:
    """Return the names with ``_2``, ``_3`` … appended to repeated ones."""
    used = set(taken)
    out = []
    for base in wanted:
        name, k = base, 2
        while name in used:
            name, k = f"{base}_{k}", k + 1
        used.add(name)
        out.append(name)
    return out
