"""Types shared by all documents: names, numbers with units, poses, shapes, and estimates."""

# This module and the other model modules do not postpone annotations: pydantic would compile each string at start-up.

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Literal, LiteralString, NamedTuple

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    GetJsonSchemaHandler,
    StringConstraints,
    Tag,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import PydanticCustomError

NAME = r"^[a-z][a-z0-9_]*$"
PART_NAME = r"^[a-z][a-z0-9_]*(\.[a-z][a-z0-9_]*)?$"
CODE = "^[A-Z]{2,8}[0-9]{3}$"
JOINT_NAME = "^[A-Za-z_][A-Za-z0-9_./-]*$"
WIRE_KEY = "^[A-Za-z0-9_][A-Za-z0-9_./-]*$"
VARIABLE = "^[A-Z_][A-Z0-9_]*$"
FORMAT_NAME = "^[a-z][a-z0-9_.-]*$"
# Names and keys separated by dots, in which `*` stands for any characters of a name.
VARY_PATH = r"^[a-z*][a-z0-9_*]*(\.[A-Za-z0-9_*]+)*$"
URL = "^https?://[^ ]+$"
DIGEST = "^[0-9a-f]{64}$"
# Only variables with this beginning are sent to model servers, so that a project cannot read others.
TOKEN_VARIABLE = "^SIMFOUNDRY_[A-Z0-9_]+$"
# Hexadecimal sRGB color, as in CSS: red, green, blue and optionally opacity, with two digits each.
HEX_COLOR = "^#([0-9A-Fa-f]{6}|[0-9A-Fa-f]{8})$"


class PatternText(NamedTuple):
    """Descriptions of a string pattern for users.

    ``placeholder`` is shown in editors, ``title`` in the reference, and ``rule`` in error messages.
    """

    placeholder: str
    title: str
    rule: str


PATTERNS = {
    NAME: PatternText(
        "name", "name", "a name starts with a lower-case letter, followed by lower-case letters, digits and `_`"
    ),
    PART_NAME: PatternText("name", "name or name.part", "a name such as `cabinet`, or a link such as `cabinet.drawer`"),
    CODE: PatternText("SF402", "code", "the code of a warning, such as `SF402`"),
    JOINT_NAME: PatternText("joint", "joint", "the name of a joint in the robot's model"),
    WIRE_KEY: PatternText("key", "key", "a key that the policy expects, such as `observation/wrist_image_left`"),
    VARIABLE: PatternText(
        "VARIABLE", "environment variable", "the name of an environment variable (uppercase), not the key itself"
    ),
    FORMAT_NAME: PatternText("lerobot-v3", "format", "the name of a file format for datasets, such as `lerobot-v3`"),
    VARY_PATH: PatternText(
        "light.*.intensity",
        "path",
        "a path consists of names and keys separated by dots, such as `light.*.intensity` or `cabinet.drawer`",
    ),
    URL: PatternText("http://host:8301", "URL", "a URL starts with `http://` or `https://`"),
    DIGEST: PatternText("e3b0c44…", "SHA-256 digest", "a SHA-256 digest has 64 hexadecimal digits, in lower case"),
    TOKEN_VARIABLE: PatternText(
        "SIMFOUNDRY_TOKEN",
        "environment variable",
        "the name of an environment variable that starts with `SIMFOUNDRY_`, such as `SIMFOUNDRY_GPU_TOKEN`",
    ),
    HEX_COLOR: PatternText(
        "#c8a070",
        "hexadecimal color",
        "a hexadecimal color has 6 or 8 digits, such as `#c8a070`, and must be in quotes",
    ),
}

