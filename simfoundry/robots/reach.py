"""Reach of robots: along the ground by what is known of them, and by inverse kinematics of their arms.

Both are about the arm alone: its fingers may not fit the object, and something may be in the way.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from simfoundry.geometry.frames import Array, Pose
from simfoundry.robots.arm import Arm
from simfoundry.robots.fingers import jaws
from simfoundry.runtime.extras import EXTRAS, install_line
from simfoundry.scene.model import Scene
from simfoundry.scene.poses import pose
from simfoundry.spec.models.robot import RobotSpec

OVER = 0.10
"""From how far its grasp the hand comes [m]."""

YAWS = 6
"""Turns of the hand about z that are tried."""

DEEP = 0.03
"""How far behind the top or the side from which they come fingers take a thing [m]; at its
middle if that is nearer."""

UP = (0.0, 0.0, 1.0)


PAYLOAD = 1.0
"""Greatest mass that a robot lifts of which nothing is known [kg]: light arms for the desk lift 0.5 to 1.5 kg."""

BEYOND = 0.1
"""Distance beyond its known reach at which an arm is still solved for [m]: an object is grasped at its near side."""


class Hand(NamedTuple):
    """A robot that acts: its base along the ground [m], how far it reaches [m], opens [m] and lifts [kg].

    ``reach`` and ``opening`` are None if they are unknown; ``kind`` is the known robot that it is, else empty.
    """

    name: str
    at: tuple[float, float]
    reach: float | None
    opening: float | None
    payload: float
    kind: str = ""


class Miss(NamedTuple):
    """The hand that misses a place by least, and the distance of the place from its base [m]."""

    hand: Hand
    distance: float
    reach: float

    @property
    def lacking(self) -> float:
        """Return how much farther the robot would have to reach [m]."""
        return self.distance - self.reach


def hands_of(robots: Mapping[str, RobotSpec], payload: float | None = None) -> tuple[Hand, ...]:
    """Return the hands of robots of a document, whether or not their models are here; ``payload`` [kg] overrides."""
    found = []
    for name, robot in robots.items():
        known, kind = robot.known(), robot.model if isinstance(robot.model, str) else ""
        reach, opening, lifts = (known.reach, known.opening, known.payload) if known is not None else (None, None, None)
        x, y, _ = pose(robot.pose).p.tolist()
        own = (robot.reach or reach, robot.opening or opening, payload or lifts or PAYLOAD)
        found.append(Hand(name, (x, y), *own, kind))
    return tuple(found)


def nearest_miss(hands: Sequence[Hand], distances: Iterable[float]) -> Miss | None:
    """Return the hand that misses a place by least, by its distances from their bases along the ground [m].

    None if one of them reaches it, or if it is unknown how far one reaches.
    """
    misses = [Miss(h, d, h.reach) for h, d in zip(hands, distances, strict=True) if h.reach is not None]
    nearest = min(misses, key=lambda miss: miss.lacking, default=None)
    return nearest if nearest is not None and len(misses) == len(hands) and nearest.lacking > 0 else None


@dataclass(frozen=True)
class Reached:
    """The result of a reach test: ``robot`` that reaches, or the nearest; ``away`` [m] from its base, along the ground.

    ``checked`` is False where no arm has a model or the solver is not installed; ``why`` says so.
    """

    reached: bool
    checked: bool
    robot: str = ""
    away: float = 0.0
    why: str = ""


class ArmReach:
    """The arms of a scene."""

    def __init__(self, scene: Scene, robots: tuple[str, ...]) -> None:
        self._scene, self._names = scene, robots
        self._known: dict[tuple[float, ...], Reached] = {}

    @cached_property
    def _arms(self) -> list[tuple[Arm, float]]:
        """Arms with the distance [m] along the hand from its frame to between its finger tips."""
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
        """Return why nothing can be checked; empty where it can."""
        missing = EXTRAS["expert"].missing
        if missing:
            return f"inverse kinematics needs {', '.join(missing)}; install with `{install_line('expert')}`"
        if not self._names:
            return "no robot acts here"
        if not any(robot.name in self._names for robot in self._scene.robots):
            return f"no model of {', '.join(self._names)} is here; `simfoundry doctor` says what brings it"
        return ""

    def __call__(self, low: Array, high: Array, side: Sequence[float] = UP, way: Sequence[float] = UP) -> Reached:
        """Return whether an arm can take what is between two corners in the world [m], shape (3,) each.

        The hand comes from a ``side`` along a ``way``: unit vectors away from the thing.
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
        """Return whether the hand gets to where its way begins and straight to its place."""
        starts = (_towards(arm, hand), arm.home)
        for turn in _hand_turns(side):
            before = Pose.of(hand + OVER * way, turn)
            for start in starts:
                q = arm.solve(before, start)
                if q is not None and arm.solve(Pose.of(hand, turn), q) is not None:
                    return True
        return False


def _hand_turns(side: Array) -> list[Array]:
    """Quaternions (wxyz) of hands that look away from a ``side``: any turn from above, else fingers side by side."""
    if side[2] > 1 - 1e-9:
        turns = [2 * math.pi * k / YAWS for k in range(YAWS)]
        across = [np.array([math.cos(turn), math.sin(turn), 0.0]) for turn in turns]
    else:
        rising = np.array(UP) - side[2] * side
        rising = rising / np.linalg.norm(rising)
        across = [rising, -rising]
    return [Pose.from_matrix(np.column_stack([x, np.cross(-side, x), -side])).q for x in across]


def _towards(arm: Arm, hand: Array) -> Array:
    """The home posture with the first joint turned so that the hand is on the side where it should go.

    A good start where that joint stands upright, as it does in most arms, and no bad one elsewhere.
    """
    base, now = arm.robot.X_WB.p, arm.hand(arm.home).p
    turn = math.atan2(hand[1] - base[1], hand[0] - base[0]) - math.atan2(now[1] - base[1], now[0] - base[0])
    turned = np.array(arm.home)
    turned[0] += math.remainder(turn, 2 * math.pi)
    return np.asarray(np.clip(turned, arm.low, arm.high))
