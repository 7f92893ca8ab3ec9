"""Joints from a vision-language model in two roles: an actor that places them, and a critic that judges their motion.

Source: the paper, section "Articulated Object Generation", after Articulate Anything
(https://arxiv.org/abs/2410.13882). There, the actor writes a program; here, it returns data, which is never executed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from simfoundry.capture.articulation.mesh_asset import LinkPhysics, box_volume, link_pieces
from simfoundry.capture.articulation.part_pictures import motion_picture, plain_picture, segment_picture
from simfoundry.capture.articulation.placed_joints import PartJoint, PartName, PlacedJoint, check_joints, place
from simfoundry.capture.articulation.segments import SegmentedMesh
from simfoundry.errors import SimfoundryError
from simfoundry.models.contract import ModelError
from simfoundry.models.vlm import Vlm, VlmError
from simfoundry.render.montage import png_bytes

# Number of times that the actor may place the joints, and the rating with which the critic is satisfied, as in the
# authors' release.
ROUNDS, SATISFIED = 5, 8

ACTOR = """\
These pictures show one object from several sides: as it looks, and with its segments in colors, with their numbers.
The box around each segment [cm], from left to right, from back to front and from bottom to top as seen by a person who
faces the front, is:
{boxes}

List the parts that a person can move, such as drawers, doors, lids, flaps, knobs and wheels, and none that is fixed.
For each part, give all segments that move with it, such as its handle and its inside, and its joint: `prismatic` for a
slide with its `travel` in meters, `revolute` for a hinge with its `travel` in degrees and its `hinge`, the edge of the
part's box about which it turns, or `continuous` for what turns without end. `opens` is the direction in which the part
starts to move. Set `parent` if a part is attached to another moving part."""

AGAIN = """
Your last answer was:
{answer}
It has this problem: {problem}
Correct it."""

CRITIC = """\
The first picture shows an object as it looks. The second has one row for each moving part; from left to right, the part
moves through its range. Rate how well the motion is that of the real object: 0 to 2 if a part has the wrong type of
joint or consists of the wrong pieces, 3 to 4 if its axis has the wrong direction, 5 to 6 if its hinge is at the wrong
place, 7 if only its range is wrong, 8 to 10 if it moves as the real object does. A part that is missing, or that is in
truth fixed, is a wrong part. The parts are: {parts}. State the worst fault of all and how to mend it."""

PHYSICS = """\
This object has the parts listed below, with the volume of the box around each. Estimate for each the mass [kg] of the
real part, and the friction [N, or N m for what turns] and damping [N s/m, or N m s/rad] of its joint; `body` has no
joint.
{parts}"""


class PlacedJoints(BaseModel):
    """The moving parts of an object."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    joints: tuple[PlacedJoint, ...] = Field(max_length=60)


class MotionCritique(BaseModel):
    """A judgment of how parts move.

    Attributes:
        rating: 0 to 10.
        fault: The worst fault.
        suggestion: How to mend it.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    rating: int = Field(ge=0, le=10)
    fault: Literal["none", "parts", "joint_type", "joint_axis", "joint_origin", "joint_limit"]
    suggestion: Annotated[str, Field(max_length=2000)] = ""


class PartPhysics(BaseModel):
    """Estimated physical properties of a part; see :class:`LinkPhysics`."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    name: PartName
    mass: float = Field(gt=0, le=1000)
    joint_friction: float | None = Field(None, ge=0, le=1000)
    joint_damping: float | None = Field(None, ge=0, le=1000)


class ObjectPhysics(BaseModel):
    """Estimated physical properties of all parts."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    parts: tuple[PartPhysics, ...] = Field(max_length=61)


@dataclass(frozen=True)
class JudgedJoints:
    """Joints with the judgments of the critic.

    Attributes:
        joints: The joints of the round with the best rating.
        physics: Physical properties of parts and body, by name.
        critiques: The critique of each round in which the joints could be placed.
        rating: The best rating.
    """

    joints: tuple[PartJoint, ...]
    physics: dict[str, LinkPhysics]
    critiques: tuple[MotionCritique, ...]
    rating: int


def propose_joints(
    vlm: Vlm, mesh: SegmentedMesh, report: Callable[[str, float], None] = lambda text, share: None
) -> JudgedJoints:
    """Ask a model for the joints of a mesh until its critic is satisfied, at most :data:`ROUNDS` times.

    Raises:
        ModelError: If the model does not answer, finds no moving part, or never places its joints on the mesh.
    """
    looks = [png_bytes(plain_picture(mesh)), png_bytes(segment_picture(mesh))]
    critiques: list[MotionCritique] = []
    best: tuple[int, list[PartJoint]] | None = None
    prompt = request = ACTOR.format(boxes=_boxes(mesh))
    problem = ""
    try:
        for k in range(ROUNDS):
            report(f"placing joints, round {k + 1}", k / ROUNDS)
            answer = vlm.ask(prompt, looks, PlacedJoints)
            joints, problem = _placed(answer, mesh)
            if not problem:
                critique = _judge(vlm, mesh, joints, looks[0])
                critiques.append(critique)
                if best is None or critique.rating > best[0]:
                    best = critique.rating, joints
                if critique.rating >= SATISFIED:
                    break
                problem = f"{critique.fault}: {critique.suggestion}"
            prompt = request + AGAIN.format(answer=answer.model_dump_json(), problem=problem)
        if best is None:
            raise ModelError(f"{vlm.name} did not place joints on the mesh in {ROUNDS} attempts: {problem}")
        physics = _physics(vlm, mesh, best[1], looks[0])
    except VlmError as error:
        raise ModelError(str(error)) from None
    return JudgedJoints(tuple(best[1]), physics, tuple(critiques), best[0])


def _placed(answer: PlacedJoints, mesh: SegmentedMesh) -> tuple[list[PartJoint], str]:
    """Return the joints in coordinates, and the reason if they do not fit the mesh."""
    if not answer.joints:
        return [], "no part moves; if that is so, the object is not articulated, so look again"
    try:
        joints = [place(joint, mesh) for joint in answer.joints]
        check_joints(joints, mesh)
    except SimfoundryError as error:
        return [], str(error)
    return joints, ""


def _judge(vlm: Vlm, mesh: SegmentedMesh, joints: Sequence[PartJoint], look: bytes) -> MotionCritique:
    prompt = CRITIC.format(parts=", ".join(f"{joint.name} ({joint.type})" for joint in joints))
    return vlm.ask(prompt, [look, png_bytes(motion_picture(mesh, joints))], MotionCritique)


def _physics(vlm: Vlm, mesh: SegmentedMesh, joints: Sequence[PartJoint], look: bytes) -> dict[str, LinkPhysics]:
    own = link_pieces(mesh, joints)
    listed = "\n".join(f"- {name}: {1000 * box_volume(pieces):.3g} liters" for name, pieces in own.items())
    answer = vlm.ask(PHYSICS.format(parts=listed), [look], ObjectPhysics)
    return {
        part.name: LinkPhysics(part.mass, vlm.name, part.joint_friction, part.joint_damping)
        for part in answer.parts
        if part.name in own
    }


def _boxes(mesh: SegmentedMesh) -> str:
    """Return one line for each segment."""
    lines = []
    for segment in mesh.segments:
        (x0, y0, z0), (x1, y1, z1) = 100 * segment.low, 100 * segment.high
        lines.append(f"- {segment.number}: {y0:.1f} to {y1:.1f}, {x0:.1f} to {x1:.1f}, {z0:.1f} to {z1:.1f}")
    return "\n".join(lines)
