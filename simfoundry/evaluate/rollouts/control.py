"""The interface between a policy and the robots and cameras in a world.

The interface provides observations and applies actions as joint targets.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.actions import (
    FARTHEST_NUMBER,
    action_limits,
    columns,
    denormalized,
    rotation_numbers,
    rotation_quat,
)
from simfoundry.evaluate.policies.base import Image, ImageSize, RobotReading
from simfoundry.geometry.frames import Array, Pose, frozen_array
from simfoundry.runtime.extras import need_extra
from simfoundry.scene.model import Scene
from simfoundry.spec.diagnostics import nearest
from simfoundry.spec.models.signals import (
    MAX_JOINT_DELTA,
    MAX_ROTATION,
    MAX_TRANSLATION,
    ActionKind,
    ActionSpace,
    HandFrame,
    ImageKind,
    RotationForm,
)
from simfoundry.worlds.base import World, WorldRobot

if TYPE_CHECKING:
    from simfoundry.evaluate.rollouts.noise import ActionNoise
    from simfoundry.robots.arm import Arm


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


def camera_images(
    world: World, cameras: Mapping[str, ImageSize], kinds: Iterable[ImageKind]
) -> dict[ImageKind, dict[str, NDArray[Any]]]:
    """Return the images of each kind, keyed by camera, as described in :mod:`simfoundry.spec.models.signals`."""
    found: dict[ImageKind, dict[str, NDArray[Any]]] = {kind: {} for kind in kinds}
    if ImageKind.COLOR in found:
        found[ImageKind.COLOR] |= pictures(world, cameras)
    if found.keys() - {ImageKind.COLOR}:
        for name, size in cameras.items():
            depth, mask = world.depth_and_mask(name, size.width, size.height)
            for kind, image in ((ImageKind.DEPTH, depth), (ImageKind.MASK, mask)):
                if kind in found:
                    found[kind][name] = image
    return found


# Maximum distance [rad or m] between a joint and its target when velocities or changes are added up, equal to DROID's
# largest step.
FARTHEST = MAX_JOINT_DELTA

# Maximum distance [m] and angle [rad] between the hand and its target when changes of its pose are added up: two of the
# largest steps, so that a moving hand is not slowed down.
HAND_AHEAD, HAND_TURN = 2 * MAX_TRANSLATION, 2 * MAX_ROTATION


# Tolerances of inverse kinematics for hand targets [m, rad]; small compared with the smallest useful motion in a step.
HAND_NEAR, HAND_TURNED = 1e-4, 1e-3


class Controller:
    """A controller that applies actions as targets for the arm joints and grippers.

    Position targets are clamped to the joint limits. Velocities [rad/s or m/s] and deltas are added to the previous
    targets. If they were added to the measured positions, the arm would sink because servos sag slightly below their
    targets. A target stays within :data:`FARTHEST` of its joint, or within :data:`HAND_AHEAD` and :data:`HAND_TURN` of
    its hand, so that it does not wind up while the arm is blocked. Hand targets are converted to joint targets by
    inverse kinematics; if the arm cannot reach a pose, it moves as close as it can.

    Args:
        world: The world.
        robots: The names of the robots, in the order of an action.
        space: The meaning of the numbers in an action.
        control_hz: The number of actions per second [Hz].
        noise: The errors of targets, which do not add up, or None.
    """

    def __init__(
        self,
        world: World,
        robots: Iterable[str],
        space: ActionSpace,
        control_hz: float,
        noise: ActionNoise | None = None,
    ) -> None:
        self.robots: dict[str, WorldRobot] = {name: world.robot(name) for name in robots}
        self._space, self._period = space, 1.0 / control_hz
        self._targets = {name: robot.positions() for name, robot in self.robots.items()}
        self._limits = action_limits(space, world.scene, self.robots)
        self._arms = {name: _arm(world.scene, name) for name in self.robots} if space.of_hand else {}
        self._hands = {name: self.robots[name].frame("hand") for name in self._arms}
        self._grippers = {name: robot.gripper() for name, robot in self.robots.items()}
        self._action: Array = np.zeros(0)
        self._noise = noise
        self._errors: dict[str, tuple[Array, float]] = {}

    @property
    def targets(self) -> Mapping[str, Mapping[str, float]]:
        """The current targets of the joints [rad or m], keyed by robot and joint."""
        return self._targets

    @property
    def grippers(self) -> Mapping[str, float]:
        """The current target of each gripper, from 0 (open) to 1 (closed); initially its position."""
        return self._grippers

    def begin(self, action: Array) -> None:
        """Start an action, an array of shape (action size,).

        Targets are set for its whole duration, except those of velocities, which :meth:`move` moves.
        """
        near = np.clip(action, -FARTHEST_NUMBER, FARTHEST_NUMBER)
        self._action = denormalized(near, self._limits) if self._space.normalized else near
        if self._noise is not None:
            self._errors = self._noise.draw({name: len(robot.joints) for name, robot in self.robots.items()})
        for name, arm, gripper in columns(self.robots, self._space):
            robot, values = self.robots[name], self._action[arm]
            match self._space.kind:
                case ActionKind.JOINT_POSITION:
                    self._set(name, dict(zip(robot.joints, map(float, values), strict=True)))
                case ActionKind.JOINT_DELTA:
                    self._set(name, self._added(name, values))
                case ActionKind.HAND_POSE | ActionKind.HAND_DELTA:
                    self._set(name, self._reached(name, values))
            self._grippers[name] = min(max(float(self._action[gripper]), 0.0), 1.0)
            robot.set_gripper(self._grippers[name] + self._errors.get(name, (None, 0.0))[1])

    def move(self, share: float) -> None:
        """Move the targets of velocities by ``share`` of the duration of the action."""
        if self._space.kind is ActionKind.JOINT_VELOCITY:
            for name, arm, _ in columns(self.robots, self._space):
                self._set(name, self._added(name, [float(v) * self._period * share for v in self._action[arm]]))

    def _set(self, name: str, targets: dict[str, float]) -> None:
        """Set the targets of a robot's joints, with the errors of the action, which the next targets do not inherit."""
        errors = self._errors.get(name)
        disturbed = targets if errors is None else dict(zip(targets, errors[0] + list(targets.values()), strict=True))
        self.robots[name].set_targets({joint: float(target) for joint, target in disturbed.items()})
        self._targets[name] = targets

    def _added(self, name: str, changes: Iterable[float]) -> dict[str, float]:
        """Add changes [rad or m] to the previous targets of a robot's joints."""
        robot = self.robots[name]
        now, limits, targets = robot.positions(), robot.limits(), {}
        for joint, change in zip(robot.joints, changes, strict=True):
            low, high = limits[joint]
            low, high = max(low, now[joint] - FARTHEST), min(high, now[joint] + FARTHEST)
            targets[joint] = min(max(self._targets[name][joint] + float(change), low), max(low, high))
        return targets

    def _reached(self, name: str, values: Array) -> dict[str, float]:
        """Return the joint targets [rad or m] for a hand pose or a change of it."""
        arm, robot, given = self._arms[name], self.robots[name], self._space.frame
        X_WB, turn = arm.robot.X_WB, rotation_quat(values[3:], self._space.rotation)
        if self._space.kind is ActionKind.HAND_POSE:
            X_FT = Pose.of(values[:3], turn)
            X_WT = X_WB @ X_FT if given is HandFrame.BASE else X_FT
        else:
            X_WT = self._shifted(name, values[:3], turn)
        self._hands[name] = X_WT
        near = np.array([self._targets[name][joint] for joint in robot.joints])
        q, _ = arm.approach(X_WT, near, HAND_NEAR, HAND_TURNED)
        return dict(zip(robot.joints, q.tolist(), strict=True))

    def _shifted(self, name: str, shift: Array, turn: Array) -> Pose:
        """Return the next target of a hand in the world, close enough to the hand."""
        before, now = self._hands[name], self.robots[name].frame("hand")
        axes = {
            HandFrame.BASE: self._arms[name].robot.X_WB,
            HandFrame.WORLD: Pose.of(),
            HandFrame.HAND: before,
        }[self._space.frame]
        R_WF = Pose.of(q=axes.q)
        R_WT = R_WF @ Pose.of(q=turn) @ R_WF.inverse() @ Pose.of(q=before.q)
        ahead = before.p + R_WF.apply(shift) - now.p
        R_HT = Pose.of(q=now.q).inverse() @ R_WT
        vector = rotation_numbers(R_HT.q, RotationForm.ROTVEC)
        angle, distance = float(np.linalg.norm(vector)), float(np.linalg.norm(ahead))
        p = now.p + ahead * min(1.0, HAND_AHEAD / max(distance, HAND_AHEAD))
        if angle > HAND_TURN:
            R_WT = Pose.of(q=now.q) @ Pose.of(q=rotation_quat(vector * (HAND_TURN / angle), RotationForm.ROTVEC))
        return Pose.of(p, R_WT.q)


def _arm(scene: Scene, name: str) -> Arm:
    """Return the arm of a robot for inverse kinematics, which is in an extra."""
    from simfoundry.robots.arm import Arm

    need_extra("expert", "an action space for the hand")
    return Arm(scene.robot(name))
