"""Furniture from two captures in every target: what is written, what engines hold, and joints that open and close."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import simfoundry as sf
from simfoundry.capture.articulation.run import articulate
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Joint, JointType, SceneObject
from simfoundry.targets.find import target_names
from simfoundry.worlds.base import World
from tests.capture.furniture import Captured, captured
from tests.capture.test_articulation import WIDTH, errors
from tests.cli.command import run

pytestmark = pytest.mark.slow  # 20 s: three pieces of furniture, compiled for all targets

SCENE = """simfoundry: scene/1
name: room
objects:
  floor: {fixed: true, mass: 20, shape: {box: [2, 2, 0.04]}, pose: {xyz: [0, 0, -0.02]}}
  thing: {asset: thing.asset.yaml, fixed: true, pose: {xyz: [0.3, -0.2, 0], yaw_deg: 25}}
"""

# Force on a part [N]: above the weight of a lid, and about what a hand opens a drawer with.
FORCE = 12.0

# Distance from an end of the range at which a joint has reached it [m or rad], and the time that it may take [s].
AT_END, PATIENCE_S = 0.01, 4.0


@dataclass(frozen=True, eq=False)
class Made:
    """An asset that was made from captures, in a scene."""

    truth: Captured
    scene: Path
    item: SceneObject

    @property
    def joint(self) -> Joint:
        return self.item.joints[0]


@pytest.fixture(scope="module", params=[("drawer", 5000), ("door", 5001), ("lid", 5003)], ids=lambda each: each[0])
def made(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Made:
    kind, seed = request.param
    folder = tmp_path_factory.mktemp(kind)
    truth = captured(folder, kind, seed, WIDTH)
    found = articulate(truth.shut, [truth.opened], folder / "thing.asset.yaml")
    angle, aside = errors(found, truth)
    assert found.estimate.motion.kind == truth.furniture.type and angle < 2 and aside < 0.02
    scene = folder / "room.scene.yaml"
    scene.write_text(SCENE)
    document = sf.load(scene)
    assert document.check() == []
    return Made(truth, scene, document.lower().object("thing"))


def test_every_target_keeps_the_joint_and_the_masses(made: Made, tmp_path: Path) -> None:
    targets = target_names()
    assert len(targets) >= 12
    options = [option for target in targets for option in ("-t", target)]
    done = run("compile", made.scene, *options, "-o", tmp_path, "--json")
    assert done.code == 0, done.out + done.err
    built = json.loads((tmp_path / "loss.json").read_text())
    assert set(built) == set(targets)
    for target, report in built.items():
        assert any((tmp_path / target).iterdir())
        for feature in (str(made.joint.type), "joint_limits", "joint_position", "joint_damping", "mass", "inertia"):
            assert set(report["features"][feature]) == {"kept"}, f"{target} does not keep {feature}"


def test_engines_hold_what_the_asset_says(made: Made) -> None:
    engines = [option for name in ("mujoco", "pybullet", "usd") for option in ("--engine", name)]
    done = run("verify", made.scene, *engines, "--no-behaviors", "--json")
    assert done.code == 0, done.out + done.err
    readings = {reading["engine"]: reading for reading in done.json["readings"]}
    assert readings["mujoco"]["verdict"] == "ok" and readings["mujoco"]["compared"] > 50
    for engine, reading in readings.items():
        assert reading["mismatches"] == [] and reading["covered"] == [], engine


@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_it_opens_and_closes(made: Made, engine: str) -> None:
    if engine == "pybullet":
        pytest.importorskip("pybullet", reason="PyBullet is not installed")
    limits = made.joint.limits
    assert limits is not None and limits[0] == 0
    assert limits[1] == pytest.approx(made.truth.furniture.opened, abs=0.06)
    with sf.load(made.scene).open(engine) as world:
        assert abs(world.state().joints["thing.joint"]) < 1e-6
        for sign, goal in ((1.0, limits[1]), (-1.0, limits[0])):
            reached = _pushed(world, made, sign, goal)
            assert abs(reached - goal) < AT_END, f"it jams at {reached:.3f} on the way to {goal:.3f}"
        assert world.trouble() == ""


def _pushed(world: World, made: Made, sign: float, goal: float) -> float:
    """Push a part at its handle or its middle until its joint is at a goal, or time is over; return its position."""
    item, joint = made.item, made.joint
    places = [collider.X_LG.p for link in item.links if link.name == joint.child for collider in link.colliders]
    lever = max(places, key=lambda place: float(np.linalg.norm(np.cross(joint.axis, place))))
    for _ in range(round(PATIENCE_S / world.timestep)):
        q = world.state().joints["thing.joint"]
        if abs(q - goal) < AT_END / 2:
            break
        X_WL = item.X_WO @ link_poses(item, {joint.name: q})[joint.child]
        axis, point = X_WL.rotation @ joint.axis, X_WL.p
        if joint.type is JointType.REVOLUTE:
            point = X_WL.apply(lever[None])[0]
            axis = np.cross(axis, point - X_WL.p)
        world.push(f"thing.{joint.child}", sign * FORCE * axis / np.linalg.norm(axis), point)
        world.step()
    return world.state().joints["thing.joint"]
