"""Change the appearance of objects, and look up typical colors, materials, sizes and masses of object categories."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
import yaml

from simfoundry.cousins.objects.components import MAIN, Component, Key, Kind, parts_of, with_parts
from simfoundry.cousins.objects.geometry import Edit
from simfoundry.cousins.objects.profiles import Rng
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.base import Material

Color = tuple[float, float, float]


@dataclass(frozen=True)
class VariantMaterial:
    """A material for variants.

    ``density`` is a range [kg/m^3], and ``friction`` and ``restitution`` are coefficients. If ``colors`` is empty, the
    material can have any color that is listed for the object's category.
    """

    density: tuple[float, float]
    friction: float
    restitution: float
    colors: tuple[Color, ...] = ()

    @property
    def middle(self) -> float:
        """The middle of the density range [kg/m^3], which is written to documents."""
        return round((self.density[0] + self.density[1]) / 2, -1)


@dataclass(frozen=True)
class CategoryPrior:
    """The prior for an object category.

    It consists of ranges of the longest side [m] and the mass [kg], of colors, and of materials for the body. The sizes
    and masses are estimates for everyday objects rather than measurements, so the ranges are wide.
    """

    size: tuple[float, float]
    mass: tuple[float, float]
    colors: tuple[Color, ...]
    materials: tuple[str, ...] = ()


@dataclass(frozen=True)
class Priors:
    """The tables in ``priors.yaml``.

    Attributes:
        materials: Materials by name.
        categories: Categories by name.
        synonyms: Category names by synonym.
        paints: Colors of objects in unknown categories.
        white: The color white.
        patterns: Names of patterns, grouped by use.
    """

    materials: Mapping[str, VariantMaterial]
    categories: Mapping[str, CategoryPrior]
    synonyms: Mapping[str, str]
    paints: tuple[Color, ...]
    white: Color
    patterns: Mapping[str, Any]


@cache
def priors() -> Priors:
    """Load the tables from ``priors.yaml``."""
    text = files(__package__).joinpath("priors.yaml").read_text(encoding="utf-8")
    data = yaml.safe_load(text)
    colors = {name: tuple(rgb) for name, rgb in data["colors"].items()}

    def color_list(entries: list[Any] | str) -> tuple[Color, ...]:
        """Convert a palette name, or a list of color names, palettes and RGB values, to a list of colors."""
        found: list[Any] = []
        for entry in [entries] if isinstance(entries, str) else entries:
            if isinstance(entry, str) and entry in data["palettes"]:
                found += color_list(data["palettes"][entry])
            else:
                found.append(colors[entry] if isinstance(entry, str) else tuple(entry))
        return tuple(found)

    def fields(row: dict[str, Any]) -> dict[str, Any]:
        plain = {key: tuple(value) if isinstance(value, list) else value for key, value in row.items()}
        return plain | {"colors": color_list(row.get("colors", []))}

    materials = {name: VariantMaterial(**fields(row)) for name, row in data["materials"].items()}
    categories = {name: CategoryPrior(**fields(row)) for name, row in data["categories"].items()}
    return Priors(materials, categories, data["synonyms"], color_list("paints"), colors["white"], data["patterns"])


def category_prior(category: str) -> CategoryPrior | None:
    """Return the prior of a category such as `blue_cup`, or None if the category is unknown."""
    known = priors()
    for word in (category, *reversed(re.split(r"[_\d]+", category))):
        name = known.synonyms.get(word, word)
        if name in known.categories:
            return known.categories[name]
    return None


def same_kind(a: str, b: str) -> bool:
    """Return True if two names denote the same category.

    For example, `blue_cup` and `tumbler_2` are both cups.
    """
    one, other = category_prior(a), category_prior(b)
    if one is not None or other is not None:
        return one is other
    a, b = (re.sub(r"[_\d]+$", "", text).split("_")[-1] for text in (a, b))
    return a == b != ""


# Maximum random deviation of each channel from the colors in the tables, so that few objects have identical colors.
JITTER = 0.035


def recolor(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Change the color of a component and of all parts of its link that have the same color."""
    color = _another(spec, component, palette_of(spec), rng)
    return recolored(spec, component, color), f"{component.name} {_shown(color)}"


def change_material(spec: AssetSpec, component: Component, rng: Rng) -> Edit | None:
    """Change the material of the body, including its density, friction and color."""
    sort = category_prior(spec.category or spec.name)
    link, part = component.parts[0]
    old = spec.links[link].parts[part].material or spec.links[link].material
    choices = [name for name in (sort.materials if sort is not None else ()) if name != old]
    if old is None or not choices or spec.materials[old].density is None:
        return None
    name = choices[int(rng.integers(0, len(choices)))]
    color = _another(spec, component, priors().materials[name].colors or palette_of(spec), rng)
    return _remade(recolored(spec, component, color), old, name), f"of {name}, {_shown(color)}"


