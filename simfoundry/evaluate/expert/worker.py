"""Execution of the expert's skills.

This includes the timing of motions along paths, the commands, and the state of each arm.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from itertools import pairwise

import numpy as np

from simfoundry.backends.robot_models.mujoco_robot import RobotModelError
from simfoundry.evaluate.expert.motion import ArmPlanner, Held, Path, PlanningScene
from simfoundry.evaluate.policies.base import Observation
from simfoundry.geometry.frames import Array, Pose
from simfoundry.robots.arm import Arm, jaws
from simfoundry.scene.model import Scene

# Maximum joint speed [rad/s] and hand speed [m/s]: half of the limits of a Panda.
JOINT, HAND = 1.1, 0.35

# Fraction of both speeds for paths with corners; at full speed, servos with a lag of 0.1 s cut corners by 3 cm.
AROUND = 0.4

# Maximum hand speed near objects [m/s].
CAREFUL = 0.12

# Number of waves of the noise on a path; faster ones would look like a tremor.
WAVES = 3

# Time to accelerate from rest to full speed [s].
RAMP = 0.35


def paced(
    path: Path, hand: Callable[[Array], Pose], hz: float, speed: float = HAND, joint: float = JOINT
) -> list[Array]:
    """Return the configuration at each control step of a path.

    Args:
        path: The path.
        hand: A function that returns the hand pose for a configuration.
        hz: The control frequency [Hz].
        speed: The maximum speed of the hand [m/s].
        joint: The maximum speed of each joint [rad/s].
    """
    points = _dense(path)
    places = np.array([hand(q).p for q in points])
    joints = np.abs(np.diff(points, axis=0)).max(axis=1, initial=0.0) / joint
    moved = np.linalg.norm(np.diff(places, axis=0), axis=1) / speed
    at = np.concatenate([[0.0], np.cumsum(np.maximum(np.maximum(joints, moved), 1e-9))])
    length = float(at[-1])
    # The speed profile from rest to rest is trapezoidal, or triangular if the path is short.
    ramp = min(RAMP, float(np.sqrt(length * RAMP)))
    top = ramp / RAMP
    total = length / top + ramp if ramp == RAMP else 2 * ramp
    count = max(1, int(np.ceil(total * hz)))
    time = np.linspace(0.0, total, count + 1)[1:]
    start, end = time**2 / (2 * RAMP), length - (total - time) ** 2 / (2 * RAMP)
    gone = np.select([time < ramp, time > total - ramp], [start, end], top * (time - ramp / 2))
    return list(np.column_stack([np.interp(gone, at, joint) for joint in points.T]))


def wobbled(targets: list[Array], noise: float, rng: np.random.Generator) -> list[Array]:
    """Add smooth noise to joint targets, which vanishes at their end.

    Args:
        targets: The joint targets at each control step.
        noise: The standard deviation of the slowest wave of each joint [rad or m]; without noise, nothing is drawn.
        rng: The source of the noise.
    """
    if not noise or not targets:
        return targets
    # Waves with fixed ends, the amplitudes of which fall with their frequency as in a Brownian bridge.
    numbers = np.arange(1, WAVES + 1)
    waves = np.sin(np.pi * np.outer(np.arange(1, len(targets) + 1) / len(targets), numbers))
    return list(np.array(targets) + waves @ rng.normal(0.0, noise / numbers[:, None], (WAVES, len(targets[0]))))


def _dense(path: Path) -> Array:
    """Interpolate a path densely enough to determine the speed of the hand.

    The result has shape (k, n).
    """
    found = [path[0]]
    for a, b in pairwise(path):
        count = max(1, int(np.ceil(np.abs(b - a).max() / 0.05)))
        found += [a + (b - a) * k / count for k in range(1, count + 1)]
    return np.array(found)


# A skill in progress; each ``yield`` ends a control step with the current commands.
Script = Generator[None, None, None]

# Displacement [m] of a held object within the hand between two observations above which the object counts as lost; slow
# creep is allowed.
LOST = 0.03

# Position tolerance within which a joint has reached its target [rad].
ARRIVED = 0.003

# Maximum number of control steps to wait for an arm to reach its target.
PATIENCE = 12

# Fraction of a resting arm's position error that is added to its targets in each update, and the limit [rad] on the
# total. This compensates for servo sag.
CORRECTION, MOST = 0.6, 0.05


# Maximum time to wait for a gripper [s]: that of the YAM arm needs 4 s from open to closed.
CLOSING = 5.0


class FailedError(Exception):
    """An error raised if a skill fails.

    The message contains the reason.
    """


class ExpertWorker:
    """The arms of a task's robots.

    For each arm, the worker stores the commands and the latest observation.
    """

    def __init__(self, scene: Scene, robots: Sequence[str], hz: float, noise: float = 0.0) -> None:
        self.scene, self.hz, self.noise = scene, hz, noise
        self.cell = PlanningScene(scene)
        self.arms = {name: Arm(scene.robot(name)) for name in robots}
        self.now: Observation
        self.begin(0)

    def begin(self, seed: int) -> None:
        """Reset all state at the start of a rollout."""
        self.rng = np.random.default_rng(seed)
        self.planners: dict[str, ArmPlanner] = {}
        for name, arm in self.arms.items():
            if (fingers := jaws(arm.robot)) is None:
                raise RobotModelError(
                    f"robot `{name}` does not have a gripper whose fingers close along the y axis of its hand"
                )
            self.planners[name] = ArmPlanner(self.cell, arm, fingers, self.rng)
        self.q: dict[str, Array] = {}
        self.share = dict.fromkeys(self.arms, 0.0)
        self.held: dict[str, Held] = {}
        self._bias = {name: np.zeros(len(arm.joints)) for name, arm in self.arms.items()}
        self._before: dict[str, Array] = {}

    def look(self, observation: Observation) -> None:
        """Store an observation, and update the sag compensation of each arm at rest."""
        self.now = observation
        for name in self.arms:
            measured = observation.robots[name].joints
            self.q.setdefault(name, np.array(measured))
            if name in self._before and np.array_equal(self._before[name], self.q[name]):
                bias = self._bias[name] + CORRECTION * (self.q[name] - measured)
                self._bias[name] = np.clip(bias, -MOST, MOST)
            self._before[name] = self.q[name]

    def command(self) -> Array:
        """Return the action for the current control step."""
        return np.concatenate([np.append(self.q[name] + self._bias[name], self.share[name]) for name in self.arms])

    def sync(self) -> None:
        """Set the planning scene to the current state."""
        grippers = {name: self.now.robots[name].gripper for name in self.arms}
        self.cell.sync(self.now.state, self.q, grippers)

    def go(self, robot: str, path: Path) -> Script:
        """Follow a path through free space, slowing down if it has corners, then settle."""
        share = 1.0 if len(path) <= 2 else AROUND
        yield from self._track(
            robot, wobbled(self._paced(robot, path, share * HAND, share * JOINT), self.noise, self.rng)
        )
        yield from self.settle(robot)

    def creep(self, robot: str, path: Path) -> Script:
        """Follow a path slowly near objects, then settle."""
        yield from self.follow(robot, path, CAREFUL)
        yield from self.settle(robot)

    def follow(self, robot: str, path: Path, speed: float = HAND, joint: float = JOINT) -> Script:
        """Follow a path with limited speed.

        Args:
            path: The path.
            speed: The maximum speed of the hand [m/s].
            joint: The maximum speed of each joint [rad/s].
        """
        yield from self._track(robot, self._paced(robot, path, speed, joint))

    def _paced(self, robot: str, path: Path, speed: float, joint: float) -> list[Array]:
        return paced(path, self.arms[robot].hand, self.hz, speed, joint)

    def _track(self, robot: str, targets: list[Array]) -> Script:
        for q in targets:
            self.q[robot] = q
            yield
            self.check(robot)

    def settle(self, robot: str) -> Script:
        """Wait until the arm reaches its target."""
        for _ in range(PATIENCE):
            yield
            self.check(robot)
            if np.abs(self.q[robot] - self.now.robots[robot].joints).max() < ARRIVED:
                return

    def wait(self, seconds: float) -> Script:
        """Hold still for the given number of seconds."""
        for _ in range(max(1, round(seconds * self.hz))):
            yield

    def grip(self, robot: str, share: float) -> Script:
        """Close the gripper until it is closed by the fraction ``share`` or stops moving."""
        self.share[robot] = share
        last = -1.0
        for k in range(round(CLOSING * self.hz)):
            yield
            gripper = self.now.robots[robot].gripper
            if k > 0.4 * self.hz and abs(gripper - last) < 0.002:
                return
            if k % 3 == 0:
                last = gripper

    def check(self, robot: str) -> None:
        """Raise :class:`FailedError` if the hand has lost its object."""
        if (held := self.held.get(robot)) is None:
            return
        X_HO = self.now.robots[robot].X_WH.inverse() @ self.now.state.poses[held.name]
        if np.linalg.norm(X_HO.p - held.X_HO.p) > LOST:
            del self.held[robot]
            raise FailedError(f"{held.name} slipped out of {robot}'s hand")
        self.held[robot] = Held(held.name, X_HO)
