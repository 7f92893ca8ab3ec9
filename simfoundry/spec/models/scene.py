"""The ``scene/1`` document: objects, materials, robots, cameras, lights, and relations between objects."""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag

from simfoundry.spec.files import is_document
from simfoundry.spec.models.base import (
    FARTHEST,
    SCALE,
    BodySpec,
    DocumentSpec,
    FileName,
    FormerKey,
    Material,
    Model,
    Name,
    NonNegative,
    Number,
    PartName,
    Point2,
    PoseSpec,
    Positive,
    Scale,
    Vec3,
    consistent,
    exclusive,
    fault,
)
from simfoundry.spec.models.native import ObjectNative, SceneNative
from simfoundry.spec.models.origin import Origin
from simfoundry.spec.models.reuse import FramedPose, IncludeSpec, ReferenceFrame, Repeat
from simfoundry.spec.models.robot import RobotSpec
from simfoundry.spec.models.shapes import Shape
from simfoundry.spec.models.surroundings import BackgroundSpec, CameraSpec, LightSpec

if TYPE_CHECKING:
    from simfoundry.spec.models.asset import AssetSpec

SIDES = ("left_of", "right_of")
DEPTHS = ("in_front_of", "behind")
# Keys of a place whose value is the name of an object.
PLACE_REFERENCES = ("on", "inside", *SIDES, *DEPTHS)


class Place(Model):
    """A placement on or inside a support. The pose is computed by lowering the object onto the shapes below it.

    Left, right, front and behind are relative to the scene's viewpoint. If no horizontal position is specified, the
    object is placed at the center of its support. If only one of `left_of`, `right_of`, `in_front_of` and `behind` is
    set, the object is aligned with the center of that reference object along the other axis.
    """

    on: PartName | None = Field(None, description="Support: an object, or one of its links or parts (`shelf.board`).")
    inside: PartName | None = Field(
        None, description="Container: an object with a cavity, or one of its links (`cabinet.drawer`)."
    )
    xy: Point2 | None = Field(None, description="Position of the object's frame in the world [m].")
    local_xy: Annotated[Point2 | None, FormerKey("at")] = Field(
        None, description="Position of the object's frame in the support's frame [m]."
    )
    left_of: Name | None = Field(None, description="Reference object; this object is placed to its left.")
    right_of: Name | None = Field(None, description="Reference object; this object is placed to its right.")
    in_front_of: Name | None = Field(None, description="Reference object; this object is placed closer to the viewer.")
    behind: Name | None = Field(None, description="Reference object; this object is placed farther from the viewer.")
    gap: NonNegative = Field(0.03, le=FARTHEST, description="Gap to the reference object [m].")
    offset: Point2 | None = Field(None, description="Shift of the position that the other keys define [m].")
    frame: PartName | None = Field(
        None,
        description="Frame of `xy`, `offset` and the rotation: a name from `frames`, an object or one of its links; "
        "default: the world.",
    )
    seen_from: Name | None = Field(
        None,
        description="Camera, robot or frame whose view defines left, right, front and behind; default: the scene's "
        "`viewpoint`.",
    )
    yaw_deg: Number | None = Field(None, description="Rotation about z [deg].")
    rpy_deg: Vec3 | None = Field(
        None, description="Roll, pitch, yaw about fixed x, y, z [deg]: Rz(yaw) Ry(pitch) Rx(roll)."
    )

    @consistent
    def _consistent(self) -> None:
        exclusive(self, "on", "inside", needed=True)
        exclusive(self, "yaw_deg", "rpy_deg")
        exclusive(self, *SIDES)
        exclusive(self, *DEPTHS)
        beside = next((n for n in (*SIDES, *DEPTHS) if getattr(self, n) is not None), None)
        exclusive(self, "xy", "local_xy", *([beside] if beside else []))
        if beside is None and self.gap != Place.model_fields["gap"].default:
            raise fault("sf107", "`gap` requires `left_of`, `right_of`, `in_front_of` or `behind`", "gap")


class Degrees(Model):
    """A joint position in degrees."""

    deg: Number = Field(description="Position of a revolute or continuous joint [deg].")


def _position_tag(value: Any) -> str:
    if isinstance(value, PoseSpec) or (isinstance(value, dict) and any(key in value for key in PoseSpec.model_fields)):
        return "pose"
    return "degrees" if isinstance(value, dict | Degrees) else "number"


