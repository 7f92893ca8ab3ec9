"""``scene/1``: objects, materials, cameras, lights and the relations among them."""

import math
from typing import Annotated, Any, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator
from pydantic_core import PydanticCustomError

from simfoundry.spec.models.base import (
    BodySpec,
    CameraPose,
    Color,
    DocumentSpec,
    FileName,
    Material,
    Model,
    Name,
    NonNegative,
    Number,
    Origin,
    PartName,
    Point3,
    PoseSpec,
    Positive,
    Shape,
    Vec3,
    exclusive,
)
from simfoundry.spec.models.place import Place
from simfoundry.spec.models.robot import RobotSpec


class Degrees(Model):
    """A joint position in degrees."""

    deg: Number = Field(description="Position of a revolute or continuous joint [deg].")


def _position_tag(value: Any) -> str:
    if isinstance(value, PoseSpec) or (isinstance(value, dict) and any(key in value for key in PoseSpec.model_fields)):
        return "pose"
    return "degrees" if isinstance(value, dict | Degrees) else "number"


JointPosition = Annotated[
    Annotated[Number, Tag("number")] | Annotated[Degrees, Tag("degrees")] | Annotated[PoseSpec, Tag("pose")],
    Discriminator(_position_tag),
]
"""Joint position: a number, ``{deg: 30}``, or for a ball or free joint a pose relative to its zero position."""

Touching = tuple[PartName, PartName]


Labels = Annotated[tuple[Name, ...], Field(max_length=32)]

DEFAULT_VARIANT = "default"
"""Name of the variant that is the object as written."""


class VariantSpec(BodySpec):
    """Differences of one variant from its object; all other properties are those of the object.

    A new `shape` or `asset` also removes the object's `scale` and `visual`.
    """

    shape: Shape | None = Field(None, description="A primitive.")
    asset: FileName | None = Field(
        None, description="A mesh (.glb, .obj, .stl, .ply) or an `.asset.yaml`, relative to this document."
    )
    scale: Positive = Field(1.0, description="Factor from the units of the mesh to meters.")
    visual: FileName | None = Field(None, description="A mesh to render instead of the shape.")
    category: Name | None = Field(None, description="Category, such as `mug`.")
    labels: Labels = Field((), description="Labels for vision systems; default: the object's.")

    @model_validator(mode="after")
    def _changes_something(self) -> Self:
        exclusive(self, "shape", "asset")
        exclusive(self, "mass", "density")
        if not self.model_fields_set:
            raise PydanticCustomError("sf107", "a variant lists its differences, and this one has none")
        return self


class ObjectSpec(BodySpec):
    """An object of the scene: a primitive `shape`, or an `asset` (a mesh file or an asset document)."""

    shape: Shape | None = Field(None, description="A primitive.")
    asset: FileName | None = Field(
        None, description="A mesh (.glb, .obj, .stl, .ply) or an `.asset.yaml`, relative to this document."
    )
    scale: Positive = Field(1.0, description="Factor from the units of the mesh to meters.")
    visual: FileName | None = Field(
        None, description="A mesh to render instead of the shape; it has no effect on physics."
    )
    category: Name | None = Field(None, description="Category, such as `mug`; default: its name.")
    labels: Labels = Field((), description="Labels for vision systems, the most specific first; default: its category.")
    fixed: bool = Field(False, description="Welded to the world.")
    pose: PoseSpec = Field(PoseSpec.model_construct(), description="Pose of its frame in the world.")
    place: Place | None = Field(None, description="Placement from which its pose is computed, instead of `pose`.")
    joints: dict[Name, JointPosition] = Field(
        {},
        description="Joint positions by name: meters, radians, or `{deg: 30}`; for a ball joint a rotation such as "
        "`{rpy_deg: [10, 0, 20]}`, for a free joint a pose; default: 0.",
    )
    variant: Name | None = Field(
        None, description="The variant to compile, one of `variants`; default: `default`, the object as written."
    )
    variants: dict[Name, VariantSpec] = Field(
        {},
        description="Variants by name, each with its differences from the object; USD stores them in one variant set.",
    )
    origin: Origin | None = Field(None, description="Origin of the description.")

    @model_validator(mode="after")
    def _one_geometry(self) -> Self:
        exclusive(self, "shape", "asset", needed=True)
        exclusive(self, "mass", "density")
        exclusive(self, "pose", "place")
        if DEFAULT_VARIANT in self.variants:
            message = "`default` is the object as it is written, so no variant may have that name"
            raise PydanticCustomError("sf107", "{message}", {"message": message, "at": "variants"})
        if self.asset is None and self.visual is None and self.scale != 1.0:
            raise PydanticCustomError("sf107", "`scale` is for meshes; change the shape itself", {"at": "scale"})
        return self