def recolored(spec: AssetSpec, component: Component, color: Color) -> AssetSpec:
    """Return the asset with a component recolored.

    All parts of the link with the same color as the component's first part are also recolored. This does not apply to
    components of a kind that usually differs in color from the body.
    """
    old = color_of(spec, component.parts[0])
    parts = parts_of(spec)
    if component.kind in ACCENTS:
        accents = {key: parts[key].model_copy(update={"color": color}) for key in component.parts}
        return with_parts(spec, parts | accents)
    for key, part in parts.items():
        own = color_of(spec, key)
        if component.kind is Kind.BUNCH and key in component.parts:
            parts[key] = part.model_copy(update={"color": _shaded(color, own, old)})
        elif key[0] == component.link and own == old:  # attached parts with a different color keep it
            parts[key] = part.model_copy(update={"color": color})
    return _gathered(with_parts(spec, parts), component.link, color)


def _shaded(color: Color, own: Color | None, first: Color | None) -> Color:
    """Return a color with its lightness scaled.

    The scale factor is the ratio of a part's original lightness to the lightness of the first part, within limits.
    """
    share = 1.0 if own is None or first is None else float(np.clip(sum(own) / max(sum(first), 0.1), 0.6, 1.4))
    r, g, b = (round(min(v * share, 0.98), 3) for v in color)
    return r, g, b


def _gathered(spec: AssetSpec, link: str, color: Color) -> AssetSpec:
    """Assign a color to a link instead of its parts if all parts of the link have that color."""
    body = spec.links[link]
    if any(part.color != color for part in body.parts.values() if part.use != "visual" or part.color is None):
        return spec
    parts = {n: p.model_copy(update={"color": None}) if p.color == color else p for n, p in body.parts.items()}
    links = {**spec.links, link: body.model_copy(update={"parts": parts, "color": color})}
    return spec.model_copy(update={"links": links})


def color_of(spec: AssetSpec, key: Key) -> Color | None:
    """Return the color of a part, or None if no color is specified.

    If the part itself has no color, the color of its link is used, and otherwise the color of its material.
    """
    body = spec.links[key[0]]
    part = body.parts[key[1]]
    material = part.material or body.material
    own = spec.materials[material].color if material is not None else None
    color = next((c for c in (part.color, body.color, own) if c is not None), None)
    return None if color is None else (color[0], color[1], color[2])


def _remade(spec: AssetSpec, old: str, name: str) -> AssetSpec:
    """Return the asset with every use of material ``old`` replaced by material ``name`` from the tables."""
    stuff = priors().materials[name]
    made = Material(density=stuff.middle, friction=stuff.friction, restitution=stuff.restitution)
    materials = {name if n == old else n: made if n == old else m for n, m in spec.materials.items()}
    links = {}
    for own, body in spec.links.items():
        parts = {n: p.model_copy(update={"material": name}) if p.material == old else p for n, p in body.parts.items()}
        material = name if body.material == old else body.material
        links[own] = body.model_copy(update={"parts": parts, "material": material})
    return spec.model_copy(update={"materials": materials, "links": links})


def palette_of(spec: AssetSpec) -> tuple[Color, ...]:
    """Return the colors of an asset's category, or all paint colors if the category is unknown."""
    prior = category_prior(spec.category or spec.name)
    return prior.colors if prior is not None else priors().paints


def _another(spec: AssetSpec, component: Component, palette: tuple[Color, ...], rng: Rng) -> Color:
    """Pick a color that differs clearly from a component's current color, if possible."""
    old = color_of(spec, component.parts[0])
    far = [c for c in palette if old is None or color_gap(c, old) > 0.3] or palette
    return varied(far[int(rng.integers(0, len(far)))], rng)


def color_gap(a: Color, b: Color) -> float:
    """Return the sum of the absolute differences between two colors over the three channels."""
    return sum(abs(u - v) for u, v in zip(a, b, strict=True))


def varied(color: Color, rng: Rng) -> Color:
    """Perturb a color slightly."""
    r, g, b = (round(float(np.clip(v + rng.uniform(-JITTER, JITTER), 0.02, 0.98)), 3) for v in color)
    return r, g, b


def _shown(color: Color) -> str:
    return "#" + "".join(f"{round(255 * v):02x}" for v in color)


# Kinds of components that usually have a different color from the body.
ACCENTS = (Kind.HANDLE, Kind.KNOB, Kind.CAP, Kind.BAND)

# Edits, and the kinds of components that they apply to.
APPEARANCE = (
    (recolor, MAIN),
    (recolor, (Kind.HANDLE, Kind.KNOB, Kind.LID, Kind.DRAWER, Kind.CAP, Kind.BAND)),
    (change_material, (Kind.VESSEL, Kind.CRATE, Kind.BODY)),
)
