"""The USD backend: valid stages that say what the scene says."""

from __future__ import annotations

import dataclasses
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from simfoundry.backends.features import Fidelity
from simfoundry.backends.names import InvalidSceneError
from simfoundry.backends.usd import compile_usd
from simfoundry.geometry.frames import frozen_array
from simfoundry.geometry.shapes import Mesh, Sphere
from simfoundry.scene.model import (
    Scene,
    Visual,
)
from tests.backends.usd_stages import ROOT, SCENES, open_stage, validation_errors, written
from tests.scenes import full_scene, pose, rgba, scene_of, solid, textured_object

if TYPE_CHECKING:
    from pxr import Usd


def test_every_validator_of_usd_accepts_the_stage(compiled: tuple[Scene, Usd.Stage]) -> None:
    assert validation_errors(compiled[1]) == []


def test_validation_would_see_a_wrong_stage(folders: dict[str, Path], tmp_path: Path) -> None:
    from pxr import UsdPhysics

    stage = open_stage(shutil.copytree(folders["fan"], tmp_path / "fan"))
    UsdPhysics.ArticulationRootAPI.Apply(stage.GetPrimAtPath("/World/Objects/fan"))
    assert any("NestedArticulation" in error for error in validation_errors(stage))


def test_stage_metadata_gravity_and_relations(compiled: tuple[Scene, Usd.Stage]) -> None:
    from pxr import UsdGeom, UsdPhysics

    scene, stage = compiled
    assert stage.GetDefaultPrim().GetPath() == "/World"
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdPhysics.GetStageKilogramsPerUnit(stage) == 1.0
    assert not stage.HasAuthoredTimeCodeRange()
    physics = UsdPhysics.Scene(stage.GetPrimAtPath("/World/Physics"))
    direction = np.array(physics.GetGravityDirectionAttr().Get(), dtype=np.float64)
    np.testing.assert_allclose(direction * physics.GetGravityMagnitudeAttr().Get(), scene.gravity, atol=1e-6)
    data = stage.GetDefaultPrim().GetCustomDataByKey("simfoundry")
    assert (data["name"], list(data["relations"])) == (scene.name, [str(r) for r in scene.relations])


def test_no_gravity_is_no_gravity(tmp_path: Path) -> None:
    stage = written(
        scene_of(solid("ball", Sphere(0.03), pose(0, 0, 1)), gravity=frozen_array([0, 0, 0])), tmp_path / "x"
    )
    assert stage.GetPrimAtPath("/World/Physics").GetAttribute("physics:gravityMagnitude").Get() == 0.0


def test_semantics_label_each_object_with_its_category(full: tuple[Scene, Usd.Stage]) -> None:
    from pxr import UsdSemantics

    scene, stage = full
    for item in scene.objects:
        labels = UsdSemantics.LabelsAPI(stage.GetPrimAtPath(f"/World/Objects/{item.name}"), "category")
        assert list(labels.GetLabelsAttr().Get()) == [item.category]


def test_the_folder_can_be_moved_and_its_loader_runs(folders: dict[str, Path], tmp_path: Path) -> None:
    moved = Path(shutil.copytree(folders["full"], tmp_path / "else where"))
    assert validation_errors(open_stage(moved)) == []
    for path in moved.rglob("*"):
        assert path.is_dir() or not any(p in path.read_bytes() for p in (b"/tmp", b"/home", str(ROOT).encode()))
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY", "PYTHONPATH")}
    run = subprocess.run(
        [sys.executable, "load.py"], cwd=moved, env=environment, capture_output=True, text=True, timeout=60, check=False
    )
    assert (run.returncode, run.stderr) == (0, "")
    assert run.stdout == "scene.usda: 9 objects, 12 rigid bodies, 5 joints\n"


def test_loader_offers_the_surfaces_own_friction(folders: dict[str, Path]) -> None:
    code = (
        "import load; s = load.load(own_friction=True, own_restitution=True); p = s.GetPrimAtPath('/World/Contacts/"
        "friction_0_1_restitution_0_4'); print([round(p.GetAttribute('physics:' + n).Get(), 6) for n in "
        "('staticFriction', 'dynamicFriction', 'restitution')])"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=folders["full"], capture_output=True, text=True, timeout=60, check=True
    )
    assert run.stdout.strip() == "[0.1, 0.1, 0.4]"


def test_same_bytes_in_another_process_with_another_hash_seed() -> None:
    code = "from tests.scenes import full_scene; from simfoundry.backends.usd import compile_usd; import sys; "
    code += "sys.stdout.buffer.write(compile_usd(full_scene()).manifest)"
    for seed in ("1", "77"):
        environment = {**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": str(ROOT)}
        run = subprocess.run(
            [sys.executable, "-c", code], env=environment, cwd=ROOT, capture_output=True, timeout=60, check=True
        )
        assert run.stdout == compile_usd(full_scene()).manifest


def test_losses_are_stated() -> None:
    losses = {loss.path: loss for loss in compile_usd(full_scene()).losses}
    assert sorted(losses) == ["friction", "lamp", "restitution"]
    assert all(loss.fidelity is Fidelity.APPROXIMATED for loss in losses.values())
    assert "0.592 instead of 0.35" in losses["friction"].reason
    frictionless = solid("ball", Sphere(0.03), pose(0, 0, 1), friction=1.0)
    assert compile_usd(scene_of(frictionless)).losses == ()


def test_a_texture_without_coordinates_is_reported_and_left_out() -> None:
    item = textured_object()
    mesh = item.root.visuals[0].geometry
    assert isinstance(mesh, Mesh)
    bare = Visual("skin", dataclasses.replace(mesh, uv=None), rgba(0.5, 0.5, 0.5))
    link = dataclasses.replace(item.root, visuals=(bare,))
    artifact = compile_usd(scene_of(dataclasses.replace(item, links=(link,))))
    dropped = [loss.path for loss in artifact.losses if loss.fidelity is Fidelity.DROPPED]
    assert dropped == ["wedge.body.skin.texture"]
    assert not any(path.endswith(".png") for path in artifact.files)


def test_two_objects_of_one_name_are_refused() -> None:
    ball = solid("ball", Sphere(0.03), pose(0, 0, 1))
    with pytest.raises(InvalidSceneError, match="ball"):
        compile_usd(scene_of(ball, ball))


def hundred_objects() -> Scene:
    """A hundred free objects in a grid, each one of the four kinds of shape, a third of them meshes."""
    shapes = [solid("x", Sphere(0.03), pose(0, 0, 0)), textured_object(), SCENES["primitives"].object("can")]
    items = []
    for k in range(100):
        X_WO = pose(0.2 * (k % 10), 0.2 * (k // 10), 0.5, 0.1 * k, 0.2, -0.03 * k)
        items.append(dataclasses.replace(shapes[k % 3], name=f"item_{k}", X_WO=X_WO))
    return scene_of(*items)
