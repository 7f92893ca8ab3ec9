"""Robots as objects that can be shown. Their models take seconds to read, so each is read once."""

from __future__ import annotations

from simfoundry.backends.robot_models.mujoco_robot import RobotModelError, read_robot
from simfoundry.backends.robot_models.robot_object import as_object
from simfoundry.scene.model import SceneObject
from simfoundry.scene.robot import Robot, mujoco_model
from simfoundry.scene.state import SceneState, object_at


class ShownRobots:
    """The robots that have been read so far."""

    def __init__(self) -> None:
        self._items: dict[int, tuple[Robot, SceneObject | None]] = {}

    def known(self, robots: tuple[Robot, ...]) -> list[SceneObject]:
        """Return the robots that have been read and can be shown."""
        found = (self._items.get(id(robot), (robot, None))[1] for robot in robots)
        return [item for item in found if item is not None]

    def read(self, robots: tuple[Robot, ...]) -> bool:
        """Read the robots that have not been read, and return True if there were any."""
        missing = [robot for robot in robots if id(robot) not in self._items]
        kept = {id(robot) for robot in robots}
        self._items = {key: entry for key, entry in self._items.items() if key in kept}
        for robot in missing:
            self._items[id(robot)] = robot, _item(robot)
        return bool(missing)


def robot_at(item: SceneObject, state: SceneState | None) -> SceneObject:
    """Return a robot at its joint positions in a state, by default those in the document."""
    if state is None or item.name not in state.robots:
        return item
    joints = {f"{item.name}.{joint}": position for joint, position in state.robots[item.name].items()}
    return object_at(item, SceneState.of({item.name: item.X_WO}, joints))


def _item(robot: Robot) -> SceneObject | None:
    try:
        native = mujoco_model(robot)
        return None if native is None else as_object(robot, read_robot(robot, native, f"{robot.name}.")).item
    except RobotModelError:  # its finding is reported by `check`
        return None
