"""What a motor feels is what MuJoCo's mass matrix says."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from simfoundry.scene.kinematics import effective_inertias, trees
from simfoundry.scene.model import SceneObject
from simfoundry.worlds.mujoco_world import MujocoWorld
from tests.mechanisms import chain, gripper, pendulum, pot
from tests.scenes import cabinet, fan, pose, scene_of


@pytest.mark.parametrize(
    "item",
    [cabinet(), cabinet(fixed=False), fan(), gripper(), chain(4), pendulum(pose(0, 0, 0, 0.3)), pot(), pot(True)],
)
def test_it_agrees_with_mujoco(item: SceneObject) -> None:
    with MujocoWorld(scene_of(item)) as world:
        inverse = np.zeros((world.model.nv, world.model.nv))
        mujoco.mj_solveM(world.model, world.data, inverse, np.eye(world.model.nv))
        felt = 1 / np.diag(inverse)
        found = {name: value for tree in trees(item) for name, value in effective_inertias(tree).items()}
        assert set(found) == {joint.name for joint in item.joints if joint.has_axis}
        for name, value in found.items():
            dof = int(world.model.joint(f"{item.name}.{name}").dofadr[0])
            assert value == pytest.approx(felt[dof], rel=1e-9)
