"""A robot in a world: its joints, its gripper and its frames, the same in every simulator."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from simfoundry.geometry.frames import Pose


class WorldRobot(Protocol):
    """A robot of a world. Targets hold until they are changed; the world's ``step`` is what moves it."""

    @property
    def joints(self) -> tuple[str, ...]:
        """The arm's joints by the scene's names, in order."""
        ...

    def positions(self) -> dict[str, float]:
        """Return the positions of the arm's joints [rad or m]."""
        ...

    def limits(self) -> dict[str, tuple[float, float]]:
        """Between what the arm's joints can move [rad or m]; infinite where nothing limits them."""
        ...

    def set_targets(self, targets: Mapping[str, float]) -> None:
        """Set where joints of the arm are to go [rad or m], within their limits; the others keep their targets.

        A KeyError names a joint that the robot lacks.
        """
        ...

    def gripper(self) -> float:
        """Return how far the gripper is closed, from 0, open, to 1. A robot without one is always at 0."""
        ...

    def set_gripper(self, closed: float) -> None:
        """Set how far the gripper is to close: 0 open, 1 closed; values beyond are cut off."""
        ...

    def frame(self, name: str) -> Pose:
        """Pose in the world of one of its frames, ``hand`` or ``base``, or of a link by the model's name."""
        ...


def unknown_joint(robot: str, joint: str, known: tuple[str, ...]) -> KeyError:
    """The error for a joint that a robot lacks."""
    return KeyError(f"robot {robot!r} has no joint {joint!r}; there are: {', '.join(known)}")
