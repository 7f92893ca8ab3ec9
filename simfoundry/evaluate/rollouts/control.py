"""The interface between a policy and the robots and cameras in a world.

The interface provides observations and applies actions as joint targets.
"""

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
    """Check that the scene has all requested cameras and that no requested image is empty.

    Args:
        scene: The scene.
        wanted: The requested image sizes, keyed by camera.
        who: A description of the requester for error messages.

    Raises:
        SimfoundryError: If a camera does not exist or an image has no pixels.
    """
    known = [c.name for c in scene.cameras] + [m.camera.name for m in scene.mounted]
    lost = {left.path.removeprefix("cameras."): left.reason for left in scene.left_out}
    for name, size in wanted.items():
        if name not in known:
            hint = lost.get(name) or nearest(name, known) or "the scene has no cameras"
            raise SimfoundryError(f"{who} requests camera `{name}`, which scene `{scene.name}` does not have; {hint}")
        if size.width < 1 or size.height < 1:
            raise SimfoundryError(
                f"{who} requests an image of {size.width} x {size.height} pixels from `{name}`; both must be positive"
            )


def readings(world: World, robots: Mapping[str, WorldRobot]) -> dict[str, RobotReading]:
    """Read the current state of each robot."""
    found = {}
    for name, robot in robots.items():
        positions = robot.positions()
        X_WH = robot.frame("hand")
        X_BH = world.scene.robot(name).X_WB.inverse() @ X_WH
        joints = frozen_array([positions[joint] for joint in robot.joints])
        found[name] = RobotReading(joints, robot.gripper(), X_WH, X_BH)
    return found


def pictures(world: World, cameras: Mapping[str, ImageSize]) -> dict[str, Image]:
    """Render an image of the given size from each camera."""
    return {name: np.asarray(world.render(name, size.width, size.height)) for name, size in cameras.items()}


# Maximum distance [rad or m] between a joint and its target when velocities are integrated, equal to DROID's largest
# step.
FARTHEST = 0.2


def physics_steps(step: int, control_hz: float, timestep: float) -> int:
    """Return the number of physics steps in a control step, which is at least 1.

    The end of each control step, rather than its length, is rounded to a physics step, so that rounding errors do not
    accumulate. For example, at 15 Hz and 2 ms per physics step, control steps consist of 33, 34, 33, ... physics steps.
    After 10 s, there have been exactly 150 control steps.

    Args:
        step: The index of the control step, counted from 0.
        control_hz: The control frequency [Hz].
        timestep: The duration of a physics step [s].
    """
    period = 1.0 / (control_hz * timestep)
    return max(1, round((step + 1) * period) - round(step * period))


class Controller:
    """A controller that applies actions as targets for the arm joints and grippers.

    Position targets are clamped to the joint limits. Velocities [rad/s or m/s] are integrated from the previous
    targets. If they were integrated from the measured positions, the arm would sink because servos sag slightly below
    their targets. A target stays within :data:`FARTHEST` of its joint so that it does not wind up while the arm is
    blocked.
    """

    def __init__(self, robots: Mapping[str, WorldRobot], space: ActionSpace, control_hz: float) -> None:
        self._robots, self._space, self._period = robots, space, 1.0 / control_hz
        self._targets = {name: robot.positions() for name, robot in robots.items()}

    def apply(self, action: Array) -> None:
        """Set the targets for one action, an array of shape (action size,)."""
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
