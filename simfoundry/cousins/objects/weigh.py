"""Masses of variants: derived from their volumes and densities, with the range of what the material may weigh."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from simfoundry.assets import mass
from simfoundry.assets.mesh import read_parts, weld
from simfoundry.cousins.objects.stuff import STUFFS
from simfoundry.spec.check.plausible import volume
from simfoundry.spec.models.asset import AssetSpec, LinkSpec, PartSpec
from simfoundry.spec.models.base import Estimate, Material, quantity_value

DOUBT = 0.15
"""Share by which a density may be off where the material is not in the tables."""

BY = "volume and density"
GIVEN = "the twin's mass, by volume"


def weighed(spec: AssetSpec, twin: AssetSpec, volumes: Mapping[str, float], before: Mapping[str, float]) -> AssetSpec:
    """The asset with the mass of each link as an estimate.

    ``volumes`` and ``before`` [m^3] are those of the meshes in the two specs by file. A link whose mass the twin gives
    weighs in proportion to its volume. Measured inertias of the twin no longer hold, and go.
    """
    links = {}
    for name, link in spec.links.items():
        own = twin.links.get(name)
        given = quantity_value(own.mass) if own is not None else None
        if link.density is not None:  # the density is said of the link itself, and holds for it still
            links[name] = link.model_copy(update={"inertial": None})
            continue
        if own is not None and given is not None:
            share = _mass(link, spec, volumes, 0) / _mass(own, twin, before, 0)
            value, low, high, source = given * share, given * share * (1 - DOUBT), given * share * (1 + DOUBT), GIVEN
        else:
            value, low, high = (_mass(link, spec, volumes, side) for side in (0, -1, 1))
            source = BY
        estimate = Estimate(value=_short(value), range=(_short(low), _short(high)), source=source)
        links[name] = link.model_copy(update={"mass": estimate, "inertial": None})
    return spec.model_copy(update={"links": links})


def _mass(link: LinkSpec, spec: AssetSpec, volumes: Mapping[str, float], side: int) -> float:
    """The mass of a link [kg] with the least (-1), the written (0) or the greatest (1) densities of its materials."""
    total = 0.0
    for part in link.parts.values():
        if part.use != "visual":
            total += _volume(part, volumes) * _density(part.material or link.material, spec.materials, side)
    return total


def _volume(part: PartSpec, volumes: Mapping[str, float]) -> float:
    if part.mesh is not None:
        return volumes[part.mesh] * part.scale**3
    assert part.shape is not None
    return volume(part.shape)


def _density(name: str | None, materials: Mapping[str, Material], side: int) -> float:
    density = (materials[name].density if name is not None else None) or 1000.0
    if name is not None and name in STUFFS and side:
        low, high = STUFFS[name].density
        return min(low, density) if side < 0 else max(high, density)
    return density * (1 + side * DOUBT)


def mesh_volume(path: Path) -> float:
    """The volume [m^3] that a mesh file encloses in its own units."""
    parts = read_parts(path)
    offsets = np.cumsum([0, *(len(p.vertices) for p in parts)])
    vertices = np.concatenate([p.vertices for p in parts])
    faces = np.concatenate([p.faces + o for p, o in zip(parts, offsets, strict=False)]).astype(np.int32)
    return abs(mass.mesh(*weld(vertices, faces)).volume)


def _short(value: float) -> float:
    """Three digits: more would be a claim."""
    return float(f"{max(value, 1e-6):.3g}")
