"""The factors of a robot's gains in the files of each backend, and that they come back from them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simfoundry.backends import compile_scene
from simfoundry.backends.pybullet import BULLET_GAIN
from simfoundry.scene.lower import lower
from simfoundry.scene.model import Scene
from simfoundry.spec.load import load
from simfoundry.worlds.mujoco_world import MujocoWorld
from tests.cli.command import run

SCENE = """\
simfoundry: scene/1
name: gains
objects: {desk: {fixed: true, shape: {box: [1, 1, 0.04]}, density: 500, pose: {xyz: [0.5, 0, -0.02]}}}
robots: {arm: {model: demo_arm, gains: {stiffness: 0.4, damping: 1.5}}}
"""


def lowered(folder: Path, text: str) -> Scene:
    path = folder / "gains.scene.yaml"
    path.write_text(text)
    return lower(load(path))


def gains(world: MujocoWorld) -> dict[str, Any]:
    """The gains and biases of the servos by name, and the damping of all joints."""
    model = world.model
    servos = {
        model.actuator(k).name: (model.actuator_gainprm[k][0], *model.actuator_biasprm[k][:3]) for k in range(model.nu)
    }
    return {"servos": servos, "damping": np.ravel(model.dof_damping)}


def test_the_servos_of_the_arm_are_scaled_and_those_of_the_gripper_are_not(tmp_path: Path) -> None:
    plain, own = (
        lowered(tmp_path, SCENE.replace(", gains: {stiffness: 0.4, damping: 1.5}", "")),
        lowered(tmp_path, SCENE),
    )
    with MujocoWorld(plain) as one, MujocoWorld(own) as other:
        before, after = gains(one), gains(other)
        assert len(before["servos"]) == 8
        for name, (gain, constant, spring, damping) in before["servos"].items():
            s, d = (1.0, 1.0) if "gripper" in name else (0.4, 1.5)
            wanted = (gain * s, constant * s, spring * s, damping * d)
            assert after["servos"][name] == pytest.approx(wanted, rel=1e-5), name
        ratio = after["damping"] / np.where(before["damping"] > 0, before["damping"], 1)
        assert sorted(set(np.round(ratio[before["damping"] > 0], 6))) in ([1.0, 1.5], [1.5])
        assert other.robot("arm").positions() == pytest.approx(one.robot("arm").positions())
        other.step(500)  # the targets stay where they are
        assert other.robot("arm").positions() == pytest.approx(one.robot("arm").positions(), abs=0.05)


@pytest.mark.parametrize("target", ["mjcf", "usd"])
def test_gains_come_back_from_compiled_files(tmp_path: Path, target: str) -> None:
    lowered(tmp_path, SCENE)
    done = run("compile", tmp_path / "gains.scene.yaml", "-t", target, "-o", tmp_path / "build", "--json")
    entry = json.loads(done.out)["targets"][target]
    assert run("import", entry, "-o", tmp_path / "back.scene.yaml").code == 0
    again = lowered(tmp_path, (tmp_path / "back.scene.yaml").read_text()).robot("arm")
    assert (again.kind, again.stiffness, again.damping) == ("demo_arm", 0.4, 1.5)


def test_the_drives_on_a_stage_are_scaled(tmp_path: Path) -> None:
    def drives(scene: Scene) -> dict[str, tuple[float, float]]:
        from pxr import Sdf, Usd, UsdPhysics

        layer = Sdf.Layer.CreateAnonymous(".usda")
        layer.ImportFromString(compile_scene(scene, "usd").files["scene.usda"].decode())
        stage = Usd.Stage.Open(layer)
        found = {}
        for prim in stage.Traverse():
            for kind in ("angular", "linear"):
                if drive := UsdPhysics.DriveAPI.Get(prim, kind):
                    found[prim.GetName()] = (drive.GetStiffnessAttr().Get(), drive.GetDampingAttr().Get())
        return found

    plain, own = (
        lowered(tmp_path, SCENE.replace(", gains: {stiffness: 0.4, damping: 1.5}", "")),
        lowered(tmp_path, SCENE),
    )
    before, after = drives(plain), drives(own)
    for k in range(1, 8):
        stiffness, damping = before[f"joint{k}"]
        assert after[f"joint{k}"] == pytest.approx((0.4 * stiffness, 1.5 * damping), rel=1e-4)


def test_a_urdf_gets_the_ratio_and_the_report_says_so(tmp_path: Path) -> None:
    pytest.importorskip("pybullet_data")
    text = SCENE.replace("model: demo_arm", "model: {urdf: pkg:pybullet_data/kuka_iiwa/model.urdf}")
    artifact = compile_scene(lowered(tmp_path, text), "pybullet")
    motors = json.loads(artifact.files["world.json"])["robots"]["arm"]["motors"]
    assert [motor["gain"] for motor in motors.values()] == [pytest.approx(BULLET_GAIN * 0.4 / 1.5)] * 7
    reasons = [loss.reason for loss in artifact.losses if loss.feature == "robot_motors"]
    assert len(reasons) == 1 and "only the ratio of stiffness and damping acts" in reasons[0]
