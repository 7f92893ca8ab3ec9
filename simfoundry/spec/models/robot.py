"""Robots in a scene: model, pose and joint positions."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Discriminator, Field, StringConstraints, Tag

from simfoundry.errors import SimfoundryError
from simfoundry.spec.models.base import JOINT_NAME, FileName, Model, Name, Number, Positive, consistent, fault
from simfoundry.spec.models.reuse import FramedPose

# Name of a joint in the robot's model.
JointName = Annotated[str, StringConstraints(pattern=JOINT_NAME, max_length=128)]


@dataclass(frozen=True)
class KnownRobot:
    """Robot properties that are available without loading the robot model, read from ``simfoundry/robots``.

    Attributes:
        reach: Maximum horizontal distance between a grasp and the base [m].
        opening: Width of the widest object that fits between the fingers [m].
        payload: Mass of the heaviest object that the robot should lift [kg], or None if unknown.
        links: Links on which cameras can be mounted.
        home: Home joint positions by joint name [rad or m].
    """

    reach: float
    opening: float
    payload: float | None
    links: tuple[str, ...]
    home: Mapping[str, float]


class RobotFiles(Model):
    """A custom robot, with its model in one or more formats. Each target prefers its native format.

    Rollouts require the definitions of the hand and the gripper (if any), which only a robot ``file`` can contain.
    """

    file: FileName | None = Field(
        None, description="A robot file, which defines the models, the hand, the arm joints and the gripper."
    )
    mjcf: FileName | None = Field(
        None, description="MJCF: a path, `pkg:package/path`, `menagerie:robot/path` or `robot_descriptions:name`."
    )
    urdf: FileName | None = Field(None, description="URDF, in the same notation.")
    usd: FileName | None = Field(None, description="USD, in the same notation.")

    @consistent
    def _any(self) -> None:
        bare = [key for key in ("mjcf", "urdf", "usd") if getattr(self, key) is not None]
        if self.file is not None and bare:
            raise fault("sf107", f"`file` already defines all models; remove either `{bare[0]}` or `file`")
        if self.file is None and not bare:
            raise fault("sf107", "one of `file`, `mjcf`, `urdf`, `usd` is needed")


# Smallest and greatest factor of a gain. Servos that are a hundred times as stiff need a shorter time step.
GainFactor = Annotated[float, Field(ge=0.01, le=100, allow_inf_nan=False)]


class GainsSpec(Model):
    """The gains of an arm's servos, as factors of those in the robot's model."""

    stiffness: GainFactor = Field(1.0, description="Factor of the servos' stiffness.")
    damping: GainFactor = Field(1.0, description="Factor of the servos' damping, including that of the joints.")


class RobotSpec(Model):
    """A robot whose base is welded to the world."""

    model: Annotated[
        Annotated[Name, Tag("name")] | Annotated[RobotFiles, Tag("files")],
        Discriminator(lambda v: "files" if isinstance(v, dict | RobotFiles) else "name"),
    ] = Field(description="The name of a known robot, such as `franka_robotiq`, or the files of a custom robot.")
    pose: FramedPose = Field(
        FramedPose.model_construct(), description="Pose of the robot's base in the world, or in `frame`."
    )
    joints: Annotated[
        Annotated[Literal["home"], Tag("home")] | Annotated[dict[JointName, Number], Tag("positions")],
        Discriminator(lambda v: "positions" if isinstance(v, dict) else "home"),
    ] = Field("home", description="`home`, or joint positions by name [rad or m]; joints not listed are at home.")
    gains: GainsSpec = Field(
        GainsSpec.model_construct(), description="Factors of the gains of the arm's servos, but not of the gripper's."
    )
    reach: Positive | None = Field(
        None, description="Horizontal reach from the base [m]; default: the known robot's reach."
    )
    opening: Positive | None = Field(
        None, description="Maximum opening between the fingers [m]; default: the known robot's opening."
    )

    def known(self) -> KnownRobot | None:
        """Return the known robot with this name.

        Returns None if the robot is unknown or its file is invalid. `check` reports invalid files.
        """
        from simfoundry.spec.models.robot_file import find_robot

        try:
            return find_robot(self.model) if isinstance(self.model, str) else None
        except SimfoundryError:
            return None
