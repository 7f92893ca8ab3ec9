"""Estimated masses, with a range and a source each."""

from __future__ import annotations

import math

from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.base import Estimate, quantity_value

# Range of a mass that a model estimates from an image, or that follows from an assumed thickness of walls, as factors
# of its value.
MASS_RANGE = (0.5, 2.0)

# Maximum length of a source in a document.
SOURCE = 64

# Significant digits of masses [kg], which are known to a factor of two.
DIGITS = 3


def mass_estimate(kilograms: float, source: str) -> Estimate:
    """Return an estimated mass [kg] with the usual range."""
    low, high = (rounded_mass(factor * kilograms) for factor in MASS_RANGE)
    return Estimate(value=kilograms, range=(low, high), source=source[:SOURCE])


def share_mass(asset: AssetSpec, total: Estimate) -> AssetSpec:
    """Return an asset whose links have the mass of a whole object together, in proportion to the masses that they had.

    Args:
        asset: An asset, each of whose links states its mass.
        total: The mass of the object [kg].
    """
    own = {name: quantity_value(link.mass) or 0.0 for name, link in asset.links.items()}
    everything = math.fsum(own.values())
    if not everything or not all(own.values()):
        return asset
    masses = {name: _times(total, mass / everything) for name, mass in own.items()}
    links = {name: link.model_copy(update={"mass": masses[name]}) for name, link in asset.links.items()}
    return asset.model_copy(update={"links": links})


def _times(total: Estimate, share: float) -> Estimate:
    ends = None if total.range is None else (rounded_mass(share * total.range[0]), rounded_mass(share * total.range[1]))
    return Estimate(value=rounded_mass(share * total.value), range=ends, source=total.source)


def rounded_mass(kilograms: float) -> float:
    """Return a mass [kg] with the digits that are known."""
    return float(f"{kilograms:.{DIGITS}g}")
