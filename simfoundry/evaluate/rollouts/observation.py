"""Observations of a policy: the robots' state, and images of the requested cameras."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.policies.base import Image, ImageSize, RobotReading
from simfoundry.geometry.frames import frozen_array
from simfoundry.scene.model import Scene
from simfoundry.spec.diagnostics import nearest
from simfoundry.worlds.base import World
from simfoundry.worlds.robot import WorldRobot


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
