"""What a known robot is made of: the files of ``simfoundry/robots``, and of a folder of one's own in their place."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Self

import yaml
from pydantic import Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from simfoundry.errors import SimfoundryError
from simfoundry.spec.models.base import Model, Name, Number, PoseSpec, Positive
from simfoundry.spec.models.robot import JointName

Reference = str
"""A model's file: a path, `pkg:package/path`, or `menagerie:robot` or `robot_descriptions:name`, both with or without a
`/path`."""

Travel = tuple[Number, Number]
"""Where something is with the gripper open, and where with it closed."""


class FrameSpec(Model):
    """A frame by which scenes call a place of the robot: in a link of the model, at a pose in it."""

    link: str = Field(description="The link, as the model calls it.")
    pose: PoseSpec = Field(PoseSpec(), description="Pose of the frame in the link.")


class FollowSpec(Model):
    """A joint that follows another: its position is ``multiplier`` times that one's plus ``offset``."""

    joint: JointName
    multiplier: Number = 1.0
    offset: Number = 0.0


class GripperSpec(Model):
    """How a gripper is moved, and how far its joints go."""

    command: dict[str, Travel] = Field({}, description="Values of the model's actuators; default: of the joints.")
    joints: dict[JointName, Travel] = Field(description="Joint positions [rad or m]; the first tells the opening.")
    follow: dict[JointName, FollowSpec] = Field(
        {}, description="Joints that the model moves by closed loops or equations, for targets that have none."
    )


class AttachSpec(Model):
    """A model that a link of another carries."""

    file: Reference | list[Reference]
    to: str = Field(description="The link that carries it.")
    pose: PoseSpec = Field(PoseSpec(), description="Pose of its base in that link.")


class ModelSpec(Model):
    """A robot in one format. The names of an attached model have its name before them: `gripper.base`."""

    file: Reference | list[Reference] = Field(description="The file, or several of which the first found is taken.")
    attach: dict[Name, AttachSpec] = Field({}, description="Models that its links carry, as a gripper, by name.")
    links: dict[Name, FrameSpec] = Field({}, description="The frames that scenes may name, as `hand`.")
    joints: list[JointName] = Field([], description="The arm's joints, in the order of `joint1`, `joint2` and so on.")
    gripper: GripperSpec | None = None
    effort: dict[JointName, Positive] = Field(
        {}, description="Greatest force of a joint [N m or N], where the file's own is not the robot's."
    )

    @model_validator(mode="after")
    def _arm(self) -> Self:
        if self.gripper is not None and not self.joints:
            raise PydanticCustomError("arm", "`joints` must list the arm's joints where there is a gripper", {})
        return self

    @property
    def files(self) -> list[Reference]:
        """The files to look for, best first."""
        return [self.file] if isinstance(self.file, str) else self.file


class RobotModelsSpec(Model):
    """A robot's model in each format that there is one for."""

    mjcf: ModelSpec | None = None
    urdf: ModelSpec | None = None
    usd: Annotated[ModelSpec | None, Field(description="A USD whose default prim is the robot.")] = None


def read_models(file: Path) -> RobotModelsSpec:
    """What a robot file says; raises :class:`SimfoundryError` where it is not one."""
    try:
        data = yaml.load(file.read_text(encoding="utf-8"), Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        models = RobotModelsSpec.model_validate_json(json.dumps(data))
    except (OSError, yaml.YAMLError, TypeError, ValueError) as error:
        if isinstance(error, ValidationError):
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"]) or "the file"
            raise SimfoundryError(f"{file}: {where}: {first['msg']}; docs/robots.md has the form") from None
        reason = str(error).splitlines()[0]
        if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
            reason = f"line {error.problem_mark.line + 1}: {error.problem}"
        raise SimfoundryError(f"{file} is not a robot file: {reason}") from None
    if models == RobotModelsSpec():
        raise SimfoundryError(f"{file} names no model; give `mjcf`, `urdf` or `usd`; docs/robots.md has the form")
    return models
