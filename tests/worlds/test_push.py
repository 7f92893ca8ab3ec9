"""Forces on bodies: the same in all engines, and as Newton's laws say."""

from __future__ import annotations

import textwrap
from pathlib import Path

import numpy as np
import pytest

from simfoundry.scene.lower import lower
from simfoundry.scene.model import Scene
from simfoundry.spec.load import load
from simfoundry.worlds import open_world

SCENE = """\
simfoundry: scene/1
name: space
gravity: [0, 0, 0]
objects:
  block:
    shape: {box: [0.2, 0.1, 0.06]}
    mass: 2.0
    pose: {xyz: [0.3, -0.2, 0.5], yaw_deg: 30}
"""


@pytest.fixture
def space(tmp_path: Path) -> Scene:
    """A block without gravity."""
    path = tmp_path / "space.scene.yaml"
    path.write_text(textwrap.dedent(SCENE))
    return lower(load(path))


@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_a_force_accelerates_by_its_mass(space: Scene, engine: str) -> None:
    pytest.importorskip(engine)
    with open_world(space, engine) as world:
        center = np.array([0.3, -0.2, 0.5])
        force, seconds = np.array([4.0, -2.0, 1.0]), 0.1
        steps = round(seconds / world.timestep)
        world.push("block", force / 2, center)
        world.push("block", force / 2, center)  # forces add up
        world.step(steps)
        moved = world.state().poses["block"].p - center
        assert moved == pytest.approx(force / 2.0 * seconds**2 / 2, rel=0.06)
        before = world.state().poses["block"].p
        world.step(steps)  # the force has ended, so that the speed stays
        speed = (world.state().poses["block"].p - before) / seconds
        assert speed == pytest.approx(force / 2.0 * seconds, rel=0.06)


@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_a_force_beside_the_center_turns(space: Scene, engine: str) -> None:
    pytest.importorskip(engine)
    with open_world(space, engine) as world:
        start = world.state().poses["block"]
        world.push("block", np.array([0.0, 0.2, 0.0]), start.p + np.array([0.05, 0.0, 0.0]))
        world.step(round(0.1 / world.timestep))
        end = world.state().poses["block"]
        turned = (end.rotation @ start.rotation.T - np.eye(3))[1, 0]  # the sine of the angle about z
        inertia = 2.0 * (0.2**2 + 0.1**2) / 12
        assert turned == pytest.approx(0.05 * 0.2 / inertia * 0.1**2 / 2, rel=0.06)
        world.push("block", np.array([9.0, 0.0, 0.0]), start.p)
        world.reset()
        world.step(10)  # a force that was not used ends with a reset
        assert world.state().poses["block"].p == pytest.approx(start.p, abs=1e-9)
        with pytest.raises(KeyError):
            world.push("brick", np.zeros(3), np.zeros(3))
