"""A robot in MuJoCo."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from simfoundry.geometry.frames import Pose
from simfoundry.scene.robot import Robot, mujoco_model
from simfoundry.worlds.robot import unknown_joint

if TYPE_CHECKING:
    import mujoco


class MujocoRobotHandle:
    """A :class:`~simfoundry.worlds.robot.WorldRobot` for MuJoCo; targets are set in ``data.ctrl``."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, robot: Robot) -> None:
        native = mujoco_model(robot)
        if native is None:
            raise KeyError(f"robot {robot.name!r} has no model that MuJoCo can read")
        self._model, self._data, self._robot, self._native = model, data, robot, native
        self._joints = {name: model.joint(f"{robot.name}.{native.joints.get(name, name)}").id for name in self._names()}
        self._servos = {name: self._servo(joint) for name, joint in self._joints.items()}

    def _names(self) -> tuple[str, ...]:
        if self._native.joints:
            return tuple(self._native.joints)
        start = f"{self._robot.name}."
        every = (self._model.joint(k).name for k in range(self._model.njnt))
        return tuple(name.removeprefix(start) for name in every if name.startswith(start))

    def _servo(self, joint: int) -> int | None:
        """Return the actuator of a joint."""
        import mujoco

        direct = int(mujoco.mjtTrn.mjTRN_JOINT)
        for k in range(self._model.nu):
            if self._model.actuator_trntype[k] == direct and self._model.actuator_trnid[k][0] == joint:
                return k
        return None

    @property
    def joints(self) -> tuple[str, ...]:
        """The names of the arm's joints in the scene, in order."""
        return tuple(self._joints)

    def positions(self) -> dict[str, float]:
        """Return the positions of the arm's joints [rad or m]."""
        return {name: self._position(joint) for name, joint in self._joints.items()}

    def _position(self, joint: int) -> float:
        return float(self._data.qpos[self._model.jnt_qposadr[joint]])

    def limits(self) -> dict[str, tuple[float, float]]:
        """Return the position limits of the arm's joints [rad or m]; infinite if there are none."""
        found = {}
        for name, joint in self._joints.items():
            low, high = self._model.jnt_range[joint] if self._model.jnt_limited[joint] else (-np.inf, np.inf)
            found[name] = (float(low), float(high))
        return found

    def is_driven(self, name: str) -> bool:
        """Return true if an arm joint has an actuator."""
        return self._servos[name] is not None

    def set_targets(self, targets: Mapping[str, float]) -> None:
        """Set target positions of arm joints [rad or m]; raise a KeyError for a joint that the robot does not have."""
        for name, target in targets.items():
            if name not in self._servos:
                raise unknown_joint(self._robot.name, name, self.joints)
            servo = self._servos[name]
            if servo is None:
                raise KeyError(f"joint {name!r} of robot {self._robot.name!r} has no actuator")
            # A servo with gain k applies the force k * ctrl + bias[1] * position; it rests where the two terms cancel.
            gain, spring = self._model.actuator_gainprm[servo][0], self._model.actuator_biasprm[servo][1]
            self._command(servo, target * -spring / gain)

    def _command(self, servo: int, value: float) -> None:
        if self._model.actuator_ctrllimited[servo]:
            value = float(np.clip(value, *self._model.actuator_ctrlrange[servo]))
        self._data.ctrl[servo] = value

    def gripper(self) -> float:
        """Return the closed share of the gripper, from 0 (open) to 1 (closed)."""
        gripper = self._native.gripper
        if gripper is None:
            return 0.0
        first = self._model.joint(f"{self._robot.name}.{next(iter(gripper.joints))}").id
        return gripper.closed(self._position(first))

    def set_gripper(self, closed: float) -> None:
        """Set the target of the gripper: 0 is open, 1 is closed."""
        gripper = self._native.gripper
        if gripper is None:
            return
        share = min(max(closed, 0.0), 1.0)
        led = {} if gripper.command else gripper.follow  # mimic joints have no servo
        for name, (start, end) in (gripper.command or gripper.joints).items():
            if name in led:
                continue
            self._command(self._model.actuator(f"{self._robot.name}.{name}").id, start + share * (end - start))

    def frame(self, name: str) -> Pose:
        """Return the pose in the world of a frame, or of a link by the model's name."""
        import mujoco

        mujoco.mj_kinematics(self._model, self._data)
        frame = self._native.frame(name)
        body = self._model.body(f"{self._robot.name}.{frame.link}").id
        return Pose.of(self._data.xpos[body], self._data.xquat[body]) @ frame.X_LF
