"""Checks that a robot's model has what a rollout needs: a hand and driven joints."""

from __future__ import annotations

from simfoundry.backends.robot_models.mujoco_robot import MujocoRobot, RobotModelError, body_name, read_robot
from simfoundry.scene.robot import Robot, mujoco_model

_FORM = "docs/robots.md, *Models of your own*, has the form"


def check_can_act(robot: Robot) -> None:
    """Raise :class:`RobotModelError` if a robot's model lacks an identifiable hand or an actuator for one of its
    joints.

    Observations and actions are defined in terms of these, so there is no substitute.
    """
    native = mujoco_model(robot)
    if native is None:
        raise RobotModelError(
            f"robot `{robot.name}` has only a USD model; rollouts need its hand and joints from an "
            "MJCF or URDF, so add one"
        )
    read = read_robot(robot, native, f"{robot.name}.")
    try:
        body_name(read, "hand")
    except RobotModelError as error:
        raise RobotModelError(
            f"robot `{robot.name}` has no identifiable hand: {error}; name it in a robot file, such as "
            f"`links: {{hand: {{link: {_leaf(read)}}}}}`, and name that file in the scene, such as "
            f"`model: {{file: my_arm.yaml}}`; {_FORM}"
        ) from None
    driven = _driven(read)
    for joint in native.joints.values() or _moving(read):
        if joint not in driven:
            raise RobotModelError(
                f"robot `{robot.name}` cannot be position-controlled: no position actuator of {native.file.name} "
                f"drives its joint `{joint}`; add one, or list the arm's joints under `joints` in a robot file; {_FORM}"
            )


def _leaf(read: MujocoRobot) -> str:
    """Return the link farthest along the robot, which is most often its hand."""
    depth = [0]
    for body in range(1, read.model.nbody):
        depth.append(depth[int(read.model.body_parentid[body])] + 1)
    deepest = max(range(read.model.nbody), key=lambda body: depth[body])
    return str(read.model.body(deepest).name.removeprefix(read.prefix))


def _moving(read: MujocoRobot) -> list[str]:
    return [read.model.joint(k).name.removeprefix(read.prefix) for k in range(read.model.njnt)]


def _driven(read: MujocoRobot) -> set[str]:
    """Return the joints driven by a position actuator, by the model's names."""
    import mujoco

    model, found = read.model, set()
    for k in range(model.nu):
        pulls = model.actuator_gainprm[k][0] != 0 and model.actuator_biasprm[k][1] < 0
        if pulls and model.actuator_trntype[k] == int(mujoco.mjtTrn.mjTRN_JOINT):
            found.add(model.joint(int(model.actuator_trnid[k][0])).name.removeprefix(read.prefix))
    return found
