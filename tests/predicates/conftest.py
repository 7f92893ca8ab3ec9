"""Scenes of boxes and of the project's own assets, and a state of them that is easily changed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from simfoundry.geometry.frames import Pose, quat_from_rpy
from simfoundry.predicates import Judge
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene
from simfoundry.scene.state import SceneState
from tests.conftest import REPOSITORY

BOXES = """\
simfoundry: scene/1
name: boxes
materials: {wood: {density: 500}}
objects:
  desk: {fixed: true, shape: {box: [1, 1, 0.04]}, material: wood, pose: {xyz: [0, 0, -0.02]}}
  a: {shape: {box: [0.04, 0.06, 0.02]}, material: wood, pose: {xyz: [0.3, 0, 0.01]}}
  b: {shape: {box: [0.1, 0.08, 0.05]}, material: wood, pose: {xyz: [0, 0, 0.025]}}
"""


def posed(x: float, y: float, z: float, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> Pose:
    """A pose from a position [m] and fixed-axis angles [rad]."""
    return Pose.of([x, y, z], quat_from_rpy(roll, pitch, yaw))


def changed(
    state: SceneState,
    joints: dict[str, float] | None = None,
    speeds: dict[str, float] | None = None,
    *,
    poses: Mapping[str, Pose] | None = None,
    **more: Pose,
) -> SceneState:
    """The state with other poses, joints or speeds."""
    return SceneState.of(
        {**state.poses, **(poses or {}), **more},
        {**state.joints, **(joints or {})},
        state.motions,
        state.robots,
        speeds or state.speeds,
    )


class Setting:
    """A scene, its judge and its state at the start."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.judge, self.start = scene, Judge(scene), SceneState.initial(scene)

    def margin(self, condition: str, **change: Pose) -> float:
        """The margin after a change of poses."""
        return self.judge(condition, changed(self.start, poses=change)).margin


@pytest.fixture(scope="session")
def boxes(tmp_path_factory: pytest.TempPathFactory) -> Setting:
    """A box ``a`` of 4 x 6 x 2 cm and a box ``b`` of 10 x 8 x 5 cm on a desk."""
    file = tmp_path_factory.mktemp("boxes") / "boxes.scene.yaml"
    file.write_text(BOXES)
    return Setting(lower_file(file))


@pytest.fixture(scope="session")
def setting() -> Callable[[str], Setting]:
    """A scene of ``specs/scenes``, each lowered once."""
    known: dict[str, Setting] = {}

    def found(name: str) -> Setting:
        if name not in known:
            known[name] = Setting(lower_file(Path(REPOSITORY) / "specs" / "scenes" / f"{name}.scene.yaml"))
        return known[name]

    return found


BOWL = """\
simfoundry: scene/1
name: bowl
materials: {ceramic: {density: 2400}}
objects:
  desk: {fixed: true, shape: {box: [1, 1, 0.04]}, material: ceramic, pose: {xyz: [0, 0, -0.02]}}
  bowl:
    shape: {lathe: {profile: [[0, 0], [0.035, 0], [0.08, 0.06], [0.076, 0.06], [0.033, 0.006], [0, 0.006]]}}
    material: ceramic
    pose: {xyz: [0.1, 0.05, 0]}
  ball: {shape: {sphere: 0.034}, material: ceramic, pose: {xyz: [0.4, 0, 0.034]}}
"""


@pytest.fixture(scope="session")
def bowl(tmp_path_factory: pytest.TempPathFactory) -> Setting:
    """A bowl of 6 cm height and a ball."""
    file = tmp_path_factory.mktemp("bowl") / "bowl.scene.yaml"
    file.write_text(BOWL)
    return Setting(lower_file(file))
