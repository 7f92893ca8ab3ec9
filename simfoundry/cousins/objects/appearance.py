"""What things of a kind look like, are made of and measure: tables, for appearance and for what is plausible."""

from __future__ import annotations

import re
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from simfoundry.cousins.objects.components import Component, Kind
from simfoundry.cousins.objects.geometry import Edit, Rng
from simfoundry.cousins.objects.parts import Key, parts_of, with_parts
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.base import Material

Color = tuple[float, float, float]


@dataclass(frozen=True)
class Stuff:
    """A material: ``density`` [kg/m^3] from lowest to highest, ``friction``, ``restitution`` and colours that it has.

    Without ``colors`` it takes any that the thing may have.
    """

    density: tuple[float, float]
    friction: float
    restitution: float
    colors: tuple[Color, ...] = ()

    @property
    def middle(self) -> float:
        """The density to write [kg/m^3]."""
        return round((self.density[0] + self.density[1]) / 2, -1)


@dataclass(frozen=True)
class Sort:
    """Things of one kind: the longest side [m] and the mass [kg] from least to most, colours, materials of the body.

    Densities, sizes and masses are of everyday things as one knows them, not from measurements: wide ranges on purpose.
    """

    size: tuple[float, float]
    mass: tuple[float, float]
    colors: tuple[Color, ...]
    stuffs: tuple[str, ...]


WHITE, CREAM, GREY, BLACK = (0.94, 0.94, 0.92), (0.93, 0.88, 0.76), (0.55, 0.56, 0.58), (0.11, 0.11, 0.12)
RED, ORANGE, YELLOW, GREEN = (0.78, 0.14, 0.13), (0.94, 0.5, 0.12), (0.95, 0.79, 0.24), (0.24, 0.55, 0.3)
BLUE, TEAL, NAVY, PURPLE = (0.17, 0.38, 0.74), (0.16, 0.56, 0.56), (0.13, 0.18, 0.36), (0.45, 0.24, 0.55)
PINK, BROWN, SAND, SAGE = (0.92, 0.6, 0.67), (0.42, 0.27, 0.17), (0.8, 0.69, 0.53), (0.62, 0.71, 0.6)
STEEL, COPPER = (0.76, 0.77, 0.79), (0.72, 0.45, 0.3)
PAINTS = (WHITE, CREAM, GREY, BLACK, RED, ORANGE, YELLOW, GREEN, BLUE, TEAL, NAVY, PURPLE, PINK, BROWN, SAND, SAGE)
WOODS = (SAND, (0.72, 0.53, 0.34), (0.55, 0.38, 0.24), (0.38, 0.26, 0.18), (0.86, 0.77, 0.62))

STUFFS = MappingProxyType(
    {
        "plastic": Stuff((900, 1100), 0.4, 0.2),
        "paper": Stuff((600, 800), 0.5, 0.1, (WHITE, CREAM, SAND, (0.86, 0.3, 0.26), (0.3, 0.52, 0.72))),
        "ceramic": Stuff((2200, 2500), 0.35, 0.1),
        "stoneware": Stuff((2000, 2300), 0.4, 0.1, (CREAM, SAGE, GREY, BROWN, NAVY, TEAL)),
        "melamine": Stuff((1450, 1550), 0.35, 0.2),
        "steel": Stuff((7700, 8000), 0.4, 0.1, (STEEL, (0.62, 0.63, 0.65))),
        "aluminium": Stuff((2600, 2800), 0.4, 0.15, (STEEL, (0.85, 0.86, 0.87), BLACK)),
        "enamel": Stuff((2600, 2900), 0.4, 0.1, (RED, WHITE, NAVY, SAGE, ORANGE, BLACK)),
        "bamboo": Stuff((600, 800), 0.5, 0.2, WOODS),
        "wood": Stuff((550, 750), 0.5, 0.2),
        "board": Stuff((600, 800), 0.5, 0.2),
        "carton": Stuff((250, 450), 0.5, 0.1, ((0.62, 0.44, 0.27), (0.71, 0.55, 0.36), WHITE, (0.35, 0.3, 0.26))),
        "felt": Stuff((150, 250), 0.6, 0.05),
        "foam": Stuff((200, 400), 0.6, 0.1),
        "vinyl": Stuff((850, 1000), 0.6, 0.1),
        "glass": Stuff((2400, 2600), 0.3, 0.1, ((0.72, 0.83, 0.82), (0.55, 0.7, 0.62), (0.6, 0.66, 0.76))),
    }
)

_TABLEWARE = ("ceramic", "stoneware", "melamine", "enamel")

