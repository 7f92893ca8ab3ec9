"""Robots in a scene: model, pose and posture."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal, Self

from pydantic import Discriminator, Field, StringConstraints, Tag, model_validator

from simfoundry.errors import SimfoundryError
from simfoundry.spec.models.base import JOINT_NAME, FileName, Model, Name, Number, PoseSpec, Positive, fault

JointName = Annotated[str, StringConstraints(pattern=JOINT_NAME, max_length=128)]
"""Name of a joint in the robot's model."""


@dataclass(frozen=True)
class KnownRobot:
    """Properties of a robot that do not require its model, read from its file in ``simfoundry/robots``.

    ``reach`` [m] is the largest horizontal distance of a grasp from the base; ``opening`` [m] is the width of the
    widest object that fits between the fingers; ``payload`` [kg] is the mass of the heaviest object that it should
    lift, None if unknown; ``links`` are the links on which cameras can be mounted; ``home`` [rad or m] contains joint
    positions by name.
    """

    reach: float
    opening: float
    payload: float | None
    links: tuple[str, ...]
    home: Mapping[str, float]


class RobotFiles(Model):
    """A robot of your own: its model in one or more formats; each target takes its native one.

    Rollouts need its hand and gripper (if it has one), which only a robot ``file`` defines.
    """

    file: FileName | None = Field(None, description="A robot file: its models, with hand, arm joints and gripper.")
    mjcf: FileName | None = Field(
        None, description="MJCF: a path, `pkg:package/path`, `menagerie:robot/path` or `robot_descriptions:name`."
    )
    urdf: FileName | None = Field(None, description="URDF, named in the same ways.")
    usd: FileName | None = Field(None, description="USD, named in the same ways.")

    @model_validator(mode="after")
    def _any(self) -> Self:
        bare = [key for key in ("mjcf", "urdf", "usd") if getattr(self, key) is not None]
        if self.file is not None and bare:
            raise fault("sf107", f"`file` names all models: remove `{bare[0]}`, or `file`")
        if self.file is None and not bare:
            raise fault("sf107", "one of `file`, `mjcf`, `urdf`, `usd` is needed")
        return self


class RobotSpec(Model):
    """A robot; its base is welded to the world."""

    model: Annotated[
        Annotated[Name, Tag("name")] | Annotated[RobotFiles, Tag("files")],
        Discriminator(lambda v: "files" if isinstance(v, dict | RobotFiles) else "name"),
    ] = Field(description="A known robot, such as `franka_robotiq`, or the files of another one.")
    pose: PoseSpec = Field(PoseSpec.model_construct(), description="Pose of its base in the world.")
    joints: Annotated[
        Annotated[Literal["home"], Tag("home")] | Annotated[dict[JointName, Number], Tag("positions")],
        Discriminator(lambda v: "positions" if isinstance(v, dict) else "home"),
    ] = Field("home", description="`home`, or joint positions by name [rad or m]; those not named are at home.")
    reach: Positive | None = Field(
        None, description="Horizontal reach from its base [m]; defaults to the known robot's reach."
    )
    opening: Positive | None = Field(
        None, description="Widest opening between its fingers [m]; default: that of the known robot."
    )

    def known(self) -> KnownRobot | None:
        """Return the known robot with this name; None if it is unknown or its file is faulty, which `check` reports."""
        from simfoundry.spec.models.robot_file import find_robot

        try:
            return find_robot(self.model) if isinstance(self.model, str) else None
        except SimfoundryError:
            return None