# Joint position: a number, ``{deg: 30}``, or, for a ball or free joint, a pose relative to the zero position.
JointPosition = Annotated[
    Annotated[Number, Tag("number")] | Annotated[Degrees, Tag("degrees")] | Annotated[PoseSpec, Tag("pose")],
    Discriminator(_position_tag),
]

Touching = tuple[PartName, PartName]


Labels = Annotated[tuple[Name, ...], Field(max_length=32)]

# Name of the variant that is the object without any overrides.
DEFAULT_VARIANT = "default"


class GeometrySpec(BodySpec):
    """The geometry of an object or of one of its variants."""

    shape: Shape | None = Field(None, description="A primitive.")
    asset: FileName | None = Field(
        None, description="A mesh (.glb, .obj, .stl, .ply) or an `.asset.yaml`, relative to this document."
    )
    scale: Scale = Field(1.0, description=SCALE)


class VariantSpec(GeometrySpec):
    """Overrides for one variant of an object. All other properties are inherited from the object.

    A new `shape` or `asset` also removes the object's `scale` and `visual`.
    """

    visual: FileName | None = Field(None, description="A mesh to render instead of the shape.")
    category: Name | None = Field(None, description="Category, such as `mug`.")
    labels: Labels = Field((), description="Labels for vision systems; default: the object's.")

    @consistent
    def _changes_something(self) -> None:
        exclusive(self, "shape", "asset")
        exclusive(self, "mass", "density")
        if not self.model_fields_set:
            raise fault("sf107", "a variant must override at least one property of its object")


class ObjectFields(GeometrySpec):
    """Fields shared by objects and templates."""

    like: Name | None = Field(None, description="A name from `templates`; this entry states only what differs.")
    repeat: Repeat | None = Field(
        None,
        description="Copies of the object, or the name of another repeated object: one copy for each of its copies, "
        "and references to that object mean the respective copy.",
    )
    visual: FileName | None = Field(
        None, description="A mesh to render instead of the shape; it has no effect on physics."
    )
    category: Name | None = Field(None, description="Category, such as `mug`; default: the object's name.")
    labels: Labels = Field((), description="Labels for vision systems, most specific first; default: the category.")
    fixed: bool = Field(False, description="If true, the object is welded to the world.")
    pose: FramedPose = Field(
        FramedPose.model_construct(), description="Pose of the object's frame in the world, or in `frame`."
    )
    place: Place | None = Field(None, description="Placement from which the pose is computed; replaces `pose`.")
    joints: dict[Name, JointPosition] = Field(
        {},
        description="Joint positions by name: in meters, in radians, or as `{deg: 30}`. A ball joint accepts a "
        "rotation such as `{rpy_deg: [10, 0, 20]}`, and a free joint accepts a pose. Default: 0.",
    )
    variant: Name | None = Field(
        None, description="The variant to compile, one of `variants`; default: `default`, the object without overrides."
    )
    variants: dict[Name, VariantSpec] = Field(
        {},
        description="Variants by name, each of which overrides properties of the object; USD stores them in one "
        "variant set.",
    )
    origin: Origin | None = Field(None, description="Origin of the description.")
    native: ObjectNative | None = Field(None, description="Data that only one format knows, for inline shapes.")

    @consistent
    def _consistent(self) -> None:
        exclusive(self, "shape", "asset")
        exclusive(self, "mass", "density")
        exclusive(self, "pose", "place")
        if DEFAULT_VARIANT in self.variants:
            message = "no variant may be named `default`, which is reserved for the object without overrides"
            raise fault("sf107", message, "variants")


class TemplateSpec(ObjectFields):
    """An incomplete object, which objects complete with `like`."""


class ObjectSpec(ObjectFields):
    """An object in the scene: a primitive `shape` or an `asset` (a mesh file or an asset document)."""

    @consistent
    def _one_geometry(self) -> None:
        if self.like is None and self.repeat is None:  # otherwise the object could not be resolved, which is reported
            exclusive(self, "shape", "asset", needed=True)
        if self.asset is None and self.visual is None and self.scale != 1.0:
            raise fault("sf107", "`scale` applies only to meshes; change the dimensions of the shape instead", "scale")


