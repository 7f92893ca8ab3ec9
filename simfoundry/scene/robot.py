"""Robots of the lowered scene: available native models, and the mapping of scene names to model names."""

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
    """A frame that a scene can refer to: ``X_LF`` in a ``link`` of the model."""

    link: str
    X_LF: Pose = IDENTITY


@dataclass(frozen=True)
class Follow:
    """A mimic joint: its position is ``multiplier`` times that of ``joint`` plus ``offset`` [rad or m]."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, eq=False)
class Gripper:
    """Joints of a gripper; every pair is (open, closed).

    ``command`` are values of the model's actuators, empty if the joints are driven directly; ``joints`` are positions
    [rad or m], the first of which indicates how far the gripper is closed; ``follow`` replaces closed loops and
    equality constraints of the model in engines without them.
    """

    command: Mapping[str, tuple[float, float]]
    joints: Mapping[str, tuple[float, float]]
    follow: Mapping[str, Follow]

    def closed(self, position: float) -> float:
        """Closed fraction, 0 to 1, for its first joint at ``position`` [rad or m]."""
        opened, closed = next(iter(self.joints.values()))
        return min(max((position - opened) / (closed - opened), 0.0), 1.0)


@dataclass(frozen=True, eq=False)
class Attached:
    """A model mounted on a link of another: its names are prefixed with ``name.``; ``X_LB`` poses its base there."""

    name: str
    file: Path
    to: str
    X_LB: Pose


@dataclass(frozen=True, eq=False)
class NativeModel:
    """Robot model in one format.

    ``digest`` identifies the content of all its files, which remain where they were found on this machine. ``joints``
    maps the scene's names of the arm's joints to the model's; other names are the model's own. ``effort`` is the
    maximum force [N m or N] of joints for which the file does not state the robot's.
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
        """Return the frame that a scene calls ``name``: a known one, or a link of the model."""
        return self.links.get(name) or LinkFrame(name)


FILES_ONLY = "robot"
"""Kind of a robot that a document defines by its files alone."""


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot whose base is welded to the world at ``X_WB``.

    ``positions`` [rad or m] are those of its arm, by the scene's joint names; its gripper is open. ``reach`` [m] along
    the ground and ``opening`` [m] are None if unknown. ``models`` has at least one entry.
    """

    name: str
    kind: str
    X_WB: Pose
    positions: Mapping[str, float]
    reach: float | None
    opening: float | None
    models: Mapping[ModelFormat, NativeModel]

    def best(self, *formats: ModelFormat) -> NativeModel | None:
        """Return the model in the first available format."""
        return next((self.models[f] for f in formats if f in self.models), None)

    def start(self, model: NativeModel) -> dict[str, float]:
        """Initial positions of the model's joints: the arm's from the scene, the gripper's open."""
        arm = {model.joints.get(name, name): position for name, position in self.positions.items()}
        opened = {n: pair[0] for n, pair in model.gripper.joints.items()} if model.gripper is not None else {}
        return opened | arm


def mujoco_model(robot: Robot) -> NativeModel | None:
    """Return the robot model that MuJoCo reads best, if there is one."""
    return robot.best(ModelFormat.MJCF, ModelFormat.URDF)
