"""Parts of a scene that say a thing once: repeated objects, templates, included scenes, and named frames."""

import math
from collections.abc import Iterator, Mapping
from itertools import product
from typing import Annotated, Any

from pydantic import Discriminator, Field, Tag

from simfoundry.spec.models.base import (
    Coordinate,
    FileName,
    Model,
    Name,
    Number,
    PartName,
    PoseSpec,
    consistent,
    exclusive,
    fault,
)

# Maximum number of copies of one object; a scene with 1,000 objects already takes seconds to compile.
MAX_COPIES = 10_000

# Maximum length of a chain of frames, templates, or objects that repeat with each other; limits the work for malicious
# input.
MAX_DEPTH = 32

Copies = Annotated[int, Field(ge=1, le=MAX_COPIES)]
Offset = tuple[Coordinate, ...]


def _count_tag(value: Any) -> str:
    return "grid" if isinstance(value, tuple | list) else "row"


def _step_tag(value: Any) -> str:
    if not isinstance(value, tuple | list):
        return "distance"
    return "vectors" if any(isinstance(item, tuple | list) for item in value) else "numbers"


Count = Annotated[
    Annotated[Copies, Tag("row")] | Annotated[tuple[Copies, ...], Field(min_length=1, max_length=3), Tag("grid")],
    Discriminator(_count_tag),
]
Step = Annotated[
    Annotated[Coordinate, Tag("distance")]
    | Annotated[Offset, Field(min_length=1, max_length=3), Tag("numbers")]
    | Annotated[
        tuple[Annotated[Offset, Field(min_length=2, max_length=3)], ...],
        Field(min_length=1, max_length=3),
        Tag("vectors"),
    ],
    Discriminator(_step_tag),
]


class RepeatSpec(Model):
    """Copies of an object in a row, a grid or a stack.

    The copies are called `cup_1`, `cup_2`, or `cup_1_1`, `cup_1_2` in a grid. An entry with the name of a copy changes
    this copy only.
    """

    count: Count | None = Field(None, description="Number of copies, or the numbers along two or three directions.")
    step: Step = Field(
        0.0,
        description="Offset from one copy to the next [m]: for a row, a distance along x or a vector; for a grid, the "
        "distances along x, y and z, or one vector for each direction.",
    )
    stack: Copies | None = Field(
        None, description="Number of copies on top of each other; each one is placed on the one below it."
    )

    @consistent
    def _consistent(self) -> None:
        if self.count is None and self.stack is None:
            raise fault("sf107", "one of `count`, `stack` is needed")
        if self.count is None and "step" in self.model_fields_set:
            raise fault("sf107", "`step` needs `count`", "step")
        if isinstance(self.count, tuple) and isinstance(self.step, tuple) and len(self.step) != len(self.count):
            numbers = f"{len(self.count)} values, one for each number in `count`"
            raise fault("sf105", f"`step` needs {numbers}, but it has {len(self.step)}", "step")
        if isinstance(self.count, tuple) and len(self.count) > 1 and not isinstance(self.step, tuple):
            raise fault("sf107", "a grid needs one step for each direction, such as `step: [0.1, 0.12]`", "step")
        if not isinstance(self.count, tuple) and isinstance(self.step, tuple) and isinstance(self.step[0], tuple):
            raise fault("sf107", "a row has one step, such as `step: [0.1, 0]`", "step")
        if self.total > MAX_COPIES:
            raise fault("sf104", f"the object has {self.total} copies; the limit is {MAX_COPIES}")

    @property
    def counts(self) -> tuple[int, ...]:
        """Return the numbers of copies along each direction, without the stack."""
        if self.count is None:
            return ()
        return self.count if isinstance(self.count, tuple) else (self.count,)

    @property
    def total(self) -> int:
        """Return the number of copies."""
        return math.prod(self.counts) * (self.stack or 1)

    @property
    def steps(self) -> tuple[tuple[float, float, float], ...]:
        """Return the offset between neighbors along each direction [m]."""
        if isinstance(self.step, tuple) and not isinstance(self.count, tuple):
            return (_vector(self.step),)
        steps: tuple[Any, ...] = self.step if isinstance(self.step, tuple) else (self.step,)
        axes = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        return tuple(
            _vector(step) if isinstance(step, tuple) else (axis[0] * step, axis[1] * step, axis[2] * step)
            for step, axis in zip(steps, axes, strict=False)
        )

    def offsets(self, centered: bool = False) -> Iterator[tuple[tuple[int, ...], tuple[float, float, float]]]:
        """Yield the indices of each copy, counted from 1, and its offset [m] from the first one.

        If ``centered`` is set, the offsets are relative to the center of all copies. Copies in a stack have the same
        offset.
        """
        start = [(number - 1) / 2 if centered else 0.0 for number in self.counts]
        for index in product(*(range(number) for number in self.counts)):
            x, y, z = (
                math.fsum((k - first) * step[axis] for k, first, step in zip(index, start, self.steps, strict=False))
                for axis in range(3)
            )
            for level in range(self.stack or 1):
                yield (*(k + 1 for k in index), *([level + 1] if self.stack else [])), (x, y, z)