Name = Annotated[str, StringConstraints(pattern=NAME, max_length=64)]
# Name of an object, such as ``cabinet``, or of one of its links, such as ``cabinet.drawer``.
PartName = Annotated[str, StringConstraints(pattern=PART_NAME, max_length=129)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
Code = Annotated[str, StringConstraints(pattern=CODE)]
Reason = Annotated[str, StringConstraints(min_length=3, max_length=200)]
# Largest allowed position or size [m]. Many simulators use single precision, whose resolution at this distance is 6 cm.
FARTHEST = 1e6
Coordinate = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST, allow_inf_nan=False)]
Length = Annotated[float, Field(gt=0, le=FARTHEST, allow_inf_nan=False)]
Range = tuple[Number, Number]
# Component of a vector of any unit; the bound keeps the squares of its components finite in single precision.
Component = Annotated[float, Field(ge=-FARTHEST, le=FARTHEST, allow_inf_nan=False)]
Vec3 = tuple[Component, Component, Component]
Point2 = tuple[Coordinate, Coordinate]
Point3 = tuple[Coordinate, Coordinate, Coordinate]
Size3 = tuple[Length, Length, Length]
# Length of one mesh unit [m], or that along the x, y and z axes of the mesh, with z up.
Scale = Annotated[
    Annotated[Positive, Tag("number")] | Annotated[tuple[Positive, Positive, Positive], Tag("axes")],
    Discriminator(lambda v: "axes" if isinstance(v, tuple | list) else "number"),
]
# Description of the scale of a mesh.
SCALE = "Length of one mesh unit [m], or three lengths along x, y and z (z is up, also for files with y up)."
MAX_IMAGE_SIDE = 8192  # Largest width or height of an image [px], as for textures
Pixels = Annotated[int, Field(ge=1, le=MAX_IMAGE_SIDE)]
ImageSize = tuple[Pixels, Pixels]

# Name reserved for the static world: it is the first body in MuJoCo, and a special link name in URDF readers.
WORLD = "world"


@dataclass(frozen=True)
class Reference:
    """A marker for strings that are file paths relative to their document.

    If a document in a different folder extends the document, such paths are adjusted.
    """


FileName = Annotated[str, Reference()]


@dataclass(frozen=True)
class FormerKey:
    """A record of the former key of a field. `check` suggests the current key, and `migrate` renames the former one."""

    key: str


def consistent(check: Callable[[Any], None]) -> Any:
    """Mark a method as a check that raises :func:`fault` if the fields of its model contradict each other."""

    def checked(model: Any) -> Any:
        check(model)
        return model

    return model_validator(mode="after")(checked)


# Name of the person, program or method that created something.
Agent = Annotated[str, FormerKey("by"), StringConstraints(max_length=64)]


class Model(BaseModel):
    """The base class for all parts of a document, which are immutable, strictly typed, and without unknown keys.

    If the default of a field is a model, create it with ``model_construct()``, because validating it would compile the
    model's schema at import time.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False, defer_build=True)


def fault(code: LiteralString, message: str, at: str = "") -> PydanticCustomError:
    """Return a validation error, which is reported as a finding with the code ``code`` at the model's key ``at``."""
    return PydanticCustomError(code, "{message}", {"message": message, "at": at} if at else {"message": message})


def _ordered(ends: tuple[float, ...]) -> tuple[float, ...]:
    if ends[0] > ends[1]:
        raise fault("sf104", "the minimum must not exceed the maximum")
    return ends


# Validator for a (minimum, maximum) pair.
Ordered = AfterValidator(_ordered)
Interval = Annotated[Range, Ordered]


def exclusive(model: Model, *names: str, needed: bool = False) -> None:
    """Raise an error if more than one of the fields is set or, with ``needed``, if none of them is set."""
    written = model.model_fields_set
    given = [n for n in names if n in written and getattr(model, n) is not None]
    if len(given) == 1 or not (given or needed):
        return
    listed = ", ".join(f"`{n}`" for n in names)
    if given:
        raise fault("sf107", f"specify only one of {listed}, not {len(given)}", given[1])
    raise fault("sf107", f"one of {listed} is needed")


def _unit(quaternion: tuple[float, ...]) -> tuple[float, ...]:
    if abs(sum(v * v for v in quaternion) - 1) > 1e-3:  # files contain six decimals, but people often write three
        raise fault("sf104", "`quat_wxyz` must have length 1")
    return quaternion


Quaternion = Annotated[tuple[Number, Number, Number, Number], AfterValidator(_unit)]


