"""Values that can vary: their kinds, and the places in documents to which they are written."""

from __future__ import annotations

import typing
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import NoneType
from typing import Any, Literal

from pydantic import BaseModel

from simfoundry.errors import SimfoundryError
from simfoundry.spec.check.varied_values import NO_ENDS, Ends, bounds_of
from simfoundry.spec.models.base import BodySpec, CameraPose, Estimate, Material, PoseSpec, quantity_value
from simfoundry.spec.models.types import field_type, flat, is_file

# Values of bodies that they can inherit from their material; a mass follows from its density.
OF_MATERIALS = ("mass", "density", "friction", "restitution", "color")


class ValueKind(StrEnum):
    """The kind of a value, which decides how it can vary. The text completes `… is`."""

    NUMBER = "a number"
    JOINT = "the position of a joint"
    ARM = "the positions of all arm joints"
    VECTOR = "a vector"
    POSE = "a pose"
    HEIGHT = "the height of an object"
    COLOR = "a color"
    FILE = "a file"
    BACKGROUND = "the background"
    WORD = "a text"


# What depends on a value: pictures, the physics of the scene, the instruction, or the noise and latency of observations
# or actions. Only physics and actions affect the states that given actions lead to.
Effect = Literal["pictures", "physics", "instruction", "observation", "action"]
DocumentPath = tuple[str, ...]


@dataclass(frozen=True)
class VariedPlace:
    """A value in a document of the twin.

    Attributes:
        document: `scene`, `task`, or `NAME.asset` for the asset of an object.
        path: Path of the value in that document.
        base: The twin's value, or None if it states none.
        ends: Least and greatest number that is valid here.
        estimate: Range of the twin's estimate, or None.
        owner: The model that contains the value, or None if no model does.
    """

    document: str
    path: DocumentPath
    base: Any = None
    ends: Ends = NO_ENDS
    estimate: Ends | None = None
    owner: BaseModel | None = None


@dataclass(frozen=True)
class VariedField:
    """A value that varies: one draw, which is written to one or more places.

    Attributes:
        name: Path without `*`, which identifies the draw.
        kind: Kind of the value.
        places: Places to which the value is written.
        effect: What depends on the value.
        object: Name of the object, camera or robot whose pose, joint or asset varies, or empty.
        whole: True if the value must be an integer.
        degrees: True if the value is written in degrees, as `{deg: 30}`.
        turns: True if the value is the position of a joint that rotates.
    """

    name: str
    kind: ValueKind
    places: tuple[VariedPlace, ...]
    effect: Effect = "physics"
    object: str = ""
    whole: bool = False
    degrees: bool = False
    turns: bool = False

    @property
    def is_file(self) -> bool:
        """True if the value is a file."""
        return self.kind in (ValueKind.FILE, ValueKind.BACKGROUND)


class VaryPathError(SimfoundryError):
    """An error in a path of `vary`."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message, self.hint = message, hint


def value_kind(model: type[BaseModel], name: str) -> ValueKind | None:
    """Return the kind of a field's value, or None if values of this kind cannot vary."""
    kind = field_type(model, name)
    members = list(flat(kind))
    types_ = [inner for _, inner in members if inner is not NoneType]
    if is_file(kind):
        return ValueKind.FILE
    if any(tag == "rgb" for tag, _ in members):
        return ValueKind.COLOR
    if any(isinstance(inner, type) and issubclass(inner, PoseSpec | CameraPose) for inner in types_):
        return ValueKind.POSE
    if any(inner in (float, int) for inner in types_):
        return ValueKind.NUMBER
    if any(_is_vector(inner) for inner in types_):
        return ValueKind.VECTOR
    if any(inner is str or typing.get_origin(inner) is Literal for inner in types_):
        return ValueKind.WORD
    return None


def _is_vector(kind: Any) -> bool:
    numbers = typing.get_args(kind)
    return typing.get_origin(kind) is tuple and len(numbers) == 3 and all(next(flat(n))[1] is float for n in numbers)


def place_of(document: str, path: DocumentPath, owner: BaseModel) -> VariedPlace:
    """Return the place of a model's field, with its value, its bounds and the range of its estimate."""
    base = getattr(owner, path[-1])
    estimate = base.range if isinstance(base, Estimate) else None
    value = quantity_value(base) if isinstance(base, Estimate) else base
    size = float(value) if isinstance(value, float | int) and not isinstance(value, bool) else None
    return VariedPlace(document, path, value, bounds_of(type(owner), path[-1], size), estimate, owner)


def inherited_place(
    place: VariedPlace, body: BodySpec, key: str, materials: Mapping[str, Material], as_density: bool
) -> VariedPlace:
    """Return a place whose value comes from the material of the body, or whose mass is stated as a density."""
    if place.base is not None or key not in OF_MATERIALS:
        return place
    if key == "mass" and not as_density:
        return place
    parts = getattr(body, "parts", None) or {}
    names = [body.material] if body.material is not None else [part.material for part in parts.values()]
    found = [materials[name] for name in dict.fromkeys(names) if name is not None and name in materials]
    if key in ("mass", "density"):
        if isinstance(body.density, Estimate) or body.density is not None:
            return place_of(place.document, (*place.path[:-1], "density"), body)
        values = [material.density for material in found]
        value = values[0] if len(values) == 1 else None
        path = (*place.path[:-1], "density") if value is not None else place.path
        return VariedPlace(place.document, path, value, place.ends, None, body)
    value = getattr(found[0], key) if found else Material.model_fields[key].default
    return VariedPlace(place.document, place.path, value, place.ends, None, body)
