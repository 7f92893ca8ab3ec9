"""Numbers of distributions by quantile, and the bounds that models set for them."""

from __future__ import annotations

import math
import typing
from statistics import NormalDist
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from simfoundry.spec.models.types import field_type
from simfoundry.spec.models.vary import (
    AnyDistribution,
    FactorDistribution,
    LogUniformDistribution,
    NormalAngleDistribution,
    NormalDistribution,
    ShiftDistribution,
    UniformDistribution,
)

Ends = tuple[float, float]

# Number of standard deviations at which normal distributions are cut off; 99.7% of the values lie within.
CUTOFF = 3.0

# Share of the twin's value below which a quantity that must be positive is not drawn.
SMALLEST = 1e-3

NO_ENDS: Ends = (-math.inf, math.inf)


def range_of(distribution: AnyDistribution, base: float | None, estimate: Ends | None = None) -> Ends | None:
    """Return the least and the greatest number of a distribution, before bounds apply.

    Args:
        distribution: The distribution.
        base: The twin's value, or None if it states none.
        estimate: Range of the twin's estimate, or None.

    Returns:
        The range, or None if the distribution needs a value that the twin does not state, or is not one of numbers.
    """
    match distribution:
        case UniformDistribution():
            return distribution.uniform
        case LogUniformDistribution():
            return distribution.log_uniform
        case FactorDistribution() if base is not None:
            low, high = (base * factor for factor in distribution.times)
            return min(low, high), max(low, high)
        case ShiftDistribution() if base is not None and distribution.shift is not None:
            ends = shift_ends(distribution.shift)
            return (base + ends[0], base + ends[1]) if ends is not None else None
        case NormalDistribution() | NormalAngleDistribution() if base is not None:
            reach = CUTOFF * deviation(distribution)
            return base - reach, base + reach
    return estimate if "range" in type(distribution).model_fields else None


def deviation(distribution: NormalDistribution | NormalAngleDistribution) -> float:
    """Return the standard deviation, for angles in radians."""
    if isinstance(distribution, NormalAngleDistribution):
        return math.radians(distribution.normal_deg)
    return distribution.normal


def shift_ends(shift: float | tuple[float, ...]) -> Ends | None:
    """Return the least and the greatest shift of a number, or None if the shift has three components."""
    if isinstance(shift, tuple):
        return (shift[0], shift[1]) if len(shift) == 2 else None
    return -shift, shift


def number_at(distribution: AnyDistribution, base: float | None, ends: Ends, quantile: float) -> float:
    """Return the number at a quantile, from 0 to 1, of a distribution whose range is ``ends``.

    A number that is normally distributed follows the distribution between the ends.
    """
    low, high = ends
    if isinstance(distribution, LogUniformDistribution):
        value = math.exp(math.log(low) + quantile * (math.log(high) - math.log(low)))
    elif isinstance(distribution, NormalDistribution | NormalAngleDistribution) and base is not None and low < high:
        normal = NormalDist(base, deviation(distribution))
        start, end = normal.cdf(low), normal.cdf(high)
        share = start + quantile * (end - start)
        value = normal.inv_cdf(share) if 0 < share < 1 else low if share <= 0 else high
    else:
        value = low + quantile * (high - low)
    return min(max(value, low), high)


def bounds_of(model: type[BaseModel], name: str, base: float | None) -> Ends:
    """Return the least and the greatest number that a field accepts.

    A field that excludes its bound, such as a mass, accepts no number below a share of the twin's value, or of one.
    """
    low, high = NO_ENDS
    margin = SMALLEST * (abs(base) if base else 1.0)
    for mark in _marks(field_type(model, name)):
        if (least := getattr(mark, "ge", None)) is not None:
            low = max(low, float(least))
        if (least := getattr(mark, "gt", None)) is not None:
            low = max(low, float(least) + margin)
        if (most := getattr(mark, "le", None)) is not None:
            high = min(high, float(most))
        if (most := getattr(mark, "lt", None)) is not None:
            high = min(high, float(most) - margin)
    return low, high


def _marks(kind: Any) -> typing.Iterator[Any]:
    """Yield the constraints of a type, including those of the members of a union."""
    if typing.get_origin(kind) is typing.Annotated:
        inner, *metadata = typing.get_args(kind)
        for mark in metadata:
            yield from mark.metadata if isinstance(mark, FieldInfo) else (mark,)
        yield from _marks(inner)
    elif typing.get_origin(kind) not in (tuple, dict):
        for member in typing.get_args(kind):
            yield from _marks(member)


def rounded_number(value: float, ends: Ends = NO_ENDS) -> float:
    """Round a number to the six digits of documents, within its range."""
    return min(max(float(f"{value:.6g}"), ends[0]), ends[1]) + 0.0
