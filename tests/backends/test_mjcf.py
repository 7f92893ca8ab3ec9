from __future__ import annotations

import dataclasses
import math
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from simfoundry.backends import BACKENDS, compile_scene
from simfoundry.backends.artifact import Artifact
from simfoundry.backends.features import Fidelity
from simfoundry.backends.mjcf import compile_mjcf
from simfoundry.backends.mjcf.contact_rules import damping_ratio, rebound
from simfoundry.backends.names import InvalidSceneError
from simfoundry.geometry.frames import IDENTITY
from simfoundry.geometry.shapes import Cylinder, Mesh, Sphere
from simfoundry.runtime.plugins import UnknownExtensionError
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Collider, Drive, Scene, Visual
from tests.mechanisms import mechanisms, rough
from tests.scenes import all_scenes, box, cabinet, full_scene, pose, primitives_scene, scene_of, solid, textured_object


def load(artifact: Artifact) -> Any:
    assets = {path: data for path, data in artifact.files.items() if path.startswith(("assets/", "contacts.xml"))}
    return mujoco.MjModel.from_xml_string(artifact.files["scene.xml"].decode(), assets)


def pairs(artifact: Artifact) -> list[dict[str, str]]:
    """The pairs of the file, each with the attributes of its class."""
    root = ET.fromstring(artifact.files["contacts.xml"])
    classes = {d.get("class"): d.find("pair") for d in root.iterfind("default/default")}
    return [classes[e.get("class")].attrib | e.attrib for e in root.iterfind("contact/pair")]  # type: ignore[union-attr]


@pytest.mark.parametrize("scene", [*all_scenes().values(), mechanisms()], ids=[*all_scenes(), "mechanisms"])
def test_loads_without_a_warning(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo logs its warnings to a file where it runs
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load(compile_mjcf(scene))
    assert capfd.readouterr() == ("", "")
    assert list(tmp_path.iterdir()) == []


def test_meshes_stay_in_their_places() -> None:
    """MuJoCo moves a mesh to its own center; the geom must make up for it."""
    item = textured_object()
    model = load(compile_mjcf(scene_of(item)))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    parts: list[tuple[str, Collider | Visual]] = [
        ("wedge.ramp", item.root.colliders[0]),
        ("wedge.heel", item.root.colliders[1]),
    ]
    parts.append(("wedge:skin", item.root.visuals[0]))
    for name, part in parts:
        assert isinstance(part.geometry, Mesh)
        geom = model.geom(name).id
        start, count = model.mesh_vertadr[model.geom_dataid[geom]], model.mesh_vertnum[model.geom_dataid[geom]]
        local = model.mesh_vert[start : start + count]
        found = local @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        expected = (item.X_WO @ part.X_LG).apply(part.geometry.vertices)
        distances = np.linalg.norm(found[:, None] - expected[None], axis=2)
        assert distances.min(axis=0).max() < 1e-7
        assert distances.min(axis=1).max() < 1e-7


def test_every_geom_keeps_its_shape_and_place() -> None:
    scene = full_scene()
    model = load(compile_mjcf(scene))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    kinds = set()
    for item in scene.objects:
        X_OL = link_poses(item)
        for link in item.links:
            for collider in link.colliders:
                geom = model.geom(f"{item.qualified(link.name)}.{collider.name}")
                if isinstance(collider.geometry, Mesh):
                    continue
                X_WG = item.X_WO @ X_OL[link.name] @ collider.X_LG
                np.testing.assert_allclose(data.geom_xpos[geom.id], X_WG.p, atol=1e-9)
                np.testing.assert_allclose(data.geom_xmat[geom.id].reshape(3, 3), X_WG.rotation, atol=1e-9)
                kinds.add(int(geom.type[0]))
                if isinstance(collider.geometry, Cylinder):
                    np.testing.assert_allclose(geom.size[:2], [collider.geometry.radius, collider.geometry.height / 2])
    assert {int(getattr(mujoco.mjtGeom, f"mjGEOM_{k}")) for k in ("BOX", "SPHERE", "CYLINDER", "CAPSULE")} == kinds


def test_visual_geoms_collide_with_nothing() -> None:
    model = load(compile_mjcf(full_scene()))
    for geom in range(model.ngeom):
        visual = ":" in model.geom(geom).name
        assert int(model.geom_group[geom]) in ((2,) if visual else (2, 3))
        assert bool(model.geom_contype[geom] or model.geom_conaffinity[geom]) != visual


def test_textures_and_their_coordinates_arrive() -> None:
    item = textured_object()
    model = load(compile_mjcf(scene_of(item)))
    assert (model.ntex, int(model.tex_width[0]), int(model.tex_height[0])) == (1, 16, 16)
    start = int(model.tex_adr[0])
    assert model.tex_data[start : start + 3].tolist() == [255, 0, 0]  # the first cell of the first row is red
    material = int(model.geom("wedge:skin").matid[0])
    np.testing.assert_allclose(model.mat_rgba[material], [0.9, 0.9, 1.0, 1.0], rtol=1e-6)
    mesh = item.root.visuals[0].geometry
    assert isinstance(mesh, Mesh)
    assert mesh.uv is not None
    # MuJoCo counts v downward, as the rows of its picture.
    expected = {(round(u, 5), round(1 - v, 5)) for u, v in mesh.uv.tolist()}
    assert {(round(float(u), 5), round(float(v), 5)) for u, v in model.mesh_texcoord} == expected


def test_cameras_see_along_the_rays_of_the_intrinsics() -> None:
    scene = full_scene()
    model = load(compile_mjcf(scene))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for camera in scene.cameras:
        view = mujoco.MjvCamera()
        view.type, view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, model.camera(camera.name).id
        drawn = mujoco.MjvScene(model, 200)
        mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, view, mujoco.mjtCatBit.mjCAT_ALL, drawn)
        gl = drawn.camera[0]
        slopes = np.array([gl.frustum_center - gl.frustum_width, gl.frustum_center + gl.frustum_width,
                           -gl.frustum_top, -gl.frustum_bottom]) / gl.frustum_near  # fmt: skip
        edges = np.array([-0.5, camera.width - 0.5, -0.5, camera.height - 0.5])
        pixels = slopes * [camera.fx, camera.fx, camera.fy, camera.fy] + [camera.cx, camera.cx, camera.cy, camera.cy]
        np.testing.assert_allclose(pixels, edges, atol=2e-3)  # MuJoCo keeps cameras in single precision
        forward = -data.cam_xmat[model.camera(camera.name).id].reshape(3, 3)[:, 2]
        np.testing.assert_allclose(forward, camera.X_WC.rotation[:, 2], atol=1e-9)
        np.testing.assert_allclose(data.cam_xpos[model.camera(camera.name).id], camera.X_WC.p, atol=1e-12)
        assert model.cam_resolution[model.camera(camera.name).id].tolist() == [camera.width, camera.height]


