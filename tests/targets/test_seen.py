"""What is seen: labels, backgrounds, variants, lights and cameras, in each target that can hold them."""

from __future__ import annotations

import dataclasses
import json
import math
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from simfoundry.assets.errors import MeshError
from simfoundry.backends import compile_scene
from simfoundry.geometry.frames import Pose
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.load import load
from simfoundry.splats.files import read_splat
from simfoundry.targets.compile import compile_target
from simfoundry.targets.find import find_target
from tests.targets.everything import splat_ply, write_everything

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    features = ("background_mesh", "distant_lights", "dome_lights")
    return lower_file(write_everything(tmp_path_factory.mktemp("room"), *features))


@pytest.fixture(scope="module")
def splat(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return lower_file(write_everything(tmp_path_factory.mktemp("splat"), "background_splat"))


def stage_of(scene: Scene, folder: Path) -> Any:
    from pxr import Usd

    compile_scene(scene, "usd").write(folder)
    return Usd.Stage.Open(str(folder / "scene.usda"))


def errors(stage: Any) -> list[str]:
    from pxr import UsdValidation

    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    return [str(e.GetErrorAsString()) for e in UsdValidation.ValidationContext(validators).Validate(stage)]


# -- splats ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_a_splat_is_read_with_its_activations(tmp_path: Path, degree: int) -> None:
    data, raw = splat_ply(5, degree)
    (tmp_path / "a.ply").write_bytes(data)
    found = read_splat(tmp_path / "a.ply", scale=2.0)
    assert found.degree == degree
    k = 3
    np.testing.assert_allclose(found.positions[k], 2 * np.array([raw[n][k] for n in "xyz"]), rtol=1e-6)
    np.testing.assert_allclose(found.scales[k], [2 * math.exp(raw[f"scale_{i}"][k]) for i in range(3)], rtol=1e-6)
    assert found.opacities[k] == pytest.approx(1 / (1 + math.exp(-raw["opacity"][k])), rel=1e-6)
    q = np.array([raw[f"rot_{i}"][k] for i in range(4)])
    np.testing.assert_allclose(found.rotations[k], q / np.linalg.norm(q), rtol=1e-6)
    np.testing.assert_allclose(found.harmonics[k, 0], [raw[f"f_dc_{c}"][k] for c in range(3)], rtol=1e-6)
    rest = (degree + 1) ** 2 - 1
    for order in range(rest):  # the file has all of red, then all of green, then all of blue
        expected = [raw[f"f_rest_{channel * rest + order}"][k] for channel in range(3)]
        np.testing.assert_allclose(found.harmonics[k, 1 + order], expected, rtol=1e-6)


def test_what_is_no_splat_is_told(tmp_path: Path) -> None:
    data, _ = splat_ply(2, 1)
    wrong = {
        "the property `opacity` is missing": data.replace(b"property float opacity", b"property float opaqueness"),
        "has 8 `f_rest` properties": data.replace(b"property float f_rest_8", b"property float g_rest_8"),
        "could not be read as a splat": b"no ply at all",
        "non-finite values": data[:-4] + np.float32(np.nan).tobytes(),
    }
    for words, content in wrong.items():
        (tmp_path / "a.ply").write_bytes(content)
        with pytest.raises(MeshError, match=words):
            read_splat(tmp_path / "a.ply")


def test_a_wrong_background_is_found_at_its_line(tmp_path: Path) -> None:
    path = write_everything(tmp_path, "background_splat")
    (tmp_path / "room.ply").write_bytes(b"ply\n")
    with pytest.raises(SpecError) as caught:
        lower_file(path)
    (finding,) = caught.value.diagnostics
    assert (finding.code, finding.path) == ("SF301", "background.splat")
    assert path.read_text().splitlines()[finding.line - 1].startswith("background:")


def test_usd_holds_a_splat_as_a_particle_field(splat: Scene, tmp_path: Path) -> None:
    from pxr import UsdGeom, UsdVol

    stage = stage_of(splat, tmp_path)
    assert errors(stage) == []
    prim = stage.GetPrimAtPath("/World/Background/splat")
    assert prim.IsA(UsdVol.ParticleField3DGaussianSplat)
    assert splat.background is not None and splat.background.splat is not None
    field = splat.background.splat
    np.testing.assert_array_equal(np.array(prim.GetAttribute("positions").Get()), field.positions)
    np.testing.assert_array_equal(np.array(prim.GetAttribute("opacities").Get()), field.opacities)
    orientation = prim.GetAttribute("orientations").Get()[2]
    np.testing.assert_allclose([orientation.real, *orientation.imaginary], field.rotations[2], rtol=1e-6)
    assert prim.GetAttribute("radiance:sphericalHarmonicsDegree").Get() == 1
    colors = np.array(prim.GetAttribute("radiance:sphericalHarmonicsCoefficients").Get())
    np.testing.assert_array_equal(colors.reshape(-1, 4, 3), field.harmonics)
    posed = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(0)).T
    np.testing.assert_allclose(posed, Pose.of([1, 2, 0], [math.cos(math.pi / 12), 0, 0, math.sin(math.pi / 12)]).matrix)


