"""Robot reach: horizontal distance from published data, and inverse kinematics of the arms.

Both concern the arm alone: the fingers may not fit the object, and obstacles are ignored.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from simfoundry.geometry.frames import Array, Pose
from simfoundry.robots.arm import Arm, jaws
from simfoundry.runtime.extras import EXTRAS, install_line
from simfoundry.scene.model import Scene
from simfoundry.scene.state import pose
from simfoundry.spec.models.robot import RobotSpec

OVER = 0.10
"""Distance from which the hand approaches its grasp [m]."""

YAWS = 6
"""Number of hand rotations about z that are tried."""

DEEP = 0.03
"""Depth of the fingertips below the top or side of the object from which the hand approaches [m]; the object's center
if that is nearer."""

UP = (0.0, 0.0, 1.0)


PAYLOAD = 1.0
"""Payload of robots without published data [kg]; light desktop arms lift 0.5 to 1.5 kg."""

BEYOND = 0.1
"""Distance beyond the published reach at which an arm is still solved [m], because grasps are at an object's near
side."""


class Hand(NamedTuple):
    """A robot that acts: its base in the horizontal plane [m], and its reach [m], opening [m] and payload [kg].

    ``reach`` and ``opening`` are None if unknown; ``kind`` is the name of the known robot, or empty.
    """

    name: str
    at: tuple[float, float]
    reach: float | None
    opening: float | None
    payload: float
    kind: str = ""


class Miss(NamedTuple):
    """The hand closest to reaching a place, and the horizontal distance of the place from its base [m]."""

    hand: Hand
    distance: float
    reach: float

    @property
    def lacking(self) -> float:
        """The distance by which the place is beyond the reach [m]."""
        return self.distance - self.reach


def hands_of(robots: Mapping[str, RobotSpec], payload: float | None = None) -> tuple[Hand, ...]:
    """Return the hands of a document's robots, with or without installed models; ``payload`` [kg] overrides theirs."""
    found = []
    for name, robot in robots.items():
        known, kind = robot.known(), robot.model if isinstance(robot.model, str) else ""
        reach, opening, lifts = (known.reach, known.opening, known.payload) if known is not None else (None, None, None)
        x, y, _ = pose(robot.pose).p.tolist()
        own = (robot.reach or reach, robot.opening or opening, payload or lifts or PAYLOAD)
        found.append(Hand(name, (x, y), *own, kind))
    return tuple(found)


def nearest_miss(hands: Sequence[Hand], distances: Iterable[float]) -> Miss | None:
    """Return the hand that is closest to reaching a place, given horizontal distances from their bases [m].

    Returns None if a hand reaches the place or if a reach is unknown.
    """
    misses = [Miss(h, d, h.reach) for h, d in zip(hands, distances, strict=True) if h.reach is not None]
    nearest = min(misses, key=lambda miss: miss.lacking, default=None)
    return nearest if nearest is not None and len(misses) == len(hands) and nearest.lacking > 0 else None


@dataclass(frozen=True)
class Reached:
    """Result of a reach test: the ``robot`` that reaches or the nearest one; ``away`` [m] is horizontal, from its base.

    ``checked`` is False if no arm has a model or the solver is not installed; ``why`` gives the reason.
    """

    reached: bool
    checked: bool
    robot: str = ""
    away: float = 0.0
    why: str = ""


class ArmReach:
    """Reachability of grasps by the arms of a scene."""

    def __init__(self, scene: Scene, robots: tuple[str, ...]) -> None:
        self._scene, self._names = scene, robots
        self._known: dict[tuple[float, ...], Reached] = {}

    @cached_property
    def _arms(self) -> list[tuple[Arm, float]]:
        """The arms, each with the distance [m] along the hand from its frame to the point between the fingertips."""
        found = []
        there = {robot.name: robot for robot in self._scene.robots}
        for name in self._names:
            if name in there:
                arm = Arm(there[name])
                fingers = jaws(there[name])
                found.append((arm, float(fingers.tip[0] + fingers.low[0]) / 2 if fingers is not None else 0.0))
        return found

    @cached_property
    def missing(self) -> str:
        """The reason why reach cannot be checked; empty if it can."""
        missing = EXTRAS["expert"].missing
        if missing:
            return f"inverse kinematics needs {', '.join(missing)}; install with `{install_line('expert')}`"
        if not self._names:
            return "no robot acts here"
        if not any(robot.name in self._names for robot in self._scene.robots):
            return f"no model of {', '.join(self._names)} is installed; `simfoundry doctor` shows how to get it"
        return ""

    def __call__(self, low: Array, high: Array, side: Sequence[float] = UP, way: Sequence[float] = UP) -> Reached:
        """Test whether an arm can grasp the box between two corners in the world [m], shape (3,) each.

        The fingers point toward the object from ``side``, and the hand approaches along ``way``; both are unit vectors
        that point away from the object.
        """
        if self.missing:
            return Reached(False, False, why=self.missing)
        key = tuple(np.round([*low, *high, *side, *way], 4).tolist())
        if key not in self._known:
            self._known[key] = self._solved(low, high, np.array(side), np.array(way))
        return self._known[key]

    def _solved(self, low: Array, high: Array, side: Array, way: Array) -> Reached:
        middle = (low + high) / 2
        grasp = middle + max(float(np.abs(side) @ (high - low)) / 2 - DEEP, 0.0) * side
        nearest = Reached(False, True, away=math.inf)
        for arm, tip in self._arms:
            base = arm.robot.X_WB.p
            away = math.hypot(*(middle - base)[:2].tolist())
            if away < nearest.away:
                nearest = Reached(False, True, arm.robot.name, away)
            if arm.robot.reach is not None and away > arm.robot.reach + BEYOND:
                continue
            if self._takes(arm, grasp + tip * side, side, way):
                return Reached(True, True, arm.robot.name, away)
        return nearest

    def _takes(self, arm: Arm, hand: Array, side: Array, way: Array) -> bool:
        """Return true if the hand reaches the start of its approach and moves from there to the grasp."""
        starts = (_toward(arm, hand), arm.home)
        for turn in _hand_turns(side):
            before = Pose.of(hand + OVER * way, turn)
            for start in starts:
                q = arm.solve(before, start)
                if q is not None and arm.solve(Pose.of(hand, turn), q) is not None:
                    return True
        return False


def _hand_turns(side: Array) -> list[Array]:
    """Return quaternions (wxyz) of hands that approach from ``side``: any rotation from above, else level fingers."""
    if side[2] > 1 - 1e-9:
        turns = [2 * math.pi * k / YAWS for k in range(YAWS)]
        across = [np.array([math.cos(turn), math.sin(turn), 0.0]) for turn in turns]
    else:
        rising = np.array(UP) - side[2] * side
        rising = rising / np.linalg.norm(rising)
        across = [rising, -rising]
    return [Pose.from_matrix(np.column_stack([x, np.cross(-side, x), -side])).q for x in across]


def _toward(arm: Arm, hand: Array) -> Array:
    """Return the home configuration with the first joint rotated to turn the hand toward its target.

    This is a good start if the axis of that joint is vertical, as in most arms, and does no harm otherwise.
    """
    base, now = arm.robot.X_WB.p, arm.hand(arm.home).p
    turn = math.atan2(hand[1] - base[1], hand[0] - base[0]) - math.atan2(now[1] - base[1], now[0] - base[0])
    turned = np.array(arm.home)
    turned[0] += math.remainder(turn, 2 * math.pi)
    return np.asarray(np.clip(turned, arm.low, arm.high))