class OptionsSpec(Model):
    """Options of the simulation, which replace those of the targets."""

    timestep: Annotated[Positive, Field(le=1)] | None = Field(
        None, description="Time step of the simulation [s]; default: the target's."
    )
    solver_iterations: Annotated[int, Field(ge=1, le=100_000)] | None = Field(
        None, description="Maximum number of iterations of the constraint solver; default: the target's."
    )


class SceneSpec(DocumentSpec):
    """A scene. The world frame is right-handed with z up, and all units are SI."""

    simfoundry: Literal["scene/1"] = Field(description="The kind and version of this document.")
    viewpoint: Name | None = Field(
        None,
        description="Camera or robot whose view defines left, right, front and behind; by default, x points away "
        "from the viewer and y points left.",
    )
    gravity: Vec3 = Field((0.0, 0.0, -9.81), description="Gravitational acceleration [m/s^2].")
    options: OptionsSpec | None = Field(None, description="Options of the simulation.")
    parameters: dict[Name, Number] = Field(
        {}, description="Numbers by name; `$gap`, `2 * $gap + 0.1` can be written wherever a number is expected."
    )
    include: dict[Name, IncludeSpec] = Field({}, description="Scenes that are part of this scene, by name.")
    templates: dict[Name, TemplateSpec] = Field({}, description="Incomplete objects by name, for `like`.")
    materials: dict[Name, Material] = Field({}, description="Materials by name.")
    frames: dict[Name, ReferenceFrame] = Field({}, description="Reference frames by name, for `pose: {frame: ...}`.")
    objects: dict[Name, ObjectSpec] = Field({}, description="Objects by name.")
    robots: dict[Name, RobotSpec] = Field({}, description="Robots by name.")
    cameras: dict[Name, CameraSpec] = Field({}, description="Cameras by name.")
    lights: dict[Name, LightSpec] = Field({}, description="Lights by name.")
    background: BackgroundSpec | None = Field(None, description="Visual surroundings of the scene.")
    no_contact: tuple[Touching, ...] = Field(
        (), max_length=1000, description="Pairs of objects, or of links such as `cabinet.door`, that do not collide."
    )
    relations: tuple[str, ...] = Field((), description="Relations that should hold, such as `OnTop(cup, desk)`.")
    origin: Origin | None = Field(None, description="Origin of the scene.")
    native: SceneNative | None = Field(
        None, description="Data that only one format knows. With `mjcf`, MuJoCo's own rules for contacts apply."
    )


# Joint position as written: a number [m or rad], an angle in degrees, or the pose of a ball or free joint.
Written = float | Degrees | PoseSpec


def number(position: Written) -> float:
    """Convert a joint position in a document to a number [m or rad]. A pose is converted to 0."""
    if isinstance(position, Degrees):
        return math.radians(position.deg)
    return position if isinstance(position, float | int) else 0.0


def position(asset: "AssetSpec", name: str, given: Mapping[str, Written]) -> float:
    """Return the position [m or rad] of a joint, or 0 if it is not in ``given``.

    The position of a mimic joint is computed from its leader. If the leaders form a cycle or a leader does not exist,
    the position is 0.
    """
    seen: set[str] = set()
    scale, offset = 1.0, 0.0
    while (joint := asset.single_joints.get(name)) is not None and joint.mimic is not None:
        if name in seen:
            return 0.0
        seen.add(name)
        scale, offset = scale * joint.mimic.multiplier, offset + scale * joint.mimic.offset
        name = joint.mimic.joint
    return scale * number(given.get(name, 0.0)) + offset if joint is not None else 0.0


GEOMETRY = ("shape", "asset")
# Fields that describe a shape or mesh and are dropped when the shape or mesh is replaced.
OF_GEOMETRY = ("scale", "visual")


def variant_of(item: ObjectSpec, name: str) -> ObjectSpec:
    """Return the variant ``name`` of an object as an object without variants.

    ``default`` is the object without any overrides.

    Raises:
        pydantic.ValidationError: If the object and the variant are incompatible, for example if the variant sets
            `scale` for a primitive.
    """
    from simfoundry.spec.models.types import RIVALS  # reads a file, which checking a scene without variants can skip

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
    """Return the names of an object's variants, starting with ``default``.

    The list is empty if the object has no variants.
    """
    return [DEFAULT_VARIANT, *item.variants] if item.variants else []