BUILD = """
import hashlib, sys
from pathlib import Path
from simfoundry.backends import compile_scene
from simfoundry.scene.lower import lower_file
sys.stdout.write(compile_scene(lower_file(Path(sys.argv[1])), "usd").manifest.decode())
"""


def test_a_splat_gives_the_same_bytes_in_another_process(tmp_path: Path) -> None:
    path = write_everything(tmp_path, "background_splat")
    command = [sys.executable, "-c", BUILD, str(path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True, timeout=120)
    manifest = compile_scene(lower_file(path), "usd").manifest.decode()
    assert done.stdout == manifest and "assets/background.usdc" in manifest


# -- meshes around the scene ----------------------------------------------------------------------------------------


def test_a_background_mesh_is_seen_and_touches_nothing_in_mujoco(room: Scene) -> None:
    files = compile_scene(room, "mjcf").files
    assets = {path: data for path, data in files.items() if path.startswith("assets/")}
    assets["contacts.xml"] = files["contacts.xml"]
    model = mujoco.MjModel.from_xml_string(files["scene.xml"].decode(), assets)
    geom = model.geom(":background:mesh")
    assert (geom.bodyid[0], geom.contype[0], geom.conaffinity[0]) == (0, 0, 0)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mesh = model.mesh(geom.dataid[0])
    vertices = model.mesh_vert[mesh.vertadr[0] : mesh.vertadr[0] + mesh.vertnum[0]]
    world = vertices @ data.geom_xmat[geom.id].reshape(3, 3).T + data.geom_xpos[geom.id]
    assert room.background is not None
    expected = room.background.X_WB.apply(room.background.visuals[0].geometry.vertices)  # type: ignore[union-attr]
    np.testing.assert_allclose(np.sort(world, axis=0), np.sort(expected, axis=0), atol=1e-6)


def test_a_background_mesh_is_seen_and_touches_nothing_in_pybullet(room: Scene) -> None:
    pytest.importorskip("pybullet", reason="PyBullet has wheels only for Python 3.11 on Linux")
    from simfoundry.worlds import open_world

    root = ET.fromstring(compile_scene(room, "pybullet").files["_background.urdf"])
    assert root.find("link/visual") is not None and root.find("link/collision") is None
    with open_world(room, "pybullet") as world:
        bullet, client = world._bullet, world.client  # type: ignore[attr-defined]
        (body,) = set(range(bullet.getNumBodies(client))) - set(world.bodies.values())  # type: ignore[attr-defined]
        assert bullet.getBodyInfo(body, physicsClientId=client)[1] == b"background"
        assert bullet.getDynamicsInfo(body, -1, physicsClientId=client)[0] == 0
        assert bullet.getCollisionShapeData(body, -1, physicsClientId=client) == ()
        assert len(bullet.getVisualShapeData(body, physicsClientId=client)) == 1


def test_a_background_mesh_has_no_collider_in_usd(room: Scene, tmp_path: Path) -> None:
    from pxr import UsdPhysics, UsdShade

    stage = stage_of(room, tmp_path)
    assert errors(stage) == []
    prim = stage.GetPrimAtPath("/World/Background/mesh")
    assert prim.GetTypeName() == "Mesh" and not prim.HasAPI(UsdPhysics.CollisionAPI)
    assert UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]


# -- labels and variants --------------------------------------------------------------------------------------------


def test_labels_are_in_every_target(room: Scene, tmp_path: Path) -> None:
    stage = stage_of(room, tmp_path)
    for name, labels in (("cup", ["mug", "container"]), ("ball", ["ball"]), ("cabinet", ["cabinet"])):
        prim = stage.GetPrimAtPath(f"/World/Objects/{name}")
        assert list(prim.GetAttribute("semantics:labels:class").Get()) == labels
    root = ET.fromstring(compile_scene(room, "mjcf").files["scene.xml"])
    texts = {t.get("name"): t.get("data") for t in root.iter("text")}
    assert texts["cup.labels"] == "mug container" and "ball.labels" not in texts
    assert json.loads(compile_scene(room, "urdf").files["poses.json"])["cup"]["labels"] == ["mug", "container"]
    world = json.loads(compile_scene(room, "pybullet").files["world.json"])
    assert world["objects"]["cup"]["labels"] == ["mug", "container"] and "labels" not in world["objects"]["ball"]


