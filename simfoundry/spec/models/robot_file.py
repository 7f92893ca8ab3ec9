"""Read robot files, each of which describes one robot, and look up robots by name.

The robots that scenes can refer to are described by files in ``simfoundry/robots``, a user folder, or an installed
package.
"""

from __future__ import annotations

import json
import os
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Annotated

import yaml
from pydantic import Field, ValidationError
from pydantic_core import PydanticCustomError

from simfoundry.errors import SimfoundryError
from simfoundry.runtime.plugins import plugins
from simfoundry.spec.models.base import Model, Name, Number, PoseSpec, Positive, consistent
from simfoundry.spec.models.robot import JointName, KnownRobot

# Location of a model file: a path, `pkg:package/path`, `menagerie:robot`, or `robot_descriptions:name`; `/path` may be
# appended to the last two forms.
Reference = str

# Values for the open and the closed gripper.
Travel = tuple[Number, Number]


class FrameSpec(Model):
    """A named frame of the robot, attached to a link of the model."""

    link: str = Field(description="Name of the link in the model.")
    pose: PoseSpec = Field(PoseSpec.model_construct(), description="Pose of the frame in the link's frame.")


class FollowSpec(Model):
    """The coupling of a joint to a leader ``joint``.

    The position is ``multiplier`` times the leader's position plus ``offset``.
    """

    joint: JointName
    multiplier: Number = 1.0
    offset: Number = 0.0


class GripperSpec(Model):
    """The commands and joint travel of a gripper."""

    command: dict[str, Travel] = Field({}, description="Actuator commands; default: the joint positions.")
    joints: dict[JointName, Travel] = Field(
        description="Joint positions [rad or m]; the first joint is used to measure the opening."
    )
    follow: dict[JointName, FollowSpec] = Field(
        {},
        description="Joints that the model moves through closed loops or equations, for targets that support neither.",
    )


class AttachSpec(Model):
    """A model attached to a link of another model."""

    file: Reference | list[Reference]
    to: str = Field(description="The link to which the model is attached.")
    pose: PoseSpec = Field(
        PoseSpec.model_construct(), description="Pose of the attached model's base in the link's frame."
    )


class ModelSpec(Model):
    """A robot model in one format. Names in an attached model are prefixed with its name, as in `gripper.base`."""

    file: Reference | list[Reference] = Field(
        description="The model file, or a list of files from which the first existing one is used."
    )
    attach: dict[Name, AttachSpec] = Field(
        {}, description="Models attached to links of this model, such as a gripper, by name."
    )
    links: dict[Name, FrameSpec] = Field({}, description="Frames that scenes can refer to, such as `hand`, by name.")
    joints: list[JointName] = Field([], description="Names of the arm joints, in the order `joint1`, `joint2`, ...")
    gripper: GripperSpec | None = None
    effort: dict[JointName, Positive] = Field(
        {}, description="Maximum force of a joint [N m or N], if the value in the file differs from the real robot."
    )

    @consistent
    def _arm(self) -> None:
        if self.gripper is not None and not self.joints:
            raise PydanticCustomError("arm", "`joints` must list the arm joints if the model has a gripper", {})

    @property
    def files(self) -> list[Reference]:
        """Return the candidate files in order of preference."""
        return [self.file] if isinstance(self.file, str) else self.file


class RobotFileSpec(Model):
    """A robot: its model in each available format, and properties that model files do not contain."""

    reach: Positive | None = Field(None, description="Horizontal reach from the base [m].")
    opening: Positive | None = Field(None, description="Maximum opening between the fingers [m].")
    payload: Positive | None = Field(None, description="Mass of the heaviest object that the robot should lift [kg].")
    home: list[Number] | None = Field(
        None, description="Home positions of the arm joints, starting with `joint1` [rad or m]."
    )
    mjcf: ModelSpec | None = None
    urdf: ModelSpec | None = None
    usd: Annotated[ModelSpec | None, Field(description="A USD file whose default prim is the robot.")] = None

    @property
    def models(self) -> dict[str, ModelSpec]:
        """Return the models by format."""
        found = {"mjcf": self.mjcf, "urdf": self.urdf, "usd": self.usd}
        return {key: model for key, model in found.items() if model is not None}

    @property
    def home_positions(self) -> dict[str, float]:
        """Return the home positions [rad or m] of the arm, keyed by the joint names that scenes use."""
        return {f"joint{k}": position for k, position in enumerate(self.home or (), 1)}


