"""Robots of the lowered scene: which native models there are, and how a scene's words map onto their names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from simfoundry.geometry.frames import IDENTITY, Pose


class ModelFormat(StrEnum):
    """A format of robot models."""

    MJCF = "mjcf"
    URDF = "urdf"
    USD = "usd"


@dataclass(frozen=True, eq=False)
class LinkFrame:
    """A frame that a scene can name: ``X_LF`` in a ``link`` of the model."""

    link: str
    X_LF: Pose = IDENTITY


@dataclass(frozen=True)
class Follow:
    """A joint's position is ``multiplier`` times that of ``joint`` plus ``offset`` [rad or m]."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, eq=False)
class Gripper:
    """The joints of a gripper; every pair is (open, closed).

    ``command`` are values of the model's actuators, empty where the joints are driven themselves; ``joints`` positions
    [rad or m], of which the first tells how far it is closed; ``follow`` says what closed loops and equations of the
    model do, for engines that have none.
    """

    command: Mapping[str, tuple[float, float]]
    joints: Mapping[str, tuple[float, float]]
    follow: Mapping[str, Follow]

    def closed(self, position: float) -> float:
        """The share by which it is closed, 0 to 1, if its first joint is at ``position`` [rad or m]."""
        opened, closed = next(iter(self.joints.values()))
        return min(max((position - opened) / (closed - opened), 0.0), 1.0)


@dataclass(frozen=True, eq=False)
class Attached:
    """A model that a link of another carries: its names get ``name.`` before them; ``X_LB`` poses its base there."""

    name: str
    file: Path
    to: str
    X_LB: Pose


@dataclass(frozen=True, eq=False)
class NativeModel:
    """A robot's model in one format.

    ``digest`` names the content of all its files, which lie where they were found on this machine. ``joints`` maps the
    scene's names of the arm's joints onto the model's; a name that is not there is the model's own. ``effort`` is the
    greatest force [N m or N] of joints for which the file does not tell the robot's.
    """

    format: ModelFormat
    file: Path
    digest: str
    attached: tuple[Attached, ...]
    links: Mapping[str, LinkFrame]
    joints: Mapping[str, str]
    gripper: Gripper | None
    effort: Mapping[str, float]

    def frame(self, name: str) -> LinkFrame:
        """The frame that a scene calls ``name``: a known one, or a link of the model."""
        return self.links.get(name) or LinkFrame(name)


FILES_ONLY = "robot"
"""The kind of a robot that a document knows by its files alone."""


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot whose base is welded to the world at ``X_WB``.

    ``positions`` [rad or m] of its arm by the scene's names of the joints; its gripper is open. ``reach`` [m] along the
    ground and ``opening`` [m] are None where nothing is known. ``models`` has one at least.
    """

    name: str
    kind: str
    X_WB: Pose
    positions: Mapping[str, float]
    reach: float | None
    opening: float | None
    models: Mapping[ModelFormat, NativeModel]

    def best(self, *formats: ModelFormat) -> NativeModel | None:
        """The model in the first of the formats that there is one in."""
        return next((self.models[f] for f in formats if f in self.models), None)

    def start(self, model: NativeModel) -> dict[str, float]:
        """Positions of the model's joints at the start: the arm's as the scene has them, the gripper's open."""
        arm = {model.joints.get(name, name): position for name, position in self.positions.items()}
        opened = {n: pair[0] for n, pair in model.gripper.joints.items()} if model.gripper is not None else {}
        return opened | arm


def mujoco_model(robot: Robot) -> NativeModel | None:
    """The model of a robot that MuJoCo reads best, if there is one."""
    return robot.best(ModelFormat.MJCF, ModelFormat.URDF)