def test_variants_are_one_set_in_usd(room: Scene, tmp_path: Path) -> None:
    stage = stage_of(room, tmp_path)
    prim = stage.GetPrimAtPath("/World/Objects/cup")
    choices = prim.GetVariantSets().GetVariantSet("variant")
    assert sorted(choices.GetVariantNames()) == ["default", "red", "tall"]
    assert choices.GetVariantSelection() == "default"
    facts = {}
    for name in ("default", "red", "tall"):
        choices.SetVariantSelection(name)
        assert errors(stage) == []
        body = stage.GetPrimAtPath("/World/Objects/cup/base")
        shape = stage.GetPrimAtPath("/World/Objects/cup/base/Colliders/shape")
        material = shape.GetRelationship("material:binding:physics").GetTargets()[0]
        assert stage.GetPrimAtPath(material)
        labels = list(prim.GetAttribute("semantics:labels:class").Get())
        z = prim.GetAttribute("xformOp:translate").Get()[2]
        height, mass = shape.GetAttribute("height").Get(), body.GetAttribute("physics:mass").Get()
        facts[name] = (round(mass, 6), height, round(z, 6), labels)
    assert facts["default"] == (0.2, 0.1, 0.0501, ["mug", "container"])
    assert facts["red"] == (0.3, 0.1, 0.0501, ["mug", "container"])
    assert facts["tall"] == (0.2, 0.2, 0.1001, ["vase"])  # it stands on the desk, not in it


def test_a_scene_chooses_a_variant(tmp_path: Path) -> None:
    path = write_everything(tmp_path)
    path.write_text(path.read_text().replace("    labels: [mug, container]\n", "    variant: tall\n"))
    scene = lower_file(path)
    cup = scene.object("cup")
    assert cup.variant == "tall" and [v.variant for v in cup.variants] == ["default", "red"]
    root = ET.fromstring(compile_scene(scene, "mjcf").files["scene.xml"])
    sizes = {g.get("name"): g.get("size") for g in root.iter("geom")}
    assert sizes["cup.shape"] == "0.03 0.1"
    lost = [loss for loss in compile_scene(scene, "mjcf").losses if loss.path == "cup.variants"]
    assert [loss.reason for loss in lost] == [
        "MJCF supports only one variant: `tall` is written; `default`, `red` are omitted."
    ]
    stage = stage_of(scene, tmp_path / "usd")
    choices = stage.GetPrimAtPath("/World/Objects/cup").GetVariantSets().GetVariantSet("variant")
    assert choices.GetVariantSelection() == "tall"


def test_a_variant_may_be_an_asset_with_joints(tmp_path: Path) -> None:
    path = write_everything(tmp_path)
    text = path.read_text().replace("      red: {", "      chest: {asset: cabinet.asset.yaml}\n      red: {")
    path.write_text(text)
    cup = lower_file(path).object("cup")
    chest = next(v for v in cup.variants if v.variant == "chest")
    assert [j.name for j in chest.joints] == [
        "slide",
        "hinge",
        "turn",
        "nod",
        "loose",
        "along",
        "pitch",
        "roll",
        "weld",
    ]
    stage = stage_of(lower_file(path), tmp_path / "usd")
    stage.GetPrimAtPath("/World/Objects/cup").GetVariantSets().SetSelection("variant", "chest")
    assert errors(stage) == []
    joint = stage.GetPrimAtPath("/World/Objects/cup/Joints/slide")
    bodies = joint.GetRelationship("physics:body0").GetTargets() + joint.GetRelationship("physics:body1").GetTargets()
    assert [str(b) for b in bodies] == ["/World/Objects/cup/frame", "/World/Objects/cup/drawer"]
    assert all(stage.GetPrimAtPath(b) for b in bodies)


@pytest.mark.parametrize(
    ("variant", "code", "words"),
    [
        ("{material: glass}", "SF201", "no material is called `glass`"),
        ("{scale: 2}", "SF107", "`scale` applies only to meshes"),
        ("{asset: nowhere.obj}", "SF203", "file `nowhere.obj` does not exist"),
        ("{shape: {sphere: 1}, asset: tile.obj}", "SF107", "specify only one of `shape`, `asset`"),
        ("{}", "SF107", "must override at least one property"),
        ("{colour: [1, 0, 0]}", "SF101", "unknown key `colour`"),
    ],
)
def test_a_wrong_variant_is_found_where_it_stands(tmp_path: Path, variant: str, code: str, words: str) -> None:
    path = write_everything(tmp_path)
    path.write_text(path.read_text().replace("      red: {color: [1, 0, 0], mass: 0.3}", f"      red: {variant}"))
    (finding,) = load(path).errors
    assert finding.code == code and words in finding.message
    assert "red:" in path.read_text().splitlines()[finding.line - 1]


