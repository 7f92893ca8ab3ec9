"""Joints in words: which segments move, along or about which edge of their box, and how far.

People and vision-language models name an edge more reliably than they estimate coordinates (Articulate Anything,
https://arxiv.org/abs/2410.13882). Directions are those of a person who faces the front of the object.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError, model_validator

from simfoundry.capture.articulation.segments import SegmentedMesh, bounds
from simfoundry.errors import SimfoundryError
from simfoundry.frontends.names import free_name, plain_name
from simfoundry.geometry.frames import Array, cross
from simfoundry.models.tasks.meshes import PredictedJoint
from simfoundry.spec.models.joint import AxisKind

Direction = Literal["front", "back", "left", "right", "top", "bottom"]

# Unit vectors in the frame of the object: x out of its front, and right is right for a person who faces the front.
DIRECTIONS: dict[Direction, tuple[float, float, float]] = {
    "front": (1.0, 0.0, 0.0),
    "back": (-1.0, 0.0, 0.0),
    "left": (0.0, -1.0, 0.0),
    "right": (0.0, 1.0, 0.0),
    "top": (0.0, 0.0, 1.0),
    "bottom": (0.0, 0.0, -1.0),
}

Edge = Literal[
    "front_left", "front_right", "front_top", "front_bottom",
    "back_left", "back_right", "back_top", "back_bottom",
    "top_left", "top_right", "bottom_left", "bottom_right",
]  # fmt: skip

PartName = Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_]{0,40}$")]

# Smallest component along a direction, of the direction in which the middle of a part starts to move, so that the part
# opens in this direction. A door that is ten times as wide as thick moves sideways by a tenth as much as to the front.
OPENS = 0.2


class PlacedJoint(BaseModel):
    """A part that moves, and its joint, relative to the box around the part.

    Attributes:
        name: Short name of the part, such as `left_door`.
        segments: Numbers of the segments that make up the part.
        type: `revolute` for a hinge, `prismatic` for a slide, `continuous` for a knob or a wheel.
        hinge: Edge of the part's box that is the axis of a hinge.
        opens: Direction in which the part starts to move when it opens; the axis of a knob points there.
        travel: Distance of a slide [m], or angle of a hinge [deg], from the state of the mesh to fully open.
        parent: Name of the part that it is attached to; empty for the body.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    name: PartName
    segments: tuple[Annotated[int, Field(ge=1, le=10_000)], ...] = Field(min_length=1, max_length=1000)
    type: AxisKind
    hinge: Edge | None = None
    opens: Direction = "front"
    travel: float = Field(0.0, ge=0, le=360)
    parent: PartName | Literal[""] = ""

    @model_validator(mode="after")
    def _fits_its_type(self) -> PlacedJoint:
        if (self.type == "revolute") != (self.hinge is not None):
            raise ValueError("`hinge` is required for a revolute joint, and not allowed for other types")
        if self.type != "continuous" and self.travel == 0:
            raise ValueError("`travel` must be greater than 0: degrees of a hinge, or meters of a slide")
        return self


@dataclass(frozen=True)
class PartJoint:
    """A joint of a part, in the frame of the object.

    Attributes:
        name: Name of the part.
        segments: Numbers of its segments.
        parent: Name of the part that it is attached to; empty for the body.
        type: Type of the joint.
        axis: Unit vector along the axis.
        origin: A point on the axis [m].
        lower: Lower limit [rad or m].
        upper: Upper limit [rad or m].
    """

    name: str
    segments: tuple[int, ...]
    parent: str
    type: AxisKind
    axis: tuple[float, float, float]
    origin: tuple[float, float, float]
    lower: float = 0.0
    upper: float = 0.0


def parse_joint(text: str) -> PlacedJoint:
    """Return the joint that ``NAME=SEGMENTS:TYPE:...`` describes, as in a command.

    A hinge is ``door=3,4:revolute:front_left:front:110``, a slide ``drawer=2:prismatic:front:0.2``, and a knob
    ``knob=7:continuous:front``. ``@PARENT`` after the name attaches the part to another one, as in ``knob@door``.

    Raises:
        SimfoundryError: If the text cannot be read.
    """
    name, found, rest = text.partition("=")
    name, _, parent = name.partition("@")
    segments, *words = rest.split(":")
    kind = words[0] if words else ""
    keys = {"revolute": ["hinge", "opens", "travel"], "prismatic": ["opens", "travel"], "continuous": ["opens"]}
    usage = (
        "NAME=SEGMENTS:revolute:EDGE:OPENS:DEGREES, NAME=SEGMENTS:prismatic:OPENS:METERS or "
        "NAME=SEGMENTS:continuous:AXIS"
    )
    if not found or kind not in keys or len(words) != 1 + len(keys[kind]):
        raise SimfoundryError(f"`{text}` is not a joint; write {usage}, such as door=3,4:revolute:front_left:front:90")
    values = dict(zip(keys[kind], words[1:], strict=True))
    numbers = segments.split(",")
    try:
        return PlacedJoint.model_validate(
            {"name": name, "segments": numbers, "type": kind, "parent": parent, **values}, strict=False
        )
    except ValidationError as error:
        first = error.errors()[0]
        where = str(first["loc"][0]) if first["loc"] else "the joint"
        allowed = {"hinge": get_args(Edge), "opens": get_args(Direction)}.get(where)
        what = f"expected one of {', '.join(allowed)}" if allowed else first["msg"].removeprefix("Value error, ")
        raise SimfoundryError(f"`{text}` is not a joint: {where}: {what}") from None