def test_lights_shine_where_and_as_strong_as_they_should() -> None:
    scene = full_scene()
    model = load(compile_mjcf(scene))
    assert model.nlight == 2
    sun = next(light for light in scene.lights if light.name == "sun")
    np.testing.assert_allclose(model.light("sun").dir, -sun.X_WL.rotation[:, 2], atol=1e-6)
    np.testing.assert_allclose(model.light("sun").diffuse, 0.6 * sun.rgb, rtol=1e-6)
    np.testing.assert_allclose(model.vis.headlight.ambient, [0.16, 0.18, 0.2], rtol=1e-6)


def test_one_friction_needs_no_pairs() -> None:
    assert pairs(compile_mjcf(primitives_scene())) == []


def test_pairs_are_only_where_surfaces_differ_and_something_can_move() -> None:
    objects = [
        solid("floor", box(1, 1, 0.1), pose(0, 0, 0), friction=0.8, fixed=True),
        solid("wall", box(1, 0.1, 1), pose(0, 1, 0), friction=0.2, fixed=True),
        solid("cup", Sphere(0.1), pose(0, 0, 1, 0.1), friction=0.2),
        solid("mug", Sphere(0.1), pose(0, 0, 2, 0.2), friction=0.2),
    ]
    found = {(p["geom1"], p["geom2"]): p["friction"].split()[:2] for p in pairs(compile_mjcf(scene_of(*objects)))}
    assert found == {
        ("floor.shape", "cup.shape"): ["0.4", "0.4"],
        ("floor.shape", "mug.shape"): ["0.4", "0.4"],
    }


def test_no_pair_of_linked_links_nor_between_static_parts() -> None:
    """The cabinet's carcass is static but its handle, with another friction, moves with the door."""
    floor = solid("floor", box(1, 1, 0.1), pose(0, 0, -1), friction=0.8, fixed=True)
    found = {frozenset((p["geom1"], p["geom2"])) for p in pairs(compile_mjcf(scene_of(floor, cabinet())))}
    # 0.8 on the handle equals the floor's; the carcass is static, and linked to all others.
    assert found == {
        frozenset(("floor.shape", "cabinet.drawer.tray")),
        frozenset(("floor.shape", "cabinet.door.panel")),
        frozenset(("cabinet.drawer.tray", "cabinet.handle.grip")),
    }


