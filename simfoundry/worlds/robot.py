"""The protocol of a robot in a world: its joints, gripper and frames, the same in every simulator."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from simfoundry.geometry.frames import Pose


class WorldRobot(Protocol):
    """A robot in a world. Targets hold until they change; the world's ``step`` advances the motion."""

    @property
    def joints(self) -> tuple[str, ...]:
        """The names of the arm's joints in the scene, in order."""
        ...

    def positions(self) -> dict[str, float]:
        """Return the positions of the arm's joints [rad or m]."""
        ...

    def limits(self) -> dict[str, tuple[float, float]]:
        """Return the position limits of the arm's joints [rad or m]; infinite if there are none."""
        ...

    def set_targets(self, targets: Mapping[str, float]) -> None:
        """Set target positions of arm joints [rad or m], within their limits; other joints keep their targets.

        Raises a KeyError for a joint that the robot does not have.
        """
        ...

    def gripper(self) -> float:
        """Return the closed share of the gripper, from 0 (open) to 1 (closed); always 0 without a gripper."""
        ...

    def set_gripper(self, closed: float) -> None:
        """Set the target of the gripper: 0 is open, 1 is closed; other values are clipped."""
        ...

    def frame(self, name: str) -> Pose:
        """Return the pose in the world of a frame, ``hand`` or ``base``, or of a link by the model's name."""
        ...


def unknown_joint(robot: str, joint: str, known: tuple[str, ...]) -> KeyError:
    """Return the error for a joint that a robot does not have."""
    return KeyError(f"robot {robot!r} has no joint {joint!r}; there are: {', '.join(known)}")