def test_an_unknown_variant_is_not_chosen(tmp_path: Path) -> None:
    path = write_everything(tmp_path)
    path.write_text(path.read_text().replace("    labels: [mug, container]\n", "    variant: talk\n"))
    (finding,) = load(path).errors
    assert finding.code == "SF201" and finding.hint == "did you mean `tall`?"


def test_no_variant_is_called_default(tmp_path: Path) -> None:
    path = write_everything(tmp_path)
    path.write_text(path.read_text().replace("      red: {", "      default: {"))
    (finding,) = load(path).errors
    assert finding.code == "SF107" and "no variant may be named `default`" in finding.message


# -- lights and cameras ---------------------------------------------------------------------------------------------


def test_pybullet_pictures_have_the_light_of_the_scene(room: Scene, tmp_path: Path) -> None:
    pytest.importorskip("pybullet", reason="PyBullet has wheels only for Python 3.11 on Linux")
    world = json.loads(compile_scene(room, "pybullet").files["world.json"])
    toward = np.array(world["lighting"]["lightDirection"])
    np.testing.assert_allclose(toward, -np.array([0.2, 0.1, -1]) / np.linalg.norm([0.2, 0.1, -1]), atol=1e-9)
    assert world["lighting"]["lightDiffuseCoeff"] == 0.6 and world["lighting"]["lightAmbientCoeff"] == 0.3
    means = {}
    for name, scene in (("lit", room), ("dark", dataclasses.replace(room, lights=room.lights[1:]))):
        compile_scene(scene, "pybullet").write(tmp_path / name)
        script = (
            "import sys, load, numpy, pybullet\n"
            "client = pybullet.connect(pybullet.DIRECT)\n"
            "load.load(client)\n"
            "rgba = load.picture(client, 'eye')[2]\n"
            "print('mean', numpy.asarray(rgba)[..., :3].mean())\n"
        )
        command = [sys.executable, "-c", script]
        done = subprocess.run(command, cwd=tmp_path / name, capture_output=True, text=True, check=True, timeout=60)
        means[name] = float(done.stdout.rpartition("mean ")[2])
    assert means["lit"] > means["dark"] + 10


# -- OmniGibson -----------------------------------------------------------------------------------------------------


def test_omnigibson_gets_a_scene_file_and_a_usd_for_each_object(room: Scene, tmp_path: Path) -> None:
    from pxr import Usd, UsdPhysics, UsdShade

    compile_target(room, find_target("omnigibson")).write(tmp_path)
    data = json.loads((tmp_path / "scene.json").read_text())
    assert list(data["objects_info"]["init_info"]) == [item.name for item in room.objects]
    state = data["state"]["registry"]["object_registry"]
    assert data["state"]["registry"]["system_registry"] == {}  # OmniGibson's `Scene.__init__` reads its keys
    cup = room.object("cup")
    w, x, y, z = cup.X_WO.q
    np.testing.assert_allclose(state["cup"]["root_link"]["pos"], cup.X_WO.p, atol=1e-9)
    np.testing.assert_allclose(state["cup"]["root_link"]["ori"], [x, y, z, w], atol=1e-9)
    above = room.object("cabinet").joints_above
    order = [j.position for link in room.object("cabinet").links for j in above.get(link.name, ()) if j.name != "weld"]
    assert state["cabinet"]["joint_pos"] == pytest.approx(order)
    for name, info in data["objects_info"]["init_info"].items():
        stage = Usd.Stage.Open(str(tmp_path / info["args"]["usd_path"]))
        assert errors(stage) == []
        root = stage.GetDefaultPrim()
        assert root.GetName() == name and not root.GetAttribute("xformOp:translate").HasAuthoredValue()
        item = room.object(name)
        for link in item.links:
            prim = stage.GetPrimAtPath(f"/{name}/{link.name}")
            assert prim.GetAttribute("physics:mass").Get() == pytest.approx(link.mass, rel=1e-6)
        for prim in stage.Traverse():
            for relation in prim.GetRelationships():
                assert all(stage.GetPrimAtPath(t) for t in relation.GetTargets()), relation
            if prim.HasAPI(UsdPhysics.CollisionAPI):
                assert UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")[0]
            if prim.GetTypeName() == "Mesh":
                assert len(prim.GetAttribute("points").Get()) > 3
