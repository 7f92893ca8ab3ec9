"""The ``task/1`` document: the instruction, goal, steps and initial states of a task in a scene."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Literal

from pydantic import Field, StringConstraints

from simfoundry.spec.models.base import (
    DocumentSpec,
    FileName,
    Interval,
    Model,
    Name,
    Ordered,
    Point2,
    Positive,
    consistent,
    fault,
)
from simfoundry.spec.models.disturbances import Disturbances
from simfoundry.spec.models.origin import Origin
from simfoundry.spec.models.predicate import Condition
from simfoundry.spec.models.reuse import FramedPose
from simfoundry.spec.models.scene import JointPosition, Place, SceneSpec

Instruction = Annotated[str, StringConstraints(min_length=1, max_length=500)]
Cells = Annotated[int, Field(ge=1, le=100)]


class Start(Model):
    """The differences between the initial state and the scene."""

    place: dict[Name, Place] = Field({}, description="Objects with a different place, by name.")
    pose: dict[Name, FramedPose] = Field({}, description="Objects with a different pose, by name.")
    joints: dict[Name, dict[Name, JointPosition]] = Field({}, description="Joint positions by object and joint.")

    @consistent
    def _once(self) -> None:
        twice = [name for name in self.place if name in self.pose]
        if twice:
            raise fault("sf107", f"`{twice[0]}` has both a place and a pose; remove one of them", "pose")


class Subtask(Model):
    """A step of the task. It is complete once its goal has been satisfied."""

    goal: Condition = Field(
        description="Condition that ends the step: a predicate, or conditions combined with `all`, `any` and `not`."
    )
    instruction: Instruction | None = Field(
        None, description="Instruction for the policy when the step is run on its own."
    )
    start: Start | None = Field(
        None, description="Initial state when the step is run on its own, applied on top of the task's `start`."
    )


class ResetRegion(Model):
    """A region for the initial position of an object. The height of the object is unchanged."""

    x: Annotated[Point2, Ordered] = Field(description="Minimum and maximum x in the world [m].")
    y: Annotated[Point2, Ordered] = Field(description="Minimum and maximum y in the world [m].")
    yaw_deg: Interval = Field(
        (0.0, 0.0), description="Minimum and maximum rotation about z, added to the scene's pose [deg]."
    )


class Reset(Model):
    """A variation of the initial state. In each rollout, an object starts in a different cell of its region's grid."""

    grid: tuple[Cells, Cells] = Field((5, 5), description="Number of cells in each region along x and y.")
    objects: dict[Name, ResetRegion] = Field({}, description="Initial regions by object name.")


class TaskSpec(DocumentSpec):
    """A task: an instruction, the goal that ends it, its steps, and the initial states of its rollouts."""

    simfoundry: Literal["task/1"] = Field(description="The kind and version of this document.")
    scene: FileName = Field(description="The scene, relative to this document.")
    instruction: Instruction = Field(description="Instruction for the policy.")
    robots: tuple[Name, ...] | None = Field(
        None,
        min_length=1,
        max_length=8,
        description="Robots that the policy controls; default: all robots in the scene.",
    )
    goal: Condition = Field(
        description="Condition that ends the task: a predicate, or conditions combined with `all`, `any` and `not`."
    )
    subtasks: dict[Name, Subtask] = Field({}, description="Steps by name, in order.")
    start: Start = Field(Start(), description="Differences between the initial state and the scene.")
    reset: Reset = Field(Reset(), description="Variation of the initial state between rollouts.")
    control_hz: Positive = Field(15.0, le=1000, description="Control frequency [Hz].")
    horizon: Annotated[int, Field(ge=1, le=1_000_000)] = Field(
        600, description="Maximum number of control steps, after which the rollout fails."
    )
    disturbances: Disturbances = Field(
        Disturbances.model_construct(), description="Latency and noise of actions and observations in rollouts."
    )
    origin: Origin | None = Field(None, description="Origin of the task.")


def with_starts(spec: SceneSpec, starts: Iterable[Start]) -> SceneSpec:
    """Return the scene with the initial states in ``starts`` applied. Later entries override earlier ones."""
    objects = dict(spec.objects)
    for start in starts:
        for name, place in start.place.items():
            objects[name] = objects[name].model_copy(update={"place": place})
        for name, pose in start.pose.items():
            objects[name] = objects[name].model_copy(update={"place": None, "pose": pose})
        for name, joints in start.joints.items():
            objects[name] = objects[name].model_copy(update={"joints": {**objects[name].joints, **joints}})
    return spec.model_copy(update={"objects": objects})
