"""What changes only pictures changes no state: the rollouts in MuJoCo and PyBullet are the same to the last bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from simfoundry.scene.lower import lower
from simfoundry.scene.model import Scene
from simfoundry.scene.physics import differs_only_in_pictures, physics_digest
from simfoundry.spec.load import load
from simfoundry.worlds import open_world
from tests.cousins.randomization.conftest import Sampler, write

PICTURES = """
light.*.intensity: {uniform: [0.1, 1.2]}
light.key.direction: {cone_deg: 40}
light.lamp.color: {shift: 0.2}
light.lamp.xyz: {shift: 0.3}
camera.far_*.pose: {shift: 0.1, turn_deg: 10}
camera.*.fx: {times: [0.8, 1.2]}
object.tee.shape.compound.*.color: {choose: [white, black]}
object.table.color: {choose: [oak, slate]}
object.cabinet.color: {shift: 0.2}
material.wood.color: {shift: 0.2}
material.wood.texture: {choose: [look/*.png]}
"""

PHYSICS = (
    "object.can.mass: {times: [1.1, 1.2]}", "object.cabinet.friction: {times: [1.1, 1.2]}",
    "material.wood.restitution: {uniform: [0.1, 0.2]}", "cabinet.drawer: {uniform: [0.05, 0.1]}",
    "cabinet.drawer.damping: {times: [2, 3]}", "gravity: {times: [0.98, 0.99]}", "parameter.gap: {shift: [0.01, 0.02]}",
    "object.cube.shape.box: {times: [1.05, 1.1]}", "options.timestep: {choose: [0.001]}",
    "object.brick.pose: {shift: [0.02, 0.02, 0]}",
)  # fmt: skip


def states(scene: Scene, engine: str) -> bytes:
    """The states while everything slides on the table, which the tilted gravity makes a ramp."""
    found = []
    with open_world(scene, engine) as world:
        world.reset()
        for _ in range(40):
            world.step(5)
            state = world.state()
            found += [np.concatenate([state.poses[n].p, state.poses[n].q]) for n in sorted(state.poses)]
            found.append(np.array([state.joints[n] for n in sorted(state.joints)]))
    return np.concatenate(found).tobytes()


@pytest.fixture
def textured(room: Path) -> Path:
    from PIL import Image

    (room / "look").mkdir()
    for name, color in (("a", (200, 100, 50)), ("b", (20, 100, 50))):
        Image.new("RGB", (4, 4), color).save(room / "look" / f"{name}.png")
    return room


def test_cousins_that_differ_only_in_pictures(textured: Path, sampler: Sampler) -> None:
    tilted = (textured / "room.scene.yaml").read_text() + "gravity: [1.5, 0.5, -9.5]\n"
    (textured / "room.scene.yaml").write_text(tilted)
    twin, make = lower(load(textured / "room.scene.yaml")), sampler(PICTURES)
    ones = [make(k) for k in (1, 2)]
    assert all(one.accepted and one.pictures_only for one in ones), [one.reasons for one in ones]
    scenes = [lower(load(write(textured, one)["scene"])) for one in ones]
    assert all(differs_only_in_pictures(twin, scene) for scene in scenes)
    for engine in ("mujoco", "pybullet"):
        known = states(twin, engine)
        assert all(states(scene, engine) == known for scene in scenes), engine


@pytest.mark.parametrize("vary", PHYSICS)
def test_cousins_that_differ_in_their_physics(room: Path, sampler: Sampler, vary: str) -> None:
    make = sampler(vary)
    one = make(1)
    assert one.accepted and not one.pictures_only, one.reasons
    scene = lower(load(write(room, one)["scene"]))
    assert not differs_only_in_pictures(make.twin.scene, scene)


def test_the_viewpoint_is_more_than_a_picture(room: Path, sampler: Sampler) -> None:
    """Left and right are seen from the viewpoint, so the goals and the places that name them depend on it."""
    one = sampler("camera.eye.pose: {shift: 0.05, turn_deg: 5}")(1)
    assert not one.pictures_only
    scene = lower(load(write(room, one)["scene"]))
    assert physics_digest(scene) != physics_digest(lower(load(room / "room.scene.yaml")))


def test_backgrounds(room: Path, sampler: Sampler) -> None:
    (room / "rooms").mkdir()
    for name, size in (("a", 3), ("b", 4)):
        corners = f"v 0 0 0\nv {size} 0 0\nv 0 {size} 0\nv 0 0 {size}\n"
        (room / "rooms" / f"{name}.obj").write_text(corners + "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n")
    with (room / "room.scene.yaml").open("a") as stream:
        stream.write("background: {mesh: rooms/a.obj, pose: {xyz: [0, 0, -9]}}\n")
    make = sampler("background: {choose: [rooms/*.obj]}\nbackground.pose: {shift: [1, 1, 0], yaw_deg: 90}")
    ones = [make(k) for k in range(1, 7)]
    assert {one.vary["background"] for one in ones} == {"rooms/a.obj", "rooms/b.obj"}
    twin = lower(load(room / "room.scene.yaml"))
    for one in ones:
        scene = lower(load(write(room, one)["scene"]))
        assert one.pictures_only and differs_only_in_pictures(twin, scene)
        assert scene.background is not None and scene.background.X_WB.p[2] == -9
