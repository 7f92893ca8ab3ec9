"""Shapes of parts and objects: a shape is a mapping with a single key, which names its kind."""

# The annotations are not postponed; see :mod:`simfoundry.spec.models.base`.

from typing import Annotated, Any

from pydantic import Discriminator, Field, Tag

from simfoundry.spec.models.base import (
    COLOR,
    FARTHEST,
    Color,
    Coordinate,
    Length,
    Model,
    Name,
    NonNegative,
    Point2,
    PoseSpec,
    Size3,
    consistent,
    fault,
)


class Round(Model):
    """The radius and height of a cylinder, capsule or cone along z."""

    radius: Length = Field(description="Radius [m]; for a cone, the radius of its base.")
    height: Length = Field(
        description="Height [m]; for a capsule, the height of the cylindrical part without the caps."
    )


# Names of the pieces of an open box, seen along x.
WALLS = ("floor", "front", "back", "left", "right")


class OpenBox(Model):
    """The outer size of a box without a lid, and the thickness of its floor and its four walls."""

    size: Size3 = Field(description="Outer extents along x, y, z [m].")
    wall: Length = Field(description="Thickness of the floor and of the walls [m].")

    @consistent
    def _is_hollow(self) -> None:
        x, y, z = self.size
        if self.wall >= min(x / 2, y / 2, z):
            room = "half of the extents along x and y, and less than the extent along z"
            raise fault("sf104", f"`wall` leaves no space inside; it must be less than {room}", "wall")


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


class EllipsoidShape(Model):
    """An ellipsoid centered on its frame."""

    ellipsoid: Size3 = Field(description="Radii (semi-axes) along x, y, z [m].")


class ConeShape(Model):
    """A cone along z with its tip up. Its frame is on the axis at half its height."""

    cone: Round


class OpenBoxShape(Model):
    """A box without a lid, such as a bin, tray or drawer. Its frame is at the center of its outer box."""

    open_box: OpenBox


# Keys of the shapes that a part can have.
PART_SHAPE_KEYS = (
    "box", "sphere", "ellipsoid", "cylinder", "capsule", "cone", "prism", "lathe", "open_box"
)  # fmt: skip
SHAPE_KEYS = (*PART_SHAPE_KEYS, "compound")


def _tag(value: Any, known: tuple[str, ...]) -> str:
    keys = value.keys() if isinstance(value, dict) else type(value).model_fields if isinstance(value, Model) else ()
    return next((k for k in known if k in keys), "box")


def _part_tag(value: Any) -> str:
    return _tag(value, PART_SHAPE_KEYS)


def _shape_tag(value: Any) -> str:
    return _tag(value, SHAPE_KEYS)


_SinglePart = (
    Annotated[BoxShape, Tag("box")]
    | Annotated[SphereShape, Tag("sphere")]
    | Annotated[EllipsoidShape, Tag("ellipsoid")]
    | Annotated[CylinderShape, Tag("cylinder")]
    | Annotated[CapsuleShape, Tag("capsule")]
    | Annotated[ConeShape, Tag("cone")]
    | Annotated[PrismShape, Tag("prism")]
    | Annotated[LatheShape, Tag("lathe")]
    | Annotated[OpenBoxShape, Tag("open_box")]
)

# A shape of a single part.
PartShape = Annotated[_SinglePart, Discriminator(_part_tag)]

# Maximum number of parts of a compound, as of corners of a hull; larger objects are better described by a mesh.
MAX_PARTS = 64


class CompoundPart(Model):
    """A part of a compound: a shape at a pose in the object's frame."""

    shape: PartShape = Field(description="The shape of the part.")
    pose: PoseSpec = Field(PoseSpec.model_construct(), description="Pose in the object's frame.")
    material: Name | None = Field(None, description="A name from `materials`; default: the object's material.")
    color: Color | None = Field(None, description=COLOR.format("; default: the object's"))


class CompoundShape(Model):
    """Several shapes that form one rigid body, by name. A compound cannot contain another compound."""

    compound: dict[Name, CompoundPart] = Field(
        min_length=1, max_length=MAX_PARTS, description="Parts by name; their volumes are added where they overlap."
    )


# A shape of an object, which may consist of several parts.
Shape = Annotated[_SinglePart | Annotated[CompoundShape, Tag("compound")], Discriminator(_shape_tag)]


def shape_parts(shape: Shape) -> dict[str, CompoundPart]:
    """Return the parts of a compound, or an empty mapping for any other shape."""
    return shape.compound if isinstance(shape, CompoundShape) else {}
