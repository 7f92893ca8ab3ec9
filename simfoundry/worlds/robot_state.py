"""Robot joint positions in a state, which refer to the joints of the canonical model rather than the engine's model."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

from simfoundry.backends.robot_models.mujoco_robot import RobotModelError, read_robot
from simfoundry.backends.robot_models.robot_object import joint_names
from simfoundry.scene.model import Scene
from simfoundry.scene.robot import Gripper, ModelFormat, NativeModel, Robot, mujoco_model
from simfoundry.scene.state import SceneState


class Row(NamedTuple):
    """A linear relation between the positions [rad or m] of a joint in the canonical model and a joint in an engine.

    The position of the canonical ``joint`` is ``scale`` times the position of the engine's joint ``other``, plus
    ``offset``.
    """

    joint: str
    other: str
    scale: float = 1.0
    offset: float = 0.0


Rows = tuple[Row, ...]


def mjcf_rows(robot: Robot) -> Rows:
    """Return the rows for MuJoCo's model, which is the canonical model.

    If there is no such model, there are no rows.
    """
    native = mujoco_model(robot)
    return () if native is None else tuple(Row(joint, other) for other, joint in _names(robot, native).items())


def urdf_rows(robot: Robot, moving: Iterable[str]) -> Rows:
    """Return the rows for PyBullet's URDF, whose movable joints are ``moving``.

    If the robot has both an MJCF and its own URDF, their arm joints are matched in order, and their gripper joints are
    matched by how far they are closed.
    """
    native, urdf = mujoco_model(robot), robot.best(ModelFormat.URDF)
    if native is None:
        return ()
    names = _names(robot, native)
    if urdf is None:  # a converted URDF uses the canonical names
        return tuple(Row(name, name) for name in names.values() if name in set(moving))
    if urdf is native:
        return tuple(Row(joint, other) for other, joint in names.items() if other in set(moving))
    arm = [Row(names[native.joints.get(n, n)], urdf.joints.get(n, n)) for n in native.joints or urdf.joints]
    if native.gripper is None or urdf.gripper is None:
        return tuple(arm)
    return (*arm, *_gripper(names, native.gripper, urdf.gripper))


def _names(robot: Robot, native: NativeModel) -> dict[str, str]:
    try:
        return joint_names(robot, read_robot(robot, native, f"{robot.name}."))
    except RobotModelError:  # a robot with ball or free joints has no canonical model
        return {}


def _gripper(names: dict[str, str], own: Gripper, other: Gripper) -> Iterator[Row]:
    """Yield the rows for the gripper joints.

    The joints are either matched pairwise or all derived from the other model's first joint.
    """
    theirs = list(other.joints.items())
    if len(theirs) != len(own.joints):
        theirs = theirs[:1] * len(own.joints)
    found = {}
    for (joint, (opened, closed)), (name, (start, end)) in zip(own.joints.items(), theirs, strict=True):
        scale = (closed - opened) / (end - start)
        found[joint] = Row(names[joint], name, scale, opened - scale * start)
    yield from found.values()
    for joint, follow in own.follow.items():
        if joint not in found and follow.joint in found:
            _, name, scale, offset = found[follow.joint]
            yield Row(names[joint], name, follow.multiplier * scale, follow.multiplier * offset + follow.offset)


def positions_of(rows: Rows, at: Mapping[str, float]) -> dict[str, float]:
    """Convert the engine's joint positions to canonical positions [rad or m]."""
    return {row.joint: row.scale * at[row.other] + row.offset for row in rows}


def engine_positions(rows: Rows, canonical: Mapping[str, float]) -> dict[str, float]:
    """Convert canonical joint positions to engine positions [rad or m], using the first row for each engine joint."""
    found: dict[str, float] = {}
    for row in rows:
        if row.joint in canonical:
            found.setdefault(row.other, (canonical[row.joint] - row.offset) / row.scale)
    return found


def check_robots(scene: Scene, rows: Mapping[str, Rows], state: SceneState | None) -> None:
    """Check that a state contains only robots and robot joints that are in the scene.

    Raises:
        KeyError: If the state contains any other robot or robot joint.
    """
    for name, joints in state.robots.items() if state is not None else ():
        scene.robot(name)
        known = [row.joint for row in rows.get(name, ())]
        unknown = sorted(set(joints) - set(known))
        if unknown and known:
            raise unknown_joint(name, unknown[0], known)


def unknown_joint(robot: str, joint: str, known: Iterable[str]) -> KeyError:
    """Return the error for an unknown joint of a robot."""
    return KeyError(f"robot {robot!r} has no joint {joint!r}; available joints: {', '.join(known)}")
