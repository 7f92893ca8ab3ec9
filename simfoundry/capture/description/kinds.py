"""Kinds of objects by form and size, with priors of their material.

A kind is a guess, unless a model that sees (`read_scene`) names the object. Sizes are those of things on tables: a
solid of revolution that is 25 cm long and 7 cm wide is a bottle, and one of 10 cm is a can.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Literal

import numpy as np

from simfoundry.capture.shapes.fit import FittedShape
from simfoundry.geometry.shapes import Box, Capsule, Cylinder, Geometry, Sphere, tessellate
from simfoundry.spec.models.base import Material

Form = Literal["box", "round", "ball", "hollow", "open_box", "other"]


@dataclass(frozen=True)
class MaterialPrior:
    """The prior for the material of a kind of object.

    It consists of the expected density [kg/m^3], the range of the density, and the friction coefficient of the surface.
    """

    name: str
    density: float
    lowest: float
    highest: float
    friction: float

    @property
    def material(self) -> Material:
        """The material as a scene states it."""
        return Material(density=self.density, friction=self.friction, rolling_friction=ROLLING)


# Resistance to rolling [m]: handbooks state 0.5 mm and more for hard rollers on wood. Without it, a can that lies on
# its side rolls away in PyBullet as soon as its pose is rounded by 0.01 deg.
ROLLING = 5e-4

# Density ranges were measured on YCB objects of the same kind, as mass divided by the volume of the solid. Friction
# coefficients are estimates for contact with wood.
CARTON = MaterialPrior("carton", 400, 150, 750, 0.4)
CAN = MaterialPrior("can", 700, 300, 1050, 0.35)
FRUIT = MaterialPrior("fruit", 800, 100, 1050, 0.5)
CROCKERY = MaterialPrior("crockery", 1800, 900, 2500, 0.35)
PACKAGE = MaterialPrior("package", 600, 150, 1100, 0.4)
PLASTIC = MaterialPrior("plastic", 900, 100, 1100, 0.35)
SUPPORT = MaterialPrior("table_top", 700, 500, 900, 0.5)

# Materials by the words of a model: handbook densities of the substance, whose range reaches down to that of hollow
# things, and friction on wood.
MATERIALS = {
    "cardboard": CARTON,
    "paper": CARTON,
    "ceramic": CROCKERY,
    "porcelain": CROCKERY,
    "glass": MaterialPrior("glass", 2500, 500, 2600, 0.3),
    "steel": MaterialPrior("steel", 7800, 500, 8000, 0.35),
    "aluminum": MaterialPrior("aluminum", 2700, 100, 2800, 0.35),
    "metal": MaterialPrior("metal", 5000, 100, 8000, 0.35),
    "plastic": PLASTIC,
    "rubber": MaterialPrior("rubber", 1100, 100, 1300, 0.8),
    "wood": MaterialPrior("wood", 650, 300, 900, 0.5),
    "fabric": MaterialPrior("fabric", 300, 50, 600, 0.6),
    "food": FRUIT,
    "fruit": FRUIT,
}


@dataclass(frozen=True)
class ObjectKind:
    """A kind of object.

    Attributes:
        name: Noun, which becomes its category.
        material: Prior of its material.
        forms: Forms that it may have.
        length: Its longest side [m], from and to.
        width: Its middle side [m], from and to.
        slenderness: Longest side divided by the middle one, from and to.
        flatness: Height divided by the diameter of an open container, from and to.
        roundness: Least ratio of its shortest side to its middle one.
    """

    name: str
    material: MaterialPrior
    forms: tuple[Form, ...]
    length: tuple[float, float] = (0.0, inf)
    width: tuple[float, float] = (0.0, inf)
    slenderness: tuple[float, float] = (0.0, inf)
    flatness: tuple[float, float] = (0.0, inf)
    roundness: float = 0.0


# The first kind that fits is taken. Plates and trays are at most a fifth as high as wide, bowls three quarters; cups
# and mugs are 5 to 12 cm wide. Bottles are about twice as long as wide or longer, and pens at most 2.5 cm thick.
KINDS = (
    ObjectKind("plate", CROCKERY, ("hollow",), flatness=(0.0, 0.2), length=(0.12, inf)),
    ObjectKind("cup", CROCKERY, ("hollow",), flatness=(0.75, 2.0), width=(0.05, 0.12), length=(0.05, 0.16)),
    ObjectKind("bowl", CROCKERY, ("hollow",)),
    ObjectKind("tray", PLASTIC, ("open_box",), flatness=(0.0, 0.2)),
    ObjectKind("bin", CARTON, ("open_box",)),
    ObjectKind("ball", FRUIT, ("ball",)),
    ObjectKind("pen", PLASTIC, ("round", "box", "other"), (0.08, 0.2), (0.0, 0.025), slenderness=(4.0, inf)),
    ObjectKind("bottle", PLASTIC, ("round", "other"), (0.14, 0.4), (0.035, 0.12), (1.9, inf), roundness=0.65),
    ObjectKind("can", CAN, ("round",)),
    ObjectKind("box", CARTON, ("box",)),
    ObjectKind("object", PACKAGE, ("other",)),
)


def kind_of(shape: FittedShape) -> ObjectKind:
    """Return the kind of object that a fitted solid suggests."""
    form = _form_of(shape)
    extent = np.ptp(tessellate(shape.geometry).vertices, axis=0)
    flatness = float(extent[2] / max(extent[0], extent[1], 1e-9))
    short, middle, long = (max(float(side), 1e-9) for side in np.sort(extent))
    measures = {"length": long, "width": middle, "slenderness": long / middle, "flatness": flatness}
    return next(
        kind
        for kind in KINDS
        if form in kind.forms
        and short / middle >= kind.roundness
        and all(getattr(kind, name)[0] <= value <= getattr(kind, name)[1] for name, value in measures.items())
    )


def material_of(words: str) -> MaterialPrior | None:
    """Return the prior of the material that the words of a model name, or None if they name none that is known."""
    return next((prior for word, prior in MATERIALS.items() if word in words.lower()), None)


def _form_of(shape: FittedShape) -> Form:
    if shape.wall > 0:
        return "open_box"
    if shape.hollow:
        return "hollow"
    if shape.profile is not None:
        return "round"
    forms: dict[type[Geometry], Form] = {Sphere: "ball", Cylinder: "round", Capsule: "round", Box: "box"}
    return forms.get(type(shape.geometry), "other")
