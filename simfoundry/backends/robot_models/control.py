"""Check that a robot can act in rollouts: that it has a hand, and a position actuator for each joint of its arm."""

from __future__ import annotations

from typing import Any

from simfoundry.backends.robot_models.mujoco_robot import MujocoRobot, RobotModelError, body_name, read_robot
from simfoundry.scene.robot import Robot, mujoco_model

_FORM, _NAMED = "the format is described in docs/robots.md, *Your own models*", "model: {file: my_arm.yaml}"


def check_can_act(robot: Robot) -> None:
    """Check that a robot's model has an identifiable hand and a position actuator for each arm joint.

    Observations and actions are defined in terms of the hand and these actuators.

    Raises:
        RobotModelError: If the hand cannot be identified or a joint has no position actuator.
    """
    native = mujoco_model(robot)
    if native is None:
        raise RobotModelError(
            f"robot `{robot.name}` has only a USD model; rollouts need its hand and joints from an "
            "MJCF or URDF model, so add one"
        )
    read = read_robot(robot, native, f"{robot.name}.")
    try:
        body_name(read, "hand")
    except RobotModelError as error:
        links = f"`links: {{hand: {{link: {_leaf(read)}}}}}`"
        fix = f"name it in a robot file, such as {links}, and name that file in the scene, such as `{_NAMED}`; {_FORM}"
        raise RobotModelError(f"robot `{robot.name}` has no identifiable hand: {error}; {fix}") from None
    driven = _driven(read)
    for joint in native.joints.values() or [_own(read, read.model.joint(k)) for k in range(read.model.njnt)]:
        if joint not in driven:
            missing = f"no position actuator in {native.file.name} drives its joint `{joint}`"
            fix = f"add one, or list the arm's joints under `joints` in a robot file; {_FORM}"
            raise RobotModelError(f"robot `{robot.name}` cannot be position-controlled: {missing}; {fix}")


def _leaf(read: MujocoRobot) -> str:
    """Return the link farthest down the kinematic chain, which is usually the hand."""
    depth = [0]
    for parent in read.model.body_parentid[1:]:
        depth.append(depth[parent] + 1)
    return _own(read, read.model.body(depth.index(max(depth))))


def _own(read: MujocoRobot, named: Any) -> str:
    """Return the name of a body or joint within the robot model.

    This is the name without the prefix that the scene adds.
    """
    return str(named.name.removeprefix(read.prefix))


def _driven(read: MujocoRobot) -> set[str]:
    """Return the names of the joints in the model that are driven by a position actuator."""
    import mujoco

    model = read.model
    pulls = (model.actuator_gainprm[:, 0] != 0) & (model.actuator_biasprm[:, 1] < 0)
    driven = model.actuator_trnid[pulls & (model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT)), 0]
    return {_own(read, model.joint(int(joint))) for joint in driven}
