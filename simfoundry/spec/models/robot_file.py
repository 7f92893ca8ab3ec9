"""Robot files, which describe one robot each, and the look-up of robots by name.

Robots that scenes can name have files in ``simfoundry/robots``, in a user folder, or in installed packages.
"""

from __future__ import annotations

import json
import os
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Self

import yaml
from pydantic import Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from simfoundry.errors import SimfoundryError
from simfoundry.runtime.plugins import plugins
from simfoundry.spec.models.base import Model, Name, Number, PoseSpec, Positive
from simfoundry.spec.models.robot import JointName, KnownRobot

Reference = str
"""File of a model: a path, `pkg:package/path`, `menagerie:robot`, or `robot_descriptions:name`; the last two may be
followed by `/path`."""

Travel = tuple[Number, Number]
"""Values with the gripper open and with it closed."""


class FrameSpec(Model):
    """A named frame of the robot, at a pose in a link of the model."""

    link: str = Field(description="The link, by the model's name.")
    pose: PoseSpec = Field(PoseSpec.model_construct(), description="Pose of the frame in the link.")


class FollowSpec(Model):
    """A joint that follows another: its position is ``multiplier`` times that one's plus ``offset``."""

    joint: JointName
    multiplier: Number = 1.0
    offset: Number = 0.0


class GripperSpec(Model):
    """Command and travel of a gripper."""

    command: dict[str, Travel] = Field({}, description="Values of the model's actuators; default: of the joints.")
    joints: dict[JointName, Travel] = Field(description="Joint positions [rad or m]; the first measures the opening.")
    follow: dict[JointName, FollowSpec] = Field(
        {}, description="Joints that the model moves by closed loops or equations, for targets without those."
    )


class AttachSpec(Model):
    """A model that is attached to a link of another."""

    file: Reference | list[Reference]
    to: str = Field(description="The link to attach it to.")
    pose: PoseSpec = Field(PoseSpec.model_construct(), description="Pose of its base in that link.")


class ModelSpec(Model):
    """A robot in one format. Names of an attached model are prefixed with its own: `gripper.base`."""

    file: Reference | list[Reference] = Field(
        description="The file, or several, of which the first that exists is used."
    )
    attach: dict[Name, AttachSpec] = Field({}, description="Models attached to its links, such as a gripper, by name.")
    links: dict[Name, FrameSpec] = Field({}, description="The frames that scenes may name, such as `hand`.")
    joints: list[JointName] = Field([], description="The arm's joints, in the order of `joint1`, `joint2` and so on.")
    gripper: GripperSpec | None = None
    effort: dict[JointName, Positive] = Field(
        {}, description="Maximum force of a joint [N m or N], if the file's differs from the robot's."
    )

    @model_validator(mode="after")
    def _arm(self) -> Self:
        if self.gripper is not None and not self.joints:
            raise PydanticCustomError("arm", "`joints` must list the arm's joints where there is a gripper", {})
        return self

    @property
    def files(self) -> list[Reference]:
        """Return the files to look for, best first."""
        return [self.file] if isinstance(self.file, str) else self.file


class RobotFileSpec(Model):
    """A robot: its model in each available format, and facts that no model states."""

    reach: Positive | None = Field(None, description="Horizontal reach from its base [m].")
    opening: Positive | None = Field(None, description="Widest opening between its fingers [m].")
    payload: Positive | None = Field(None, description="The heaviest object that it should lift [kg].")
    home: list[Number] | None = Field(None, description="Home position of the arm: `joint1` and so on [rad or m].")
    mjcf: ModelSpec | None = None
    urdf: ModelSpec | None = None
    usd: Annotated[ModelSpec | None, Field(description="A USD whose default prim is the robot.")] = None

    @property
    def models(self) -> dict[str, ModelSpec]:
        """Return the models by format."""
        found = {"mjcf": self.mjcf, "urdf": self.urdf, "usd": self.usd}
        return {key: model for key, model in found.items() if model is not None}

    @property
    def home_positions(self) -> dict[str, float]:
        """Return the home position [rad or m] of the arm by the joint names that scenes use."""
        return {f"joint{k}": position for k, position in enumerate(self.home or (), 1)}


def read_robot_file(file: Path) -> RobotFileSpec:
    """Read a robot file; raises :class:`SimfoundryError` for a faulty one."""
    try:
        data = yaml.load(file.read_text(encoding="utf-8"), Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        models = RobotFileSpec.model_validate_json(json.dumps(data))
    except (OSError, yaml.YAMLError, TypeError, ValueError) as error:
        if isinstance(error, ValidationError):
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"]) or "the file"
            raise SimfoundryError(f"{file}: {where}: {first['msg']}; see docs/robots.md for the format") from None
        reason = str(error).splitlines()[0]
        if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
            reason = f"line {error.problem_mark.line + 1}: {error.problem}"
        raise SimfoundryError(f"{file} is not a robot file: {reason}") from None
    if not models.models:
        raise SimfoundryError(f"{file} names no model; give `mjcf`, `urdf` or `usd`; see docs/robots.md for the format")
    return models


GROUP = "simfoundry.robots"

OWN_ROBOTS = "SIMFOUNDRY_ROBOTS"
"""Environment variable with the path of a user folder of robot files such as `my_arm.yaml`."""

BUILT_IN = Path(__file__).parents[2] / "robots"
"""Folder of the built-in robots."""


def own_folder(must_exist: bool = False) -> Path | None:
    """Return the user folder of robot files if it is set and exists.

    With ``must_exist``, raise :class:`SimfoundryError` if it is set but missing.
    """
    named = os.environ.get(OWN_ROBOTS)
    folder = Path(named).expanduser().resolve() if named else None
    if folder is None or folder.is_dir():
        return folder
    if must_exist:
        raise SimfoundryError(f"{OWN_ROBOTS} names the folder {folder}, which does not exist")
    return None


def robot_names() -> list[str]:
    """Return the robots that a scene can name: built-in, in the user folder, and in installed packages."""
    folders = [BUILT_IN, *filter(None, [own_folder()])]
    return list(dict.fromkeys([*(p.stem for f in folders for p in sorted(f.glob("*.yaml"))), *plugins(GROUP)]))


def known_robot_file(name: str) -> tuple[RobotFileSpec, Path] | None:
    """Return the file of the robot called ``name``, and the document that its paths are relative to.

    A file in the user folder overrides a built-in robot. None if the robot is unknown; raises :class:`SimfoundryError`
    for a faulty file.
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
    """Return the robot that scenes call ``name``; None if there is none.

    Raises :class:`SimfoundryError` if its file lacks fields that scenes require.
    """
    found = known_robot_file(name)
    if found is None:
        return None
    spec, path = found
    if spec.reach is None or spec.opening is None or spec.home is None:
        raise SimfoundryError(f"{path} needs `reach`, `opening` and `home`, so that scenes can name the robot")
    links = dict.fromkeys(frame for model in spec.models.values() for frame in model.links)
    return KnownRobot(spec.reach, spec.opening, spec.payload, tuple(links), MappingProxyType(spec.home_positions))


def _read(path: Path) -> RobotFileSpec:
    """Read a robot file, cached for all scenes that name it."""
    return _read_once(path, path.stat().st_mtime_ns if path.is_file() else 0)


@lru_cache(maxsize=64)
def _read_once(path: Path, changed: int) -> RobotFileSpec:  # noqa: ARG001 - a key of the cache only
    return read_robot_file(path)
