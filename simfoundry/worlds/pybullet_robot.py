"""A robot in PyBullet."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from simfoundry.geometry.frames import Pose, from_xyzw
from simfoundry.scene.robot import Gripper
from simfoundry.worlds.robot import unknown_joint

Call = Callable[..., Any]
"""A PyBullet function called by name for one client, or a loader function that commands a motor."""


class PybulletRobotHandle:
    """A :class:`~simfoundry.worlds.robot.WorldRobot` for PyBullet; targets are those of its position motors.

    ``facts`` is the robot's entry in ``world.json``.
    """

    def __init__(self, call: Call, hold: Call, press: Call, name: str, body: int, facts: Mapping[str, Any]) -> None:
        self._call, self._hold, self._name, self._body, self._facts = call, hold, name, body, facts
        self._press = press
        self._targets = {joint: motor["target"] for joint, motor in facts["motors"].items()}
        self._servos = [joint for joint, motor in facts["motors"].items() if "stiffness" in motor]
        infos = [call("getJointInfo", body, k) for k in range(call("getNumJoints", body))]
        self._index = {info[1].decode(): k for k, info in enumerate(infos)}
        self._limits = {info[1].decode(): (float(info[8]), float(info[9])) for info in infos}
        self._links = {info[12].decode(): k for k, info in enumerate(infos)}
        self._links[call("getBodyInfo", body)[0].decode()] = -1
        self._gripper = Gripper({}, {n: tuple(pair) for n, pair in facts["gripper"].items()}, facts["follow"])

    @property
    def joints(self) -> tuple[str, ...]:
        """The names of the arm's joints in the scene, in order."""
        return tuple(self._facts["arm"])

    def positions(self) -> dict[str, float]:
        """Return the positions of the arm's joints [rad or m]."""
        return {name: self._position(joint) for name, joint in self._facts["arm"].items()}

    def _position(self, joint: str) -> float:
        return float(self._call("getJointState", self._body, self._index[joint])[0])

    def limits(self) -> dict[str, tuple[float, float]]:
        """Return the position limits of the arm's joints [rad or m]; infinite if there are none."""
        found = {name: self._limits[joint] for name, joint in self._facts["arm"].items()}
        return {name: pair if pair[0] <= pair[1] else (-math.inf, math.inf) for name, pair in found.items()}

    def set_targets(self, targets: Mapping[str, float]) -> None:
        """Set target positions of arm joints [rad or m]; raise a KeyError for a joint that the robot does not have."""
        for name, target in targets.items():
            if name not in self._facts["arm"]:
                raise unknown_joint(self._name, name, self.joints)
            self._drive(self._facts["arm"][name], target)

    def _drive(self, joint: str, target: float) -> None:
        low, high = self._limits[joint]
        if low <= high:
            target = min(max(target, low), high)
        self._targets[joint] = target
        self._hold(self._body, self._index[joint], self._facts["motors"][joint], target)

    def press(self) -> None:
        """Limit the force of each gripper servo to that of its spring; call this before every step."""
        for joint in self._servos:
            self._press(self._body, self._index[joint], self._facts["motors"][joint], self._targets[joint])

    def gripper(self) -> float:
        """Return the closed share of the gripper, from 0 (open) to 1 (closed)."""
        if not self._gripper.joints:
            return 0.0
        return self._gripper.closed(self._position(next(iter(self._gripper.joints))))

    def set_gripper(self, closed: float) -> None:
        """Set the target of the gripper: 0 is open, 1 is closed."""
        share = min(max(closed, 0.0), 1.0)
        for joint, (start, end) in self._gripper.joints.items():
            if joint in self._facts["motors"]:
                self._drive(joint, start + share * (end - start))

    def frame(self, name: str) -> Pose:
        """Return the pose in the world of a frame, or of a link by model name; a KeyError lists the valid links."""
        known = self._facts["frames"].get(name)
        link = known["link"] if known is not None else name
        if link not in self._links:
            raise KeyError(f"robot {self._name!r} has no link {link!r}; there are: {', '.join(self._links)}")
        X_LF = Pose.of(known["p"], known["q_wxyz"]) if known is not None else Pose.of()
        return self._link_pose(self._links[link]) @ X_LF

    def _link_pose(self, index: int) -> Pose:
        p, q = self._call("getDynamicsInfo", self._body, index)[3:5]
        X_LI = Pose.of(p, from_xyzw(q))
        if index == -1:
            p, q = self._call("getBasePositionAndOrientation", self._body)
        else:
            p, q = self._call("getLinkState", self._body, index, computeForwardKinematics=True)[:2]
        return Pose.of(p, from_xyzw(q)) @ X_LI.inverse()

    @property
    def moving(self) -> tuple[str, ...]:
        """The names of all movable joints in the model."""
        return tuple(self._facts["joints"])

    def model_positions(self) -> dict[str, float]:
        """Return the positions of all movable joints [rad or m], by the model's names."""
        names = self.moving
        states = self._call("getJointStates", self._body, [self._index[name] for name in names])
        return {name: float(state[0]) for name, state in zip(names, states, strict=True)}

    def reset(self, positions: Mapping[str, float] | None = None) -> None:
        """Reset to the scene's joint positions, or to ``positions`` [rad or m] by the model's names, at rest.

        The motors hold these positions, and mimic joints are set from their leaders.
        """
        given = dict(positions or {})
        for joint, follow in self._gripper.follow.items():
            if follow["joint"] in given:  # type: ignore[index]
                given.setdefault(joint, follow["multiplier"] * given[follow["joint"]] + follow["offset"])  # type: ignore[index]
        for name, position in self._facts["joints"].items():
            self._call("resetJointState", self._body, self._index[name], given.get(name, position), 0.0)
        for name, motor in self._facts["motors"].items():
            self._drive(name, given.get(name, motor["target"]))

    def halt(self) -> None:
        """Set the velocities of the robot's joints to zero."""
        for name in self._facts["joints"]:
            self._call("resetJointState", self._body, self._index[name], self._position(name), 0.0)