def read_robot_file(file: Path) -> RobotFileSpec:
    """Read a robot file.

    Raises:
        SimfoundryError: If the file cannot be read or is invalid.
    """
    try:
        data = yaml.load(file.read_text(encoding="utf-8"), Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        models = RobotFileSpec.model_validate_json(json.dumps(data))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "the file"
        raise SimfoundryError(f"{file}: {where}: {first['msg']}; see docs/robots.md for the format") from None
    except (OSError, yaml.YAMLError, TypeError, ValueError) as error:
        reason = str(error).splitlines()[0]
        if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
            reason = f"line {error.problem_mark.line + 1}: {error.problem}"
        raise SimfoundryError(f"{file} is not a valid robot file: {reason}") from None
    if not models.models:
        hint = "add `mjcf`, `urdf` or `usd`; see docs/robots.md for the format"
        raise SimfoundryError(f"{file} does not define a model; {hint}")
    return models


GROUP = "simfoundry.robots"

# Environment variable with the path of a user folder that contains robot files such as `my_arm.yaml`.
OWN_ROBOTS = "SIMFOUNDRY_ROBOTS"

# Folder of the built-in robots.
BUILT_IN = Path(__file__).parents[2] / "robots"


def own_folder(must_exist: bool = False) -> Path | None:
    """Return the user's robot folder, or None if it is not set or does not exist.

    Raises:
        SimfoundryError: If ``must_exist`` is True and the configured folder does not exist.
    """
    named = os.environ.get(OWN_ROBOTS)
    folder = Path(named).expanduser().resolve() if named else None
    if folder is None or folder.is_dir():
        return folder
    if must_exist:
        raise SimfoundryError(f"{OWN_ROBOTS} is set to {folder}, but this folder does not exist")
    return None


def robot_names() -> list[str]:
    """Return the names of all available robots: built-in, in the user folder, and in installed packages."""
    folders = [BUILT_IN, *filter(None, [own_folder()])]
    return list(dict.fromkeys([*(p.stem for f in folders for p in sorted(f.glob("*.yaml"))), *plugins(GROUP)]))


def known_robot_file(name: str) -> tuple[RobotFileSpec, Path] | None:
    """Look up a robot file by robot name. A file in the user folder overrides fields of a built-in robot.

    Returns:
        The robot file and the path of the file that its paths are relative to, or None if the robot is unknown.

    Raises:
        SimfoundryError: If the file is invalid.
    """
    folder = own_folder()
    own = folder / f"{name}.yaml" if folder is not None else None
    own = own if own is not None and own.is_file() else None
    built_in = BUILT_IN / f"{name}.yaml"
    if built_in.is_file():
        spec = _read(built_in)
        changed = _read(own) if own is not None else RobotFileSpec()
        return spec.model_copy(update={k: getattr(changed, k) for k in changed.model_fields_set}), own or built_in
    plugin = plugins(GROUP).get(name) if own is None else None
    file = plugin.folder() / f"{name}.yaml" if plugin is not None else own
    return None if file is None else (_read(file), file)


def find_robot(name: str) -> KnownRobot | None:
    """Return the robot with this name, or None if the robot is unknown.

    Raises:
        SimfoundryError: If the robot file is invalid or lacks fields that scenes require.
    """
    found = known_robot_file(name)
    if found is None:
        return None
    spec, path = found
    if spec.reach is None or spec.opening is None or spec.home is None:
        raise SimfoundryError(f"{path} must define `reach`, `opening` and `home` before scenes can use the robot")
    links = dict.fromkeys(frame for model in spec.models.values() for frame in model.links)
    return KnownRobot(spec.reach, spec.opening, spec.payload, tuple(links), MappingProxyType(spec.home_positions))


def _read(path: Path) -> RobotFileSpec:
    """Read a robot file, using a cache that is invalidated when the file changes."""
    return _read_once(path, path.stat().st_mtime_ns if path.is_file() else 0)


@lru_cache(maxsize=64)
def _read_once(path: Path, changed: int) -> RobotFileSpec:  # noqa: ARG001 - used only as a cache key
    return read_robot_file(path)