def place(joint: PlacedJoint, mesh: SegmentedMesh) -> PartJoint:
    """Return a joint in coordinates.

    Raises:
        SimfoundryError: If a segment does not exist, or the hinge cannot open in the stated direction.
    """
    segments = mesh.chosen(joint.segments)
    low, high = bounds([piece for segment in segments for piece in segment.pieces])
    middle = (low + high) / 2
    opens = np.array(DIRECTIONS[joint.opens])
    if joint.hinge is None:
        upper = joint.travel if joint.type == "prismatic" else 0.0
        return _joint(joint, opens, middle, upper)
    first, second = (np.array(DIRECTIONS[word]) for word in get_args(Direction) if word in joint.hinge.split("_"))
    origin = middle + (first + second) * (high - low) / 2
    axis = cross(first, second)
    toward = cross(axis, middle - origin)
    length = float(np.linalg.norm(toward))
    along = float(toward @ opens) / length if length else 0.0
    if abs(along) < OPENS:
        raise SimfoundryError(f"{joint.name} cannot open toward {joint.opens} about its edge {joint.hinge}")
    return _joint(joint, axis * math.copysign(1.0, along), origin, math.radians(joint.travel))


def predicted(joints: Iterable[PredictedJoint], mesh_labels: dict[int, int]) -> list[PartJoint]:
    """Return the joints that a model predicted for labels of a mesh.

    Args:
        joints: The joints, in the frame of the object.
        mesh_labels: The number of the segment for each label.

    Raises:
        SimfoundryError: If a part is not among the segments.
    """
    joints = list(joints)
    names: dict[int, str] = {}
    for joint in joints:
        name = free_name(plain_name(joint.name, "part"), {"body", *names.values()})
        names.update(dict.fromkeys((joint.part, *joint.others), name))
    found = []
    for joint in joints:
        if joint.part not in mesh_labels:
            raise SimfoundryError(
                f"the model found a joint of part {joint.part}, which is too small a part of the mesh to be moved"
            )
        parent = names.get(joint.parent, "")
        numbers = (mesh_labels[joint.part], *(mesh_labels[other] for other in joint.others if other in mesh_labels))
        axis, origin = joint.axis, joint.origin
        found.append(PartJoint(names[joint.part], numbers, parent, joint.type, axis, origin, joint.lower, joint.upper))
    return found


def check_joints(joints: Sequence[PartJoint], mesh: SegmentedMesh) -> None:
    """Check that the joints of an object fit together.

    Raises:
        SimfoundryError: If two parts have the same name or share a segment, a parent does not exist, parents form a
            loop, or nothing is left for the body.
    """
    names = [joint.name for joint in joints]
    numbers = [number for joint in joints for number in joint.segments]
    mesh.chosen(numbers)
    if "body" in names or len(set(names)) < len(names):
        raise SimfoundryError("each moving part needs a name of its own, other than `body`")
    if len(set(numbers)) < len(numbers):
        twice = sorted({number for number in numbers if numbers.count(number) > 1})
        raise SimfoundryError(f"segment {twice[0]} belongs to several parts; give it to one")
    if not mesh.rest and len(numbers) == len(mesh.segments):
        raise SimfoundryError("all segments move; leave at least one for the body")
    parents = {joint.name: joint.parent for joint in joints}
    for name in names:
        seen, at = {name}, parents[name]
        while at:
            if at not in parents:
                raise SimfoundryError(f"{name} is attached to {at}, which is not a moving part")
            if at in seen:
                raise SimfoundryError(f"{name} is attached to itself through {at}")
            seen.add(at)
            at = parents[at]


def _joint(joint: PlacedJoint, axis: Array, origin: Array, upper: float) -> PartJoint:
    x, y, z = map(float, origin)
    a, b, c = map(float, axis)
    return PartJoint(joint.name, joint.segments, joint.parent, joint.type, (a, b, c), (x, y, z), 0.0, upper)
