"""``scene/1``: objects, materials, cameras, lights and the relations among them."""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from simfoundry.spec.files import is_document
from simfoundry.spec.models.base import (
    FARTHEST,
    BodySpec,
    CameraPose,
    Color,
    DocumentSpec,
    FileName,
    FormerKey,
    Material,
    Model,
    Name,
    NonNegative,
    Number,
    Origin,
    PartName,
    Point2,
    Point3,
    PoseSpec,
    Positive,
    Shape,
    Vec3,
    exclusive,
    fault,
)
from simfoundry.spec.models.robot import RobotSpec
from simfoundry.spec.models.types import RIVALS

if TYPE_CHECKING:
    from simfoundry.spec.models.asset import AssetSpec

SIDES = ("left_of", "right_of")
DEPTHS = ("in_front_of", "behind")
PLACE_REFERENCES = ("on", "inside", *SIDES, *DEPTHS)
"""Keys of a place that name an object."""


class Place(Model):
    """A pose to be solved: the support and the position on it; the object is dropped onto the shapes below it.

    Left, right, front and behind are seen from the scene's viewpoint. Without `xy`, `local_xy` or one of these four,
    the object is at the center of its support. With one of the four, it is aligned with the center of its anchor in
    the other direction.
    """

    on: PartName | None = Field(None, description="Support: an object, or one of its links (`shelf.board`).")
    inside: PartName | None = Field(
        None, description="Container: an object with a cavity, or one of its links (`cabinet.drawer`)."
    )
    xy: Point2 | None = Field(None, description="Position of its frame in the world [m].")
    local_xy: Annotated[Point2 | None, FormerKey("at")] = Field(
        None, description="Position of its frame in the frame of its support [m]."
    )
    left_of: Name | None = Field(None, description="Object to the right of it.")
    right_of: Name | None = Field(None, description="Object to the left of it.")
    in_front_of: Name | None = Field(None, description="Object behind it, farther from the viewer.")
    behind: Name | None = Field(None, description="Object in front of it, nearer to the viewer.")
    gap: NonNegative = Field(0.03, le=FARTHEST, description="Gap to the object beside it [m].")
    yaw_deg: Number | None = Field(None, description="Rotation about z [deg].")
    rpy_deg: Vec3 | None = Field(
        None, description="Roll, pitch, yaw about fixed x, y, z [deg]: Rz(yaw) Ry(pitch) Rx(roll)."
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        exclusive(self, "on", "inside", needed=True)
        exclusive(self, "yaw_deg", "rpy_deg")
        exclusive(self, *SIDES)
        exclusive(self, *DEPTHS)
        beside = next((n for n in (*SIDES, *DEPTHS) if getattr(self, n) is not None), None)
        exclusive(self, "xy", "local_xy", *([beside] if beside else []))
        if beside is None and self.gap != Place.model_fields["gap"].default:
            raise fault("sf107", "`gap` is for left_of, right_of, in_front_of and behind", "gap")
        return self


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


class GeometrySpec(BodySpec):
    """Geometry of an object or of one of its variants."""

    shape: Shape | None = Field(None, description="A primitive.")
    asset: FileName | None = Field(
        None, description="A mesh (.glb, .obj, .stl, .ply) or an `.asset.yaml`, relative to this document."
    )
    scale: Positive = Field(1.0, description="Factor from the units of the mesh to meters.")


class VariantSpec(GeometrySpec):
    """Differences of one variant from its object; all other properties are those of the object.

    A new `shape` or `asset` also removes the object's `scale` and `visual`.
    """

    visual: FileName | None = Field(None, description="A mesh to render instead of the shape.")
    category: Name | None = Field(None, description="Category, such as `mug`.")
    labels: Labels = Field((), description="Labels for vision systems; default: the object's.")

    @model_validator(mode="after")
    def _changes_something(self) -> Self:
        exclusive(self, "shape", "asset")
        exclusive(self, "mass", "density")
        if not self.model_fields_set:
            raise fault("sf107", "a variant lists its differences, and this one has none")
        return self


class ObjectSpec(GeometrySpec):
    """An object of the scene: a primitive `shape`, or an `asset` (a mesh file or an asset document)."""

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
            raise fault("sf107", "no variant may be called `default`, which is the object as written", "variants")
        if self.asset is None and self.visual is None and self.scale != 1.0:
            raise fault("sf107", "`scale` is for meshes; change the shape itself", "scale")
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
            raise fault("sf104", "`direction` must not be zero", "direction")
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


Written = float | Degrees | PoseSpec
"""Position [m or rad], angle in degrees, or pose of a ball or free joint."""


def number(position: Written) -> float:
    """Convert a written position to a number [m or rad]; 0 for a joint with a pose."""
    if isinstance(position, Degrees):
        return math.radians(position.deg)
    return position if isinstance(position, float | int) else 0.0


def position(asset: "AssetSpec", name: str, given: Mapping[str, Written]) -> float:
    """Return the position [m or rad] of a joint, 0 if not ``given``; a mimic joint follows its leader.

    If the leaders form a cycle or a leader does not exist, the position is 0.
    """
    seen: set[str] = set()
    scale, offset = 1.0, 0.0
    while (joint := asset.joints.get(name)) is not None and joint.mimic is not None:
        if name in seen:
            return 0.0
        seen.add(name)
        scale, offset = scale * joint.mimic.multiplier, offset + scale * joint.mimic.offset
        name = joint.mimic.joint
    return scale * number(given.get(name, 0.0)) + offset if joint is not None else 0.0


GEOMETRY = ("shape", "asset")
OF_GEOMETRY = ("scale", "visual")
"""Fields that belong to a shape or mesh and are dropped when it is replaced."""


def variant_of(item: ObjectSpec, name: str) -> ObjectSpec:
    """Return the variant ``name`` of an object, without further variants; ``default`` is the object as written.

    Raises :class:`pydantic.ValidationError` if object and variant are incompatible, such as a `scale` for a primitive.
    """
    given: dict[str, Any] = {key: getattr(item, key) for key in item.model_fields_set - {"variant", "variants"}}
    if name != DEFAULT_VARIANT:
        over = item.variants[name]
        changes = {key: getattr(over, key) for key in over.model_fields_set}
        dropped = {rival for key in changes for rival in RIVALS.get(key, ())} - changes.keys()
        if any(key in changes for key in GEOMETRY):
            dropped |= {*OF_GEOMETRY, "joints"} - changes.keys()
        if over.asset is not None and is_document(over.asset):  # its links define mass and material themselves
            dropped |= BodySpec.model_fields.keys() - changes.keys()
        given = {key: value for key, value in given.items() if key not in dropped} | changes
    return ObjectSpec(**given)


def variant_names(item: ObjectSpec) -> list[str]:
    """Return the names of all variants of an object, ``default`` first; empty if it has none."""
    return [DEFAULT_VARIANT, *item.variants] if item.variants else []
