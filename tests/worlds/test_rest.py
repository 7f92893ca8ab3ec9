"""Two seconds of dynamics tell what stays from what does not, from any state."""

from __future__ import annotations

import pytest

from simfoundry.scene.model import Scene
from simfoundry.scene.state import SceneState
from simfoundry.worlds import open_world, world_names
from simfoundry.worlds.rest import ObjectMotion, simulate
from tests.scenes import box, pose, scene_of, solid


def table_and_block(x: float) -> Scene:
    table = solid("table", box(0.6, 0.6, 0.04), pose(0, 0, -0.02), fixed=True)
    return scene_of(table, solid("block", box(0.05, 0.1, 0.2), pose(x, 0.02, 0.1, yaw=0.1)))


@pytest.fixture(params=sorted(world_names()))
def engine(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    if name == "pybullet":
        pytest.importorskip("pybullet", reason="PyBullet is not installed")
    return name


def test_what_stands_stays_and_what_leans_out_leaves(engine: str) -> None:
    with open_world(table_and_block(0.28), engine) as world:
        (standing,) = simulate(world)
    with open_world(table_and_block(0.305), engine) as world:
        (leaving,) = simulate(world)
    assert (standing.name, standing.stays) == ("block", True)
    assert not leaving.stays and leaving.moved > 0.3


def test_a_run_starts_from_the_state_that_is_asked_for(engine: str) -> None:
    scene = table_and_block(0.1)
    leaning_out = SceneState.of({"block": pose(0.305, 0.02, 0.1, yaw=0.1)}, {})
    with open_world(scene, engine) as world:
        assert not simulate(world, 2.0, leaning_out)[0].stays
        assert simulate(world, 2.0)[0].stays


def test_both_distance_and_turn_count() -> None:
    assert ObjectMotion("x", 0.0099, 4.9).stays
    assert not ObjectMotion("x", 0.0101, 0.0).stays
    assert not ObjectMotion("x", 0.0, 5.1).stays
    assert not ObjectMotion("x", float("nan"), 0.0).stays
