"""Robots in a scene: which model, where, and in which posture."""

from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Literal, Self

from pydantic import Discriminator, Field, StringConstraints, Tag, model_validator
from pydantic_core import PydanticCustomError

from simfoundry.spec.models.base import JOINT_NAME, FileName, Model, Name, Number, PoseSpec, Positive

JointName = Annotated[str, StringConstraints(pattern=JOINT_NAME, max_length=128)]
"""A joint as the robot's own model calls it."""


@dataclass(frozen=True)
class KnownRobot:
    """What a scene may rely on about a robot without opening its model.

    ``reach`` [m]: the farthest a grasp can be from the base, measured along the ground; ``opening`` [m]: the widest
    thing that fits between the fingers; ``links``: where cameras can be mounted; ``home`` [rad or m]: joint positions.
    """

    reach: float
    opening: float
    links: tuple[str, ...]
    home: MappingProxyType[str, float]


def _home(*positions: float, **more: float) -> MappingProxyType[str, float]:
    return MappingProxyType({**{f"joint{k}": v for k, v in enumerate(positions, 1)}, **more})


ROBOTS = MappingProxyType(
    {
        # Ours, of simple solids. Reach is measured (tests/robots/test_demo_arm.py): the pads with the gripper down, a
        # centimetre above the ground that it stands on; home has the gripper over a table, 0.38 m in front.
        "demo_arm": KnownRobot(0.82, 0.09, ("base", "hand"), _home(0.0, 0.0, 0.0, 2.0, 0.0, 1.141593, 0.0)),
        # Datasheets of the Panda (0.855 m) and of the 2F-85 (85 mm); home is the posture in which DROID starts.
        "franka_robotiq": KnownRobot(
            0.855, 0.085, ("base", "hand"), _home(0.0, -0.628319, 0.0, -2.513274, 0.0, 1.884956, 0.0)
        ),
        "franka_panda": KnownRobot(
            0.855, 0.08, ("base", "hand"), _home(0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398)
        ),
        # Measured on the maker's model: the grasp point comes 0.80 m from the base, 0.70 m with the gripper down.
        "yam": KnownRobot(0.70, 0.076, ("base", "hand"), _home(0.0, 1.047, 1.047, 0.0, 0.0, 0.0)),
    }
)
"""The robots that a scene can name, by name."""


class RobotFiles(Model):
    """A robot of your own: its model in each format that there is one for; targets take their native one.

    Rollouts ask for its hand and, where it has one, its gripper, which no model names: those stand in a robot ``file``.
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
            raise PydanticCustomError("sf107", f"`file` names all models: remove `{bare[0]}`, or `file`", {})
        if self.file is None and not bare:
            raise PydanticCustomError("sf107", "one of `file`, `mjcf`, `urdf`, `usd` is needed", {})
        return self


class RobotSpec(Model):
    """A robot; its base is welded to the world."""

    model: Annotated[
        Annotated[Name, Tag("name")] | Annotated[RobotFiles, Tag("files")],
        Discriminator(lambda v: "files" if isinstance(v, dict | RobotFiles) else "name"),
    ] = Field(description="A known robot, as `franka_robotiq`, or the files of another.")
    pose: PoseSpec = Field(PoseSpec(), description="Pose of its base in the world.")
    joints: Annotated[
        Annotated[Literal["home"], Tag("home")] | Annotated[dict[JointName, Number], Tag("positions")],
        Discriminator(lambda v: "positions" if isinstance(v, dict) else "home"),
    ] = Field("home", description="`home`, or joint positions by name [rad or m]; those not named are at home.")
    reach: Positive | None = Field(
        None, description="How far from its base it can grasp, along the ground [m]; default: what is known of it."
    )
    opening: Positive | None = Field(
        None, description="The widest thing that fits between its fingers [m]; default: what is known of it."
    )

    def known(self) -> KnownRobot | None:
        """The known robot that it is, if any."""
        return ROBOTS.get(self.model) if isinstance(self.model, str) else None