def test_resistances_are_the_larger_of_a_pair() -> None:
    spinning = rough(solid("ball", Sphere(0.04), pose(0, 0, 1, 0.1), friction=0.5), 0.004, 0.0)
    rolling = rough(solid("can", Cylinder(0.03, 0.1), pose(0, 1, 1, 0.1), friction=0.5), 0.001, 0.002)
    floor = solid("floor", box(1, 1, 0.1), pose(0, 0, -1), friction=0.8, fixed=True)
    model = load(compile_mjcf(scene_of(spinning, rolling, floor)))
    assert [model.geom(name).condim[0] for name in ("ball.shape", "can.shape", "floor.shape")] == [4, 6, 3]
    np.testing.assert_allclose(model.geom("ball.shape").friction, [0.5, 0.004, 0.0])
    np.testing.assert_allclose(model.geom("floor.shape").friction, [0.8, 0.0, 0.0])  # not MuJoCo's own 0.005, 0.0001
    mu = math.sqrt(0.4)
    assert model.pair_dim.tolist() == [4, 6]
    np.testing.assert_allclose(model.pair_friction, [[mu, mu, 0.004, 0, 0], [mu, mu, 0.001, 0.002, 0.002]], rtol=1e-9)
    assert model.opt.impratio == 100


def test_the_keyframe_holds_targets_and_rotations() -> None:
    scene = mechanisms()
    model = load(compile_mjcf(scene))
    assert [model.actuator(k).name for k in range(model.nu)] == ["gripper.left_slide", "pot.hinge"]
    assert model.key("initial").ctrl.tolist() == [0.03, 0.0]
    np.testing.assert_allclose(model.actuator_ctrlrange[0], [0.0, 0.04])
    start = int(model.joint("pendulum.swing").qposadr[0])
    np.testing.assert_allclose(
        model.key("initial").qpos[start : start + 4], scene.object("pendulum").joints[0].motion.q
    )
    # Nested free joints are not MuJoCo's: the lid is a body of the world, and the flap hangs on it.
    assert model.body("pot.lid").parentid[0] == 0
    assert model.body("pot.flap").parentid[0] == model.body("pot.lid").id
    assert model.joint("pot.rests").type[0] == mujoco.mjtJoint.mjJNT_FREE


def test_links_that_do_not_touch_are_excluded_once() -> None:
    model = load(compile_mjcf(mechanisms()))
    names = [model.body(b).name for b in range(model.nbody)]
    found = [frozenset((names[s >> 16], names[s & 0xFFFF])) for s in model.exclude_signature.tolist()]
    assert set(found) == {
        frozenset(pair)
        for pair in (
            ("gripper", "gripper.left"), ("gripper", "gripper.right"), ("pendulum", "pendulum.bob"),
            ("pot", "pot.grip"), ("pot.lid", "pot.flap"), ("pot.flap", "pot.knob"), ("pot.grip", "pot.lid"),
            ("ball", "gripper.left"), ("pot.lid", "table"),
        )
    }  # fmt: skip
    assert len(found) == len(set(found))


def test_restitution_becomes_damping_within_the_stated_error() -> None:
    for restitution in (0.2, 0.5, 0.9):
        assert rebound(damping_ratio(restitution)) == pytest.approx(restitution, abs=1e-9)
        assert drop_and_rebound(restitution) == pytest.approx(restitution, abs=0.03)
    assert damping_ratio(0.05) == 1.0


def drop_and_rebound(restitution: float) -> float:
    """Speed after the first bounce over the speed before it."""
    ball = solid("ball", Sphere(0.03), pose(0, 0, 0.13, 0.3, 0.2, 0.1), restitution=restitution)
    floor = solid("floor", box(1, 1, 0.1), pose(0, 0, -0.05), restitution=restitution, fixed=True)
    model = load(compile_mjcf(scene_of(ball, floor)))
    data = mujoco.MjData(model)
    down = up = 0.0
    for _ in range(int(0.2 / model.opt.timestep)):
        mujoco.mj_step(model, data)
        down, up = min(down, data.qvel[2]), max(up, data.qvel[2])
    return up / -down