SORTS = MappingProxyType(
    {
        "cup": Sort((0.06, 0.15), (0.004, 0.6), PAINTS, ("plastic", "paper", "melamine", "bamboo")),
        "mug": Sort((0.07, 0.16), (0.1, 0.8), PAINTS, _TABLEWARE),
        "bowl": Sort((0.09, 0.3), (0.05, 1.6), PAINTS, (*_TABLEWARE, "bamboo", "glass")),
        "plate": Sort((0.14, 0.34), (0.05, 1.8), PAINTS, _TABLEWARE),
        "organizer": Sort((0.15, 0.5), (0.1, 2.5), PAINTS, ("plastic", "bamboo", "board")),
        "bottle": Sort((0.1, 0.34), (0.05, 1.8), PAINTS, ()),
        "pot": Sort(
            (0.12, 0.45), (0.3, 4.5), (RED, WHITE, NAVY, SAGE, ORANGE, BLACK, STEEL, COPPER), ("enamel", "aluminium")
        ),
        "stove": Sort((0.25, 0.8), (1.5, 30.0), (STEEL, BLACK, WHITE, CREAM, RED, GREY), ()),
        "cabinet": Sort(
            (0.18, 0.8), (1.0, 25.0), (*WOODS, WHITE, CREAM, GREY, SAGE, NAVY), ("wood", "board", "bamboo")
        ),
        "can": Sort((0.14, 0.6), (0.2, 5.0), PAINTS, ("plastic",)),
        "box": Sort(
            (0.1, 0.7),
            (0.04, 3.5),
            ((0.62, 0.44, 0.27), SAND, BROWN, WHITE, CREAM, GREY, SAGE, NAVY),
            ("carton", "board"),
        ),
        "marker": Sort(
            (0.09, 0.17), (0.005, 0.07), (BLACK, RED, BLUE, GREEN, ORANGE, PURPLE, PINK, BROWN), ("plastic",)
        ),
        "eraser": Sort((0.06, 0.2), (0.01, 0.25), (BLACK, BLUE, GREY, NAVY, GREEN, RED, YELLOW), ("plastic",)),
        "cube": Sort((0.02, 0.12), (0.005, 0.8), PAINTS, ("wood", "plastic", "foam")),
        "apple": Sort(
            (0.055, 0.12),
            (0.06, 0.4),
            (RED, (0.86, 0.22, 0.2), (0.6, 0.1, 0.12), (0.55, 0.7, 0.2), (0.82, 0.76, 0.3), (0.87, 0.45, 0.25)),
            (),
        ),
        "banana": Sort(
            (0.11, 0.28),
            (0.05, 0.35),
            (
                (0.96, 0.82, 0.2),
                (0.62, 0.72, 0.22),
                (0.45, 0.62, 0.2),
                (0.86, 0.7, 0.16),
                (0.98, 0.88, 0.42),
                (0.78, 0.58, 0.14),
            ),
            (),
        ),
        "grapes": Sort(
            (0.05, 0.25),
            (0.02, 0.9),
            ((0.42, 0.2, 0.52), (0.55, 0.68, 0.28), (0.3, 0.12, 0.2), (0.62, 0.22, 0.3), (0.2, 0.16, 0.34)),
            (),
        ),
        "baseball": Sort(
            (0.068, 0.0765),
            (0.11, 0.19),
            (
                (0.94, 0.93, 0.89),
                (0.86, 0.82, 0.7),
                (0.9, 0.86, 0.3),
                (0.92, 0.55, 0.2),
                (0.75, 0.62, 0.48),
                (0.6, 0.78, 0.9),
                RED,
                NAVY,
                BLACK,
                PINK,
                GREEN,
            ),
            (),
        ),
        "tennis_ball": Sort(
            (0.061, 0.0725),
            (0.04, 0.08),
            (
                (0.8, 0.9, 0.22),
                (0.7, 0.84, 0.3),
                (0.95, 0.55, 0.2),
                (0.94, 0.5, 0.66),
                (0.35, 0.62, 0.85),
                (0.92, 0.28, 0.24),
            ),
            (),
        ),
        "burger": Sort(
            (0.05, 0.16),
            (0.02, 0.5),
            ((0.84, 0.57, 0.27), (0.72, 0.43, 0.2), (0.9, 0.68, 0.4), (0.6, 0.36, 0.18), (0.25, 0.2, 0.17)),
            (),
        ),
    }
)
"""By the last word of a category that is here: a `blue_cup` is a cup."""

WORDS = MappingProxyType({"carton": "box", "tumbler": "cup", "cooking_pot": "pot", "trash_can": "can", "block": "cube"})


def sort_of(category: str) -> Sort | None:
    """What is known of things of a category, as `blue_cup`; None of one that is not here."""
    if category in SORTS or category in WORDS:
        return SORTS[WORDS.get(category, category)]
    for word in reversed(re.split(r"[_\d]+", category)):
        if word in SORTS or word in WORDS:
            return SORTS[WORDS.get(word, word)]
    return None


def same_kind(a: str, b: str) -> bool:
    """Whether two categories or names are of one kind: a `blue_cup` is a `cup`, and a `tumbler_2` too."""
    one, other = sort_of(a), sort_of(b)
    if one is not None or other is not None:
        return one is other
    a, b = (re.sub(r"[_\d]+$", "", text).split("_")[-1] for text in (a, b))
    return a == b != ""


JITTER = 0.035
"""Colours differ by up to this much from those of the tables, so that no two paints are the same."""


