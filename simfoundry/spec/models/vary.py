"""The axis `vary` of a recipe: paths in the scene with the distributions from which their values are drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Discriminator, Field, StringConstraints, Tag, create_model

from simfoundry.spec.models.base import (
    VARY_PATH,
    Fraction,
    Interval,
    Model,
    Name,
    NonNegative,
    Number,
    Ordered,
    Positive,
    consistent,
    fault,
)

# Path of a value to vary. 256 characters hold three names of the greatest length and their keys.
VaryPath = Annotated[str, StringConstraints(pattern=VARY_PATH, max_length=256)]

# Greatest standard deviation and greatest rotation of a pose or direction [deg]; half a turn is any orientation.
HalfTurn = Annotated[float, Field(gt=0, le=180, allow_inf_nan=False)]

# Maximum number of values to choose from; one cousin in a thousand then has a given value.
MAX_CHOICES = 1000


class Distribution(Model):
    """The base class of all distributions."""


Together = Annotated[
    Name | None,
    Field(
        description="Entries with the same name here are drawn together: all of them have the same quantile, so that "
        "they are low or high at the same time."
    ),
]


class UniformDistribution(Distribution):
    """Values that are equally likely in a range."""

    uniform: Interval = Field(description="Minimum and maximum, in the unit of the key.")
    together: Together = None


class LogUniformDistribution(Distribution):
    """Values whose logarithm is uniformly distributed, for quantities that vary over orders of magnitude."""

    log_uniform: Annotated[tuple[Positive, Positive], Ordered] = Field(
        description="Minimum and maximum, in the unit of the key."
    )
    together: Together = None


class FactorDistribution(Distribution):
    """The twin's value times a uniformly distributed factor."""

    times: Annotated[tuple[Positive, Positive], Ordered] = Field(description="Minimum and maximum of the factor.")
    together: Together = None


Shift = Annotated[
    Annotated[NonNegative, Tag("greatest")] | Annotated[tuple[Number, ...], Tag("values")],
    Discriminator(lambda v: "values" if isinstance(v, tuple | list) else "greatest"),
]


class ShiftDistribution(Distribution):
    """The twin's value plus a uniformly distributed shift, or a pose that is shifted and turned."""

    shift: Shift | None = Field(
        None,
        description="For a number: the greatest shift, or the minimum and maximum. For a position or a color: the "
        "greatest distance, or the greatest shift along each axis.",
    )
    turn_deg: HalfTurn | None = Field(None, description="Greatest rotation of a pose, about any axis [deg].")
    yaw_deg: HalfTurn | None = Field(None, description="Greatest rotation of a pose about z [deg].")
    with_contents: bool = Field(
        False, description="Also move the objects that the object supports; only for `height` and poses of objects."
    )
    together: Together = None

    @consistent
    def _shifts(self) -> None:
        if self.shift is None and self.turn_deg is None and self.yaw_deg is None:
            raise fault("sf107", "one of `shift`, `turn_deg`, `yaw_deg` is needed")
        if self.turn_deg is not None and self.yaw_deg is not None:
            raise fault("sf107", "specify only one of `turn_deg`, `yaw_deg`, not 2", "yaw_deg")
        if isinstance(self.shift, tuple):
            if len(self.shift) not in (2, 3):
                message = f"`shift` is one number, a minimum and a maximum, or three numbers, not {len(self.shift)}"
                raise fault("sf105", message, "shift")
            if len(self.shift) == 2 and self.shift[0] > self.shift[1]:
                raise fault("sf104", "the minimum must not exceed the maximum", "shift")
            if len(self.shift) == 3 and min(self.shift) < 0:
                raise fault("sf104", "the greatest shift along an axis must not be negative", "shift")


class NormalDistribution(Distribution):
    """The twin's value plus a normally distributed error, cut off at three standard deviations and at the limits."""

    normal: Positive = Field(description="Standard deviation, in the unit of the key.")
    together: Together = None


class NormalAngleDistribution(Distribution):
    """Joint positions plus a normally distributed error, cut off at three standard deviations and at the limits."""

    normal_deg: HalfTurn = Field(description="Standard deviation [deg].")
    together: Together = None


class ConeDistribution(Distribution):
    """Directions that are uniformly distributed in a cone around the twin's direction."""

    cone_deg: HalfTurn = Field(description="Greatest angle to the twin's direction [deg].")
    together: Together = None


def _value_tag(value: Any) -> str:
    return "text" if isinstance(value, str) else "vector" if isinstance(value, tuple | list) else "number"


# A value to choose: a number, a vector or color, or a text, such as a color, a name or a file.
ChosenValue = Annotated[
    Annotated[Number, Tag("number")]
    | Annotated[str, Tag("text"), StringConstraints(min_length=1, max_length=512)]
    | Annotated[tuple[Number, ...], Tag("vector"), Field(max_length=4)],
    Discriminator(_value_tag),
]


class ChoiceDistribution(Distribution):
    """Values that are equally likely."""

    choose: tuple[ChosenValue, ...] = Field(
        min_length=1,
        max_length=MAX_CHOICES,
        description="The values. A color is hexadecimal, three numbers, the name of a material of the twin, or a name "
        "such as `white` or `oak`. Files are relative to this document; `*` in their name stands for any characters.",
    )
    together: Together = None


class EstimateDistribution(Distribution):
    """Values that are equally likely in the range of the twin's estimate, such as `mass: {value: 1, range: [1, 2]}`."""

    range: Literal["estimate"] = Field(description="`estimate`: the range that the twin states for the quantity.")
    together: Together = None


# Key by which each distribution is recognized. A shift may also be written without `shift`.
_TAGS = ("uniform", "log_uniform", "times", "normal", "normal_deg", "cone_deg", "choose", "range", "shift")


def _tag(value: Any) -> str:
    keys = value.keys() if isinstance(value, dict) else type(value).model_fields if isinstance(value, Model) else ()
    found = next((key for key in _TAGS if key in keys), None)
    return found or ("shift" if "turn_deg" in keys or "yaw_deg" in keys else "uniform")


AnyDistribution = Annotated[
    Annotated[UniformDistribution, Tag("uniform")]
    | Annotated[LogUniformDistribution, Tag("log_uniform")]
    | Annotated[FactorDistribution, Tag("times")]
    | Annotated[ShiftDistribution, Tag("shift")]
    | Annotated[NormalDistribution, Tag("normal")]
    | Annotated[NormalAngleDistribution, Tag("normal_deg")]
    | Annotated[ConeDistribution, Tag("cone_deg")]
    | Annotated[ChoiceDistribution, Tag("choose")]
    | Annotated[EstimateDistribution, Tag("range")],
    Discriminator(_tag),
]


class _Quantiles(Model):
    until: Fraction = Field(1.0, description="Upper end of the quantiles, which is not included.")

    @property
    def ends(self) -> tuple[float, float]:
        """The lower and the upper end of the quantiles."""
        return float(getattr(self, "from")), self.until

    @consistent
    def _ordered(self) -> None:
        if self.ends[0] >= self.ends[1]:
            raise fault("sf104", "`from` must be less than `until`", "until")


if TYPE_CHECKING:
    SplitSpec = _Quantiles
else:  # `from` is a keyword of Python, so that it cannot be the name of a field in the body of a class
    SplitSpec = create_model(
        "SplitSpec",
        __base__=_Quantiles,
        __module__=__name__,
        __doc__="A share of each distribution, by quantiles. No two splits share a value.",
        **{"from": (Fraction, Field(0.0, description="Lower end of the quantiles."))},
    )
