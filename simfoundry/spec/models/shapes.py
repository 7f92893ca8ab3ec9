"""Shapes of parts and objects: a shape is a mapping with a single key, which names its kind."""

# The annotations are not postponed; see :mod:`simfoundry.spec.models.base`.

from typing import Annotated, Any

from pydantic import Discriminator, Field, Tag

from simfoundry.spec.models.base import FARTHEST, Coordinate, Length, Model, NonNegative, Point2, Size3


class Round(Model):
    """The radius and height of a cylinder or capsule along z."""

    radius: Length = Field(description="Radius [m].")
    height: Length = Field(
        description="Height [m]; for a capsule, the height of the cylindrical part without the caps."
    )


class Prism(Model):
    """An outline extruded along z, such as a tabletop, tray or tile."""

    outline: tuple[Point2, ...] = Field(
        min_length=3, max_length=512, description="Corners in xy [m], in order; the last corner connects to the first."
    )
    height: Length = Field(description="Full height [m].")


class Lathe(Model):
    """A solid of revolution about z, such as a bowl, cup, bottle or plate."""

    profile: tuple[tuple[Annotated[NonNegative, Field(le=FARTHEST)], Coordinate], ...] = Field(
        min_length=3,
        max_length=256,
        description="Corners as (radius, height) pairs [m], in order; they start on the axis, trace the cross-section "
        "and end on the axis.",
    )


class BoxShape(Model):
    """A box centered on its frame."""

    box: Size3 = Field(description="Full extents along x, y, z [m].")


class SphereShape(Model):
    """A sphere centered on its frame."""

    sphere: Length = Field(description="Radius [m].")


class CylinderShape(Model):
    """A cylinder along z, centered on its frame."""

    cylinder: Round


class CapsuleShape(Model):
    """A capsule along z, centered on its frame."""

    capsule: Round


class PrismShape(Model):
    """An extrusion along z whose frame is at half its height."""

    prism: Prism


class LatheShape(Model):
    """A solid of revolution about z. Its frame is at height zero of the profile."""

    lathe: Lathe


SHAPE_KEYS = ("box", "sphere", "cylinder", "capsule", "prism", "lathe")


def _shape_tag(value: Any) -> str:
    keys = value.keys() if isinstance(value, dict) else type(value).model_fields if isinstance(value, Model) else ()
    return next((k for k in SHAPE_KEYS if k in keys), "box")


Shape = Annotated[
    Annotated[BoxShape, Tag("box")]
    | Annotated[SphereShape, Tag("sphere")]
    | Annotated[CylinderShape, Tag("cylinder")]
    | Annotated[CapsuleShape, Tag("capsule")]
    | Annotated[PrismShape, Tag("prism")]
    | Annotated[LatheShape, Tag("lathe")],
    Discriminator(_shape_tag),
]