def recolor(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Another colour for all of the body that has one colour now."""
    sort = sort_of(spec.category or spec.name)
    color = varied(_other(color_of(spec, component.parts[0]), sort.colors if sort is not None else PAINTS, rng), rng)
    return recolored(spec, component, color), f"{component.name} {_shown(color)}"


def restuff(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Another material for the body, with its density, friction and one of its colours."""
    sort = sort_of(spec.category or spec.name)
    old = _material(spec, component.parts[0])
    choices = [name for name in (sort.stuffs if sort is not None else ()) if name != old]
    if old is None or not choices or spec.materials[old].density is None:
        return None
    name = choices[int(rng.integers(0, len(choices)))]
    stuff = STUFFS[name]
    color = varied(
        _other(color_of(spec, component.parts[0]), stuff.colors or (sort.colors if sort else PAINTS), rng), rng
    )
    made = recolored(spec, component, color)
    return _remade(made, old, name, stuff), f"of {name}, {_shown(color)}"


def recolored(spec: AssetSpec, component: Component, color: Color) -> AssetSpec:
    """The asset with the colour of a component's first part, wherever its link has that, replaced."""
    old = color_of(spec, component.parts[0])
    parts = parts_of(spec)
    if component.kind in ACCENTS:
        own = {key: parts[key].model_copy(update={"color": color}) for key in component.parts}
        return with_parts(spec, parts | own)
    changed = {}
    for key, part in parts.items():
        if component.kind is Kind.BUNCH and key in component.parts:
            changed[key] = part.model_copy(update={"color": _shaded(color, color_of(spec, key), old)})
            continue
        # What is attached and has a colour of its own keeps it.
        same = key[0] == component.link and color_of(spec, key) == old
        changed[key] = part.model_copy(update={"color": color}) if same else part
    return _gathered(with_parts(spec, changed), component.link, color)


def _shaded(color: Color, own: Color | None, first: Color | None) -> Color:
    """The colour as much lighter or darker as a berry's own is than the first's."""
    share = 1.0 if own is None or first is None else float(np.clip(sum(own) / max(sum(first), 0.1), 0.6, 1.4))
    r, g, b = (round(min(v * share, 0.98), 3) for v in color)
    return r, g, b


def _gathered(spec: AssetSpec, link: str, color: Color) -> AssetSpec:
    """A colour that every part of a link has is said once, of the link."""
    body = spec.links[link]
    if any(part.color != color for part in body.parts.values() if part.use != "visual" or part.color is None):
        return spec
    parts = {n: p.model_copy(update={"color": None}) if p.color == color else p for n, p in body.parts.items()}
    return spec.model_copy(
        update={"links": {**spec.links, link: body.model_copy(update={"parts": parts, "color": color})}}
    )


def color_of(spec: AssetSpec, key: Key) -> Color | None:
    """The colour that a document gives a part: its own, its link's, or its material's."""
    body = spec.links[key[0]]
    part = body.parts[key[1]]
    material = part.material or body.material
    own = spec.materials[material].color if material is not None else None
    for color in (part.color, body.color, own):
        if color is not None:
            r, g, b = color[:3]
            return r, g, b
    return None


def _material(spec: AssetSpec, key: Key) -> str | None:
    body = spec.links[key[0]]
    return body.parts[key[1]].material or body.material


def _remade(spec: AssetSpec, old: str, name: str, stuff: Stuff) -> AssetSpec:
    """The asset with one material replaced everywhere; a link whose mass was given weighs by the new density."""
    made = Material(density=stuff.middle, friction=stuff.friction, restitution=stuff.restitution)
    materials = {name if n == old else n: made if n == old else m for n, m in spec.materials.items()}
    links = {}
    for own, body in spec.links.items():
        parts = {n: p.model_copy(update={"material": name}) if p.material == old else p for n, p in body.parts.items()}
        changes: dict[str, object] = {"parts": parts}
        if body.material == old:
            changes["material"] = name
        links[own] = body.model_copy(update=changes)
    return spec.model_copy(update={"materials": materials, "links": links})


def _other(color: Color | None, palette: tuple[Color, ...], rng: Rng) -> Color:
    """One of the colours that is not near the present one."""
    far = [c for c in palette if color is None or sum(abs(a - b) for a, b in zip(c, color, strict=True)) > 0.3]
    return (far or list(palette))[int(rng.integers(0, len(far or palette)))]


def varied(color: Color, rng: Rng) -> Color:
    """Nearly the same colour."""
    r, g, b = (round(float(np.clip(v + rng.uniform(-JITTER, JITTER), 0.02, 0.98)), 3) for v in color)
    return r, g, b


def _shown(color: Color) -> str:
    return "#" + "".join(f"{round(255 * v):02x}" for v in color)


ACCENTS = (Kind.HANDLE, Kind.KNOB, Kind.CAP, Kind.BAND)
"""Components that have a colour for themselves."""

APPEARANCE = (
    (recolor, (Kind.VESSEL, Kind.TURNED, Kind.CRATE, Kind.STACK, Kind.BUNCH, Kind.BODY)),
    (recolor, (Kind.HANDLE, Kind.KNOB, Kind.LID, Kind.DRAWER, Kind.CAP, Kind.BAND)),
    (restuff, (Kind.VESSEL, Kind.CRATE, Kind.BODY)),
)
"""What can be done to which components."""
