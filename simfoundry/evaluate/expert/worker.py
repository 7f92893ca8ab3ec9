"""What a script acts through: the arms' commands, step by step, and what is seen meanwhile."""

from __future__ import annotations

from collections.abc import Generator, Sequence

import numpy as np

from simfoundry.backends.robot_models.mujoco_robot import RobotModelError
from simfoundry.evaluate.expert.arm import Arm
from simfoundry.evaluate.expert.cell import Cell
from simfoundry.evaluate.expert.jaws import jaws
from simfoundry.evaluate.expert.pace import AROUND, HAND, JOINT, paced
from simfoundry.evaluate.expert.reach import Held, Path, Reach
from simfoundry.evaluate.policies.base import Observation
from simfoundry.geometry.frames import Array
from simfoundry.scene.model import Scene

Script = Generator[None, None, None]
"""Something done with the arms; each ``yield`` is a control step with the present commands."""

LOST = 0.03
"""A held thing that moves further than this in the hand between two looks [m] is lost; it may creep."""

ARRIVED = 0.003
"""A joint this close to its target is there [rad]."""

PATIENCE = 12
"""Control steps that an arm is waited for."""

CORRECTION, MOST = 0.6, 0.05
"""How much of a resting arm's error is added to its targets each time, and how much in all [rad]: servos sag."""


class FailedError(Exception):
    """A skill came to nothing; the message says why."""


class Worker:
    """The arms of a task's robots, their commands and the latest observation."""

    def __init__(self, scene: Scene, robots: Sequence[str], hz: float) -> None:
        self.scene, self.hz = scene, hz
        self.cell = Cell(scene)
        self.arms = {name: Arm(scene.robot(name)) for name in robots}
        self._robots = tuple(robots)
        self.seen: Observation | None = None
        self.begin(0)

    def begin(self, seed: int) -> None:
        """Forget everything."""
        self.rng = np.random.default_rng(seed)
        self.reaches: dict[str, Reach] = {}
        for name, arm in self.arms.items():
            fingers = jaws(arm.robot)
            if fingers is None:
                raise RobotModelError(f"robot `{name}` has no gripper whose fingers close along the y of its hand")
            self.reaches[name] = Reach(self.cell, arm, fingers, self.rng)
        self.q: dict[str, Array] = {}
        self.share = dict.fromkeys(self._robots, 0.0)
        self.held: dict[str, Held] = {}
        self._bias = {name: np.zeros(len(arm.joints)) for name, arm in self.arms.items()}
        self._before: dict[str, Array] = {}

    @property
    def now(self) -> Observation:
        """The latest observation."""
        assert self.seen is not None
        return self.seen

    def look(self, observation: Observation) -> None:
        """Take in an observation; an arm that rests learns how far it sags."""
        self.seen = observation
        for name in self._robots:
            measured = observation.robots[name].joints
            self.q.setdefault(name, np.array(measured))
            before = self._before.get(name)
            if before is not None and np.array_equal(before, self.q[name]):
                bias = self._bias[name] + CORRECTION * (self.q[name] - measured)
                self._bias[name] = np.clip(bias, -MOST, MOST)
            self._before[name] = self.q[name]

    def command(self) -> Array:
        """The action of the present step."""
        parts = [np.append(self.q[name] + self._bias[name], self.share[name]) for name in self._robots]
        return np.concatenate(parts)

    def sync(self) -> None:
        """Bring the planning model to what is seen now."""
        grippers = {name: self.now.robots[name].gripper for name in self._robots}
        self.cell.sync(self.now.state, self.q, grippers)

    def go(self, robot: str, path: Path) -> Script:
        """Go a way through free space: straight at full speed, around corners slower."""
        share = 1.0 if len(path) <= 2 else AROUND
        return self.follow(robot, path, share * HAND, share * JOINT)

    def follow(self, robot: str, path: Path, speed: float = HAND, joint: float = JOINT) -> Script:
        """Go along a path no faster than ``speed`` [m/s] of the hand and ``joint`` [rad/s]."""
        for q in paced(path, self.arms[robot].hand, self.hz, speed, joint):
            self.q[robot] = q
            yield
            self.check(robot)

    def settle(self, robot: str) -> Script:
        """Wait until the arm is where it is to be."""
        for _ in range(PATIENCE):
            yield
            self.check(robot)
            if np.abs(self.q[robot] - self.now.robots[robot].joints).max() < ARRIVED:
                return

    def wait(self, seconds: float) -> Script:
        """Do nothing."""
        for _ in range(max(1, round(seconds * self.hz))):
            yield

    def grip(self, robot: str, share: float) -> Script:
        """Close the gripper by ``share``, or as far as it goes."""
        self.share[robot] = share
        last = -1.0
        for k in range(round(1.5 * self.hz)):
            yield
            gripper = self.now.robots[robot].gripper
            if k > 0.4 * self.hz and abs(gripper - last) < 0.002:
                return
            if k % 3 == 0:
                last = gripper

    def check(self, robot: str) -> None:
        """Raise :class:`FailedError` where the thing that was held is held no more."""
        held = self.held.get(robot)
        if held is None:
            return
        X_HO = self.now.robots[robot].X_WH.inverse() @ self.now.state.poses[held.name]
        if np.linalg.norm(X_HO.p - held.X_HO.p) > LOST:
            del self.held[robot]
            raise FailedError(f"{held.name} slipped out of the hand of {robot}")
        self.held[robot] = Held(held.name, X_HO)