def _color_values(color: Any) -> Any:
    """Convert a hexadecimal color such as ``#c8a070`` to numbers, rounded to the six decimals of documents."""
    if not isinstance(color, str):
        return color
    if not re.fullmatch(HEX_COLOR, color):
        raise fault("sf106", f'`{color[:40]}` is not a color; write 6 or 8 hexadecimal digits, such as `"#c8a070"`')
    return tuple(round(int(color[k : k + 2], 16) / 255, 6) for k in range(1, len(color), 2))


class _HexColorSchema:
    """A schema that also accepts hexadecimal colors, which the model itself stores as numbers."""

    def __get_pydantic_json_schema__(self, core: Any, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        options = handler(core)
        hexadecimal = {"type": "string", "pattern": HEX_COLOR}
        numbers: list[Any] = options.get("oneOf", [options])
        return {"anyOf": [*numbers, hexadecimal]}


Color = Annotated[
    Annotated[tuple[Fraction, Fraction, Fraction], Tag("rgb")]
    | Annotated[tuple[Fraction, Fraction, Fraction, Fraction], Tag("rgba")],
    Discriminator(lambda v: "rgba" if isinstance(v, tuple | list) and len(v) == 4 else "rgb"),
    BeforeValidator(_color_values),
    _HexColorSchema(),
]

# Description of a color; `{}` is replaced with what the color defaults to.
COLOR = 'sRGB color: red, green, blue and optionally opacity, each 0 to 1, or hexadecimal in quotes: `"#c8a070"`{}.'


class PoseSpec(Model):
    """The pose of a frame in its parent frame. At most one of the three rotation keys may be set."""

    xyz: Point3 = Field((0.0, 0.0, 0.0), description="Position [m].")
    yaw_deg: Number | None = Field(None, description="Rotation about z [deg].")
    rpy_deg: Vec3 | None = Field(
        None, description="Roll, pitch, yaw about fixed x, y, z [deg]: Rz(yaw) Ry(pitch) Rx(roll)."
    )
    quat_wxyz: Quaternion | None = Field(None, description="Quaternion, w first.")

    @consistent
    def _one_rotation(self) -> None:
        exclusive(self, "yaw_deg", "rpy_deg", "quat_wxyz")


# Point [m] that a camera looks at, or the name of an object, link or robot.
Target = Annotated[
    Annotated[Point3, Tag("point")] | Annotated[PartName, Tag("name")],
    Discriminator(lambda v: "name" if isinstance(v, str) else "point"),
]


class CameraPose(Model):
    """The pose of a camera: a position, and either a target or a rotation (x right, y down, z forward)."""

    frame: PartName | None = Field(
        None, description="Reference frame: a name from `frames`, an object or one of its links; default: the world."
    )
    xyz: Point3 = Field((0.0, 0.0, 0.0), description="Position of the optical center [m].")
    look_at: Target | None = Field(
        None,
        description="Target on the optical axis; the image is kept upright. A point [m] in the same frame as `xyz`, "
        "or a name: an object (`mug`) or its link (`cabinet.door`), of which the center of the bounding box in the "
        "initial state is used, or a robot, of which the base is used.",
    )
    quat_wxyz: Quaternion | None = Field(
        None, description="Rotation of the camera axes (x right, y down, z forward), w first."
    )

    @consistent
    def _one_rotation(self) -> None:
        exclusive(self, "look_at", "quat_wxyz", needed=True)
        if isinstance(self.look_at, tuple) and math.dist(self.look_at, self.xyz) < 1e-6:
            raise fault("sf104", "a camera cannot look at its own position", "look_at")


class Estimate(Model):
    """A number that was estimated rather than measured."""

    value: Positive = Field(description="The value to use [kg, or kg/m^3].")
    range: tuple[Positive, Positive] | None = Field(None, description="Plausible minimum and maximum [kg, or kg/m^3].")
    source: Agent = Field("unknown", description="Person or method that made the estimate, such as `category_table`.")

    @consistent
    def _inside(self) -> None:
        if self.range is not None and not self.range[0] <= self.value <= self.range[1]:
            raise fault("sf104", "`value` is outside `range`", "value")


Quantity = Annotated[
    Annotated[Positive, Tag("number")] | Annotated[Estimate, Tag("estimate")],
    Discriminator(lambda v: "estimate" if isinstance(v, dict | Estimate) else "number"),
]


def quantity_value(quantity: float | Estimate | None) -> float | None:
    """Return a quantity as a plain number."""
    return quantity.value if isinstance(quantity, Estimate) else quantity


class Material(Model):
    """The physical properties, the color and the texture of a material."""

    density: Positive | None = Field(None, description="Density [kg/m^3].")
    friction: NonNegative = Field(
        0.5, description="Coulomb friction coefficient; contacts use the geometric mean of the two surfaces."
    )
    torsional_friction: NonNegative = Field(
        0.0,
        description="Resistance to spinning at a contact: torque divided by normal force [m]; contacts use the "
        "larger value of the two surfaces.",
    )
    rolling_friction: NonNegative = Field(
        0.0,
        description="Resistance to rolling at a contact: torque divided by normal force [m]; contacts use the larger "
        "value of the two surfaces.",
    )
    restitution: Fraction = Field(
        0.0, description="Restitution, 0 to 1; contacts use the geometric mean of the two surfaces."
    )
    color: Color | None = Field(None, description=COLOR.format("; it tints the texture"))
    texture: FileName | None = Field(
        None,
        description="An image (.png, .jpg), relative to this document, that repeats over the surfaces; it is projected "
        "along the nearest axis of the shape. Meshes with a texture or color of their own keep it.",
    )
    texture_size: Length | None = Field(
        None, description="Width of one repetition of the texture [m]; default: the longest side of the surface."
    )

    @consistent
    def _texture_has_a_size(self) -> None:
        if self.texture_size is not None and self.texture is None:
            raise fault("sf107", "`texture_size` requires `texture`", "texture_size")


Collision = Literal["auto", "hull", "decompose", "none"]
Solid = Literal["exact", "hull"]


class BodySpec(Model):
    """Fields shared by everything that has mass and a surface."""

    material: Name | None = Field(None, description="A name from `materials`.")
    mass: Quantity | None = Field(None, description="Mass [kg].")
    density: Quantity | None = Field(None, description="Density [kg/m^3] of the solid volume.")
    friction: NonNegative | None = Field(None, description="Coulomb friction coefficient; default: the material's.")
    restitution: Fraction | None = Field(None, description="Restitution; default: the material's.")
    color: Color | None = Field(None, description=COLOR.format("; default: the material's, or the mesh's own"))
    collision: Collision = Field(
        "auto",
        description="Collision shapes of a mesh: `hull` uses one convex hull, `decompose` uses convex parts, and "
        "`none` disables collision. `auto` uses a box, cylinder, sphere or hull if the mesh is nearly convex, and "
        "convex parts otherwise. Primitives are not affected.",
    )
    solid: Solid = Field(
        "exact",
        description="Volume used for the mass properties of a mesh: `exact` uses the mesh, which must be closed, and "
        "`hull` uses its convex hull.",
    )


class Conflict(Model):
    """Two conflicting edits to a value. The document keeps our version until the conflict is resolved."""

    base: Any = Field(None, description="Value before either edit.")
    ours: Any = Field(None, description="Value on our side, which the document contains.")
    theirs: Any = Field(None, description="Value on the other side.")


Silence = Annotated[
    Annotated[Reason, Tag("everywhere")] | Annotated[dict[str, Reason], Tag("places")],
    Discriminator(lambda v: "places" if isinstance(v, dict) else "everywhere"),
]


class DocumentSpec(Model):
    """Keys that are available in every kind of document."""

    extends: FileName | None = Field(
        None,
        description="Path of a base document of the same kind, relative to this document. This document overrides "
        "parts of the base: mappings are merged key by key, all other values are replaced, and `null` removes a key.",
    )
    name: Name = Field(description="Name of the document: lowercase letters, digits and `_`.")
    description: str | None = Field(None, description="Human-readable description.")
    allow: dict[Code, Silence] = Field(
        {}, description="Warnings to silence, each with a reason: `SF402: why`, or `SF402: {cup: why}` for one object."
    )
    conflicts: dict[str, Conflict] = Field(
        {}, description="Unresolved merge conflicts by path; correct the value at the path, then remove the entry."
    )