def _vector(step: tuple[Any, ...]) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in (*step, 0.0, 0.0)[:3])
    return x, y, z


# The copies of an object, or the name of another repeated object whose copies this object's copies belong to.
Repeat = Annotated[
    Annotated[RepeatSpec, Tag("copies")] | Annotated[Name, Tag("leader")],
    Discriminator(lambda v: "leader" if isinstance(v, str) else "copies"),
]


class FramedPose(PoseSpec):
    """The pose of a frame in the world or, if `frame` is set, in another frame."""

    frame: PartName | None = Field(
        None, description="Reference frame: a name from `frames`, an object or one of its links; default: the world."
    )


class ReferenceFrame(FramedPose):
    """A named frame, which other poses can refer to."""

    on: PartName | None = Field(
        None,
        description="Object, link or part that the frame is attached to; the origin is the center of its top side.",
    )

    @consistent
    def _one_parent(self) -> None:
        exclusive(self, "frame", "on")


def frame_chain(frames: Mapping[str, ReferenceFrame], reference: str | None) -> list[str]:
    """Return the named frames from a frame to the one that is attached to the world or to an object.

    If the frame depends on itself, the chain ends where it would repeat. If the chain is too long, which is reported as
    an error, it ends after :data:`MAX_DEPTH` + 1 frames.
    """
    chain = dict[str, None]()
    while reference is not None and reference in frames and reference not in chain and len(chain) <= MAX_DEPTH:
        chain[reference] = None
        reference = frames[reference].frame
    return list(chain)


def frame_carrier(frames: Mapping[str, ReferenceFrame], reference: str | None) -> str | None:
    """Return the object or part that a frame moves with, or None if the frame does not move."""
    chain = frame_chain(frames, reference)
    if chain:
        last = frames[chain[-1]]
        reference = last.on or last.frame
    return None if reference in chain else reference


class IncludeSpec(Model):
    """Another scene whose objects, robots, cameras, lights, materials and frames become part of this scene.

    Their names start with the name of the include: `mug` becomes `left_mug`. An entry with such a name changes it.
    """

    scene: FileName = Field(description="Path of the scene, relative to this document.")
    pose: FramedPose | None = Field(
        None, description="Pose of the included scene; it defines a frame with the name of the include."
    )
    parameters: dict[Name, Number] = Field({}, description="Values for parameters of the included scene.")

    @consistent
    def _level(self) -> None:
        pose = self.pose
        if pose is not None and (pose.rpy_deg is not None or pose.quat_wxyz is not None):
            raise fault("sf107", "an included scene can only be turned about z; use `yaw_deg`", "pose")
