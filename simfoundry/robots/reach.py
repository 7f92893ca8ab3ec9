"""Robot reach, estimated by horizontal distance from published data or computed by inverse kinematics.

Both methods consider only the arm. They ignore obstacles, and do not check whether the fingers fit the object.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from simfoundry.geometry.frames import Array, Pose
from simfoundry.robots.arm import Arm, jaws
from simfoundry.runtime.extras import EXTRAS, install_line
from simfoundry.scene.frames import FrameTree
from simfoundry.scene.model import Scene
from simfoundry.scene.state import pose
from simfoundry.spec.models.robot import RobotSpec

# Distance over which the hand approaches its grasp [m].
OVER = 0.10

# Number of hand rotations about z to try.
YAWS = 6

# Depth of the fingertips below the surface of the object that faces the hand [m]; at most the depth of the object's
# center.
DEEP = 0.03

UP = (0.0, 0.0, 1.0)


# Payload assumed for robots without published data [kg]; light desktop arms lift 0.5 to 1.5 kg.
PAYLOAD = 1.0

# Distance beyond the published reach up to which inverse kinematics is still tried [m], because grasps are on the near
# side of an object.
BEYOND = 0.1


class Hand(NamedTuple):
    """A robot that acts in a task, with the data needed for reach checks.

    Attributes:
        name: The name of the robot in the scene.
        at: The position of its base in the horizontal plane [m].
        reach: Its reach [m], or None if unknown.
        opening: The maximum opening of its gripper [m], or None if unknown.
        payload: Its payload [kg].
        kind: The name of the robot model if it is a known robot, or otherwise an empty string.
    """

    name: str
    at: tuple[float, float]
    reach: float | None
    opening: float | None
    payload: float
    kind: str = ""


class Miss(NamedTuple):
    """The hand that comes closest to reaching a place, and the horizontal distance from its base to the place [m]."""

    hand: Hand
    distance: float
    reach: float

    @property
    def lacking(self) -> float:
        """The distance by which the place is out of reach [m]."""
        return self.distance - self.reach


def hands_of(robots: Mapping[str, RobotSpec], frames: FrameTree, payload: float | None = None) -> tuple[Hand, ...]:
    """Return the hands of a document's robots, whether or not their models are installed.

    ``frames`` are the frames to which the poses of the robots may refer. ``payload`` [kg] overrides the payloads of the
    robots.
    """
    found = []
    for name, robot in robots.items():
        known, kind = robot.known(), robot.model if isinstance(robot.model, str) else ""
        reach, opening, lifts = (known.reach, known.opening, known.payload) if known is not None else (None, None, None)
        x, y, _ = (frames.pose(robot.pose.frame) @ pose(robot.pose)).p.tolist()
        own = (robot.reach or reach, robot.opening or opening, payload or lifts or PAYLOAD)
        found.append(Hand(name, (x, y), *own, kind))
    return tuple(found)


def nearest_miss(hands: Sequence[Hand], distances: Iterable[float]) -> Miss | None:
    """Return the hand that comes closest to reaching a place.

    Returns None if a hand can reach the place or if the reach of any hand is unknown.

    Args:
        hands: The hands.
        distances: The horizontal distance of the place from the base of each hand [m].
    """
    misses = [Miss(h, d, h.reach) for h, d in zip(hands, distances, strict=True) if h.reach is not None]
    nearest = min(misses, key=lambda miss: miss.lacking, default=None)
    return nearest if nearest is not None and len(misses) == len(hands) and nearest.lacking > 0 else None


@dataclass(frozen=True)
class Reached:
    """The result of a reach test.

    Attributes:
        reached: True if a robot can reach the place.
        checked: False if no arm has a model or the solver is not installed.
        robot: The robot that can reach the place, or otherwise the nearest robot.
        away: The horizontal distance of the place from the base of that robot [m].
        why: The reason why the reach was not checked.
    """

    reached: bool
    checked: bool
    robot: str = ""
    away: float = 0.0
    why: str = ""


class ArmReach:
    """A test that determines which grasps the arms in a scene can reach."""

    def __init__(self, scene: Scene, robots: tuple[str, ...]) -> None:
        self._names, self._robots = robots, [robot for robot in scene.robots if robot.name in robots]
        self._known: dict[tuple[float, ...], Reached] = {}

    @cached_property
    def _arms(self) -> list[tuple[Arm, float]]:
        """The arms, each with the distance [m] from the hand frame to the grasp point between the fingers."""
        found = []
        for robot in sorted(self._robots, key=lambda robot: self._names.index(robot.name)):
            fingers = jaws(robot)
            found.append((Arm(robot), float(fingers.tip[0] + fingers.low[0]) / 2 if fingers is not None else 0.0))
        return found

    @cached_property
    def missing(self) -> str:
        """The reason why the reach cannot be checked, or an empty string if it can be checked."""
        missing = EXTRAS["expert"].missing
        if missing:
            return f"inverse kinematics needs {', '.join(missing)}; install with `{install_line('expert')}`"
        if not self._names:
            return "the task does not use a robot"
        if not self._robots:
            return f"no model of {', '.join(self._names)} is installed; run `simfoundry doctor` for instructions"
        return ""

    def __call__(self, low: Array, high: Array, side: Sequence[float] = UP, way: Sequence[float] = UP) -> Reached:
        """Test if an arm can grasp a box.

        Args:
            low: The minimum corner of the box in the world [m], shape (3,).
            high: The maximum corner of the box in the world [m], shape (3,).
            side: The unit vector from the object toward the side from which the fingers point at it.
            way: The unit vector that points away from the object along the approach path.
        """
        if self.missing:
            return Reached(False, False, why=self.missing)
        key = tuple(np.round([*low, *high, *side, *way], 4).tolist())
        if key not in self._known:
            self._known[key] = self._solved(low, high, np.array(side), np.array(way))
        return self._known[key]

    def is_too_short(self, low: Array, high: Array, slack: float) -> bool:
        """Return True if no arm is long enough to grasp a box from above, even if the box moves by ``slack`` [m].

        This test is much faster than inverse kinematics. The result is False if the reach cannot be checked.
        """
        up = np.array(UP)
        return not self.missing and not any(
            self._is_near(arm, away, slack)
            and any(not arm.is_too_short(Pose.of(hand + OVER * up, turn), slack) for turn in _hand_turns(up))
            for arm, hand, away in self._grasps(low, high, up)
        )

    def nearest(self, low: Array, high: Array) -> Reached:
        """Return the result of a failed test, which names the arm whose base is nearest to the box."""
        found = ((away, arm.robot.name) for arm, _, away in self._grasps(low, high, np.array(UP)))
        away, name = min(found, key=itemgetter(0), default=(math.inf, ""))
        return Reached(False, True, name, away)

    def _grasps(self, low: Array, high: Array, side: Array) -> Iterator[tuple[Arm, Array, float]]:
        """Yield each arm, the position of its hand at the grasp [m], and the distance of the box from its base [m]."""
        middle = (low + high) / 2
        grasp = middle + max(float(np.abs(side) @ (high - low)) / 2 - DEEP, 0.0) * side
        for arm, tip in self._arms:
            yield arm, grasp + tip * side, math.hypot(*(middle - arm.robot.X_WB.p)[:2].tolist())

    @staticmethod
    def _is_near(arm: Arm, away: float, slack: float = 0.0) -> bool:
        return arm.robot.reach is None or away <= arm.robot.reach + BEYOND + slack

    def _solved(self, low: Array, high: Array, side: Array, way: Array) -> Reached:
        for arm, hand, away in self._grasps(low, high, side):
            if self._is_near(arm, away) and self._takes(arm, hand, side, way):
                return Reached(True, True, arm.robot.name, away)
        return self.nearest(low, high)

    def _takes(self, arm: Arm, hand: Array, side: Array, way: Array) -> bool:
        """Return True if the hand can reach the start of its approach and move from there to the grasp."""
        starts = (_toward(arm, hand), arm.home)
        for turn, start in product(_hand_turns(side), starts):
            q = arm.solve(Pose.of(hand + OVER * way, turn), start)
            if q is not None and arm.solve(Pose.of(hand, turn), q) is not None:
                return True
        return False


def _hand_turns(side: Array) -> list[Array]:
    """Return the orientations of hands that approach from ``side``, as wxyz quaternions.

    From above, the hand may have any rotation. From all other sides, the fingers are level.
    """
    if side[2] > 1 - 1e-9:
        turns = [2 * math.pi * k / YAWS for k in range(YAWS)]
        across = [np.array([math.cos(turn), math.sin(turn), 0.0]) for turn in turns]
    else:
        rising = np.array(UP) - side[2] * side
        rising = rising / np.linalg.norm(rising)
        across = [rising, -rising]
    return [Pose.from_matrix(np.column_stack([x, np.cross(-side, x), -side])).q for x in across]


def _toward(arm: Arm, hand: Array) -> Array:
    """Return the home configuration with the first joint rotated to point the hand toward its target.

    This is a good initial configuration if the axis of the first joint is vertical, as in most arms, and does no harm
    otherwise.
    """
    base, now = arm.robot.X_WB.p, arm.hand(arm.home).p
    turn = math.atan2(hand[1] - base[1], hand[0] - base[0]) - math.atan2(now[1] - base[1], now[0] - base[0])
    turned = np.array(arm.home)
    turned[0] += math.remainder(turn, 2 * math.pi)
    return np.asarray(np.clip(turned, arm.low, arm.high))