class CameraSpec(Model):
    """A pinhole camera."""

    size: tuple[Annotated[int, Field(ge=1, le=8192)], Annotated[int, Field(ge=1, le=8192)]] = Field(
        description="Width and height of the image [px]."
    )
    fx: Positive = Field(description="Focal length in x [px].")
    fy: Positive = Field(description="Focal length in y [px].")
    cx: Number | None = Field(None, description="Principal point in x [px]; default: the middle, (width - 1) / 2.")
    cy: Number | None = Field(None, description="Principal point in y [px]; default: the middle, (height - 1) / 2.")
    pose: CameraPose = Field(description="Pose in the world, or in the frame of its mount.")
    mount: PartName | None = Field(
        None, description="Mount of the camera: a robot's link (`arm.hand`), an object, or a link of one."
    )


class LightSpec(Model):
    """A light."""

    type: Literal["distant", "point", "dome"] = Field(description="Kind of light: parallel rays, a point, or a dome.")
    intensity: NonNegative = Field(
        1.0, description="Relative intensity; 1 fully lights a white surface that faces the light."
    )
    color: Color = Field((1.0, 1.0, 1.0), description="sRGB color, 0 to 1.")
    direction: Vec3 = Field((0.0, 0.0, -1.0), description="Direction in which a distant light shines.")
    xyz: Point3 = Field((0.0, 0.0, 2.0), description="Position of a point light [m].")

    @model_validator(mode="after")
    def _shines_somewhere(self) -> Self:
        if math.hypot(*self.direction) < 1e-6:
            raise PydanticCustomError("sf104", "`direction` must not be zero", {"at": "direction"})
        return self


class BackgroundSpec(Model):
    """Visual surroundings of the scene; nothing collides with them."""

    mesh: FileName | None = Field(None, description="A mesh (.glb, .obj, .stl, .ply), relative to this document.")
    splat: FileName | None = Field(None, description="A 3D Gaussian splat (.ply), relative to this document.")
    pose: PoseSpec = Field(PoseSpec.model_construct(), description="Pose in the world.")
    scale: Positive = Field(1.0, description="Factor from the units of the file to meters.")

    @model_validator(mode="after")
    def _one_file(self) -> Self:
        exclusive(self, "mesh", "splat", needed=True)
        return self


class SceneSpec(DocumentSpec):
    """A scene. World frame: right-handed, z up; SI units."""

    simfoundry: Literal["scene/1"] = Field(description="The kind and version of this document.")
    viewpoint: Name | None = Field(
        None,
        description="Camera or robot that defines left, right, front and behind; default: x points away, y left.",
    )
    gravity: Vec3 = Field((0.0, 0.0, -9.81), description="Acceleration of gravity [m/s^2].")
    materials: dict[Name, Material] = Field({}, description="Materials by name.")
    objects: dict[Name, ObjectSpec] = Field({}, description="Objects by name.")
    robots: dict[Name, RobotSpec] = Field({}, description="Robots by name.")
    cameras: dict[Name, CameraSpec] = Field({}, description="Cameras by name.")
    lights: dict[Name, LightSpec] = Field({}, description="Lights by name.")
    background: BackgroundSpec | None = Field(None, description="Visual surroundings of the scene.")
    no_contact: tuple[Touching, ...] = Field(
        (),
        max_length=1000,
        description="Pairs that do not collide: objects, or their links such as `cabinet.door`.",
    )
    relations: tuple[str, ...] = Field((), description="Relations that should hold, such as `OnTop(cup, desk)`.")
    origin: Origin | None = Field(None, description="Origin of the scene.")
