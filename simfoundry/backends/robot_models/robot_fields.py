"""What is said of a robot beside its model, so that importing what was compiled gives the robot back, not a machine."""

from __future__ import annotations

from simfoundry.scene.robot import FILES_ONLY, Robot


def robot_words(robot: Robot) -> dict[str, object] | None:
    """The fields of the robot in a scene document, but for its pose; None for one that is known by its files alone."""
    if robot.kind == FILES_ONLY:
        return None
    sizes = {"reach": robot.reach, "opening": robot.opening}
    words: dict[str, object] = {"model": robot.kind, "joints": dict(robot.positions)}
    return words | {name: value for name, value in sizes.items() if value is not None}