def test_a_motor_without_stiffness_has_its_target_as_control() -> None:
    fan = next(item for item in full_scene().objects if item.name == "fan")
    (spin,) = (joint for joint in fan.joints if joint.name == "spin")
    driven = dataclasses.replace(spin, drive=Drive(stiffness=0.0, damping=0.002, target=1.0))
    joints = tuple(driven if joint is spin else joint for joint in fan.joints)
    model = load(compile_mjcf(scene_of(dataclasses.replace(fan, joints=joints))))
    assert model.key("initial").ctrl.tolist() == [1.0] and model.actuator_gainprm[0, 0] == 0


@pytest.mark.parametrize("value", [0.0, -1.0, math.inf, math.nan])
@pytest.mark.parametrize("target", ["mjcf", "pybullet"])
def test_a_time_step_that_is_none_is_refused(target: str, value: float) -> None:
    with pytest.raises(InvalidSceneError, match="option `timestep` must be a positive number of seconds"):
        compile_scene(primitives_scene(), target, {"timestep": value})


@pytest.mark.parametrize("sides", [2.5, 24.5, 1.0, -3.0, math.inf, math.nan])
def test_a_prism_has_a_whole_number_of_sides(sides: float) -> None:
    with pytest.raises(InvalidSceneError, match="option `cylinder_sides` must be a whole number of at least 3, or 0"):
        compile_mjcf(primitives_scene(), cylinder_sides=sides)


def test_losses_name_what_is_approximated() -> None:
    losses = {loss.path: loss for loss in compile_mjcf(full_scene()).losses}
    assert set(losses) == {"puck.restitution", "wedge.restitution", "restitution", "sky"}
    assert all(loss.fidelity is Fidelity.APPROXIMATED and len(loss.reason) > 20 for loss in losses.values())


def test_initial_keyframe_holds_the_joint_positions() -> None:
    model = load(compile_mjcf(full_scene()))
    qpos = model.key("initial").qpos
    assert qpos[model.joint("cabinet.slide").qposadr[0]] == 0.07
    assert qpos[model.joint("cabinet.hinge").qposadr[0]] == 0.6
    assert qpos[model.joint("fan.spin").qposadr[0]] == 2.3


def test_loader_runs_from_a_moved_folder(run_loader: Callable[[Scene, str], str]) -> None:
    printed = run_loader(full_scene(), "mjcf")
    assert printed.count("\n") == 1
    assert "13 bodies, 10 joints" in printed


def test_two_builds_are_identical(manifest_elsewhere: Callable[[str], str]) -> None:
    assert compile_scene(full_scene(), "mjcf").manifest.decode() == manifest_elsewhere("mjcf")


def test_equal_meshes_are_written_once() -> None:
    item = textured_object()
    second = dataclasses.replace(item, name="other", X_WO=pose(2, 0, 1, 0.1, 0.2, 0.3))
    assert set(compile_mjcf(scene_of(item, second)).files) == set(compile_mjcf(scene_of(item)).files)


@pytest.mark.parametrize("target", [t for t in BACKENDS.names() if t != "usd"])
@pytest.mark.parametrize("name", ["Cup", "a b", '"/><evil', "../cup", "", "1cup"])
def test_names_that_could_break_a_format_are_refused(name: str, target: str) -> None:
    scene = scene_of(solid(name, Sphere(0.1), IDENTITY))
    with pytest.raises(InvalidSceneError, match="object name"):
        compile_scene(scene, target)


def test_two_objects_of_one_name_are_refused() -> None:
    with pytest.raises(InvalidSceneError, match="two objects are called 'cup'"):
        compile_mjcf(scene_of(solid("cup", Sphere(0.1), IDENTITY), solid("cup", Sphere(0.1), IDENTITY)))


def test_categories_are_escaped() -> None:
    item = dataclasses.replace(solid("cup", Sphere(0.1), IDENTITY), category='a"<b>&')
    model = load(compile_mjcf(scene_of(item)))
    start, size = (int(getattr(model, f"text_{word}")[1]) for word in ("adr", "size"))
    assert bytes(model.text_data[start : start + size - 1]).decode() == 'a"<b>&'


def test_an_unknown_target_names_those_there_are() -> None:
    with pytest.raises(UnknownExtensionError, match="no backend is called `mujoco`; available: `mjcf`, `pybullet`"):
        compile_scene(primitives_scene(), "mujoco")


def test_gravity_and_step() -> None:
    model = load(compile_mjcf(all_scenes()["free_cabinet"]))
    np.testing.assert_allclose(model.opt.gravity, [0.3, -0.2, -9.7])
    assert model.opt.timestep == 0.002
    assert math.isclose(model.opt.impratio, 10)
