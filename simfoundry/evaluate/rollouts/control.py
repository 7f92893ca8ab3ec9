"""Interface between a policy and the robots and cameras of a world: observations, and actions as joint targets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.policies.base import ActionSpace, Image, ImageSize, RobotReading
from simfoundry.geometry.frames import Array, frozen_array
from simfoundry.scene.model import Scene
from simfoundry.spec.diagnostics import nearest
from simfoundry.worlds.base import World, WorldRobot


def check_cameras(scene: Scene, wanted: Mapping[str, ImageSize], who: str) -> None:
    """Raise :class:`SimfoundryError` for a camera that the scene lacks, or a size without pixels."""
    known = [c.name for c in scene.cameras] + [m.camera.name for m in scene.mounted]
    lost = {left.path.removeprefix("cameras."): left.reason for left in scene.left_out}
    for name, size in wanted.items():
        if name not in known:
            hint = lost.get(name) or nearest(name, known) or "it has none"
            raise SimfoundryError(f"{who} requests camera `{name}`, which scene `{scene.name}` does not have; {hint}")
        if size.width < 1 or size.height < 1:
            raise SimfoundryError(f"{who} requests an image of {size.width} x {size.height} pixels from `{name}`")


def readings(world: World, robots: Mapping[str, WorldRobot]) -> dict[str, RobotReading]:
    """Read the present state of each robot."""
    found = {}
    for name, robot in robots.items():
        positions = robot.positions()
        X_WH = robot.frame("hand")
        X_BH = world.scene.robot(name).X_WB.inverse() @ X_WH
        joints = frozen_array([positions[joint] for joint in robot.joints])
        found[name] = RobotReading(joints, robot.gripper(), X_WH, X_BH)
    return found


def pictures(world: World, cameras: Mapping[str, ImageSize]) -> dict[str, Image]:
    """Render the cameras, each at its size."""
    return {name: np.asarray(world.render(name, size.width, size.height)) for name, size in cameras.items()}


FARTHEST = 0.2
"""Maximum distance of a target from its joint when velocities are integrated [rad or m]: DROID's largest step."""


def physics_steps(step: int, control_hz: float, timestep: float) -> int:
    """Number of steps of ``timestep`` [s] in control step ``step``, counted from 0.

    The end of each control step, not its length, is rounded to a physics step, so that rounding errors never add up: 15
    Hz with steps of 2 ms gives 33, 34, 33, ... steps, and 10 s are 150 control steps. At least 1.
    """
    period = 1.0 / (control_hz * timestep)
    return max(1, round((step + 1) * period) - round(step * period))


class Controller:
    """Applies actions as targets of the arms' joints and as gripper closures.

    Position targets are clamped to the joint limits. Velocities [rad/s or m/s] are integrated from the previous
    targets, because servos sag slightly below their targets: integrated from the measured positions, the arm would
    sink. A target stays within :data:`FARTHEST` of its joint, so that it does not wind up while the arm is blocked.
    """

    def __init__(self, robots: Mapping[str, WorldRobot], space: ActionSpace, control_hz: float) -> None:
        self._robots, self._space, self._period = robots, space, 1.0 / control_hz
        self._targets = {name: robot.positions() for name, robot in robots.items()}

    def apply(self, action: Array) -> None:
        """Set the targets of one action, shape (numbers of an action,)."""
        start = 0
        for name, robot in self._robots.items():
            arm = action[start : start + len(robot.joints)]
            if self._space is ActionSpace.JOINT_VELOCITY:
                targets = self._integrated(name, robot, arm)
            else:
                targets = dict(zip(robot.joints, map(float, arm), strict=True))
            robot.set_targets(targets)
            robot.set_gripper(float(action[start + len(robot.joints)]))
            self._targets[name] = targets
            start += len(robot.joints) + 1

    def _integrated(self, name: str, robot: WorldRobot, velocities: Sequence[float] | Array) -> dict[str, float]:
        now, limits, targets = robot.positions(), robot.limits(), {}
        for joint, velocity in zip(robot.joints, velocities, strict=True):
            low, high = limits[joint]
            low, high = max(low, now[joint] - FARTHEST), min(high, now[joint] + FARTHEST)
            wanted = self._targets[name][joint] + float(velocity) * self._period
            targets[joint] = min(max(wanted, low), max(low, high))
        return targets
