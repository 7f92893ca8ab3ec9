from __future__ import annotations

import dataclasses
import json
import xml.etree.ElementTree as ET
from collections.abc import Callable

import numpy as np
import pytest

from simfoundry.backends import compile_scene
from simfoundry.backends.features import Fidelity
from simfoundry.backends.urdf import compile_urdf
from simfoundry.geometry.frames import Array, Pose, quat_from_rpy
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import JointType, Scene, SceneObject
from tests.mechanisms import mechanisms
from tests.scenes import all_scenes, cabinet, fan, full_scene, primitives_scene, scene_of, textured_object

SCENES = pytest.mark.parametrize("scene", all_scenes().values(), ids=all_scenes())


def robot(scene: Scene, name: str) -> ET.Element:
    return ET.fromstring(compile_urdf(scene).files[f"{name}.urdf"])


def child(parent: ET.Element, tag: str) -> ET.Element:
    found = parent.find(tag)
    assert found is not None, f"<{parent.tag}> has no <{tag}>"
    return found


def floats(text: str) -> Array:
    return np.array([float(part) for part in text.split()])


def origin(parent: ET.Element) -> Pose:
    element = parent.find("origin")
    if element is None:
        return Pose.of()
    return Pose.of(floats(element.attrib["xyz"]), quat_from_rpy(*floats(element.attrib["rpy"])))


@SCENES
def test_mass_properties_in_link_axes_are_the_scenes(scene: Scene) -> None:
    for item in scene.objects:
        root = robot(scene, item.name)
        for link, element in zip(item.links, root.findall("link"), strict=True):
            assert element.attrib["name"] == link.name
            inertial = child(element, "inertial")
            X_LI = origin(inertial)
            numbers = {key: float(value) for key, value in child(inertial, "inertia").attrib.items()}
            np.testing.assert_array_equal(X_LI.q, [1, 0, 0, 0])  # some readers ignore a rotation
            tensor = [[numbers["i" + "".join(sorted(a + b))] for b in "xyz"] for a in "xyz"]
            assert np.linalg.norm(tensor - link.inertia) < 1e-10 * np.linalg.norm(link.inertia)
            np.testing.assert_allclose(X_LI.p, link.com, atol=1e-12)
            assert float(child(inertial, "mass").attrib["value"]) == pytest.approx(link.mass, rel=1e-11)


@SCENES
def test_kinematics_are_the_scenes(scene: Scene) -> None:
    for item in scene.objects:
        found = walk(robot(scene, item.name), item)
        for name, X_OL in link_poses(item, {joint.name: 0.0 for joint in item.joints}).items():
            np.testing.assert_allclose(found[name].p, X_OL.p, atol=1e-11)
            assert found[name].angle_to(X_OL) < 1e-7


def walk(root: ET.Element, item: SceneObject) -> dict[str, Pose]:
    """Link poses at joint zero, from the file alone."""
    poses = {item.root.name: Pose.of()}
    for joint in root.findall("joint"):
        poses[child(joint, "child").attrib["link"]] = poses[child(joint, "parent").attrib["link"]] @ origin(joint)
    return poses


def test_joints_keep_type_axis_limits_and_dynamics() -> None:
    item = cabinet()
    elements = {e.attrib["name"]: e for e in robot(scene_of(item), "cabinet").findall("joint")}
    assert [e.attrib["type"] for e in elements.values()] == ["prismatic", "revolute", "fixed"]
    for joint in item.joints:
        if joint.type is JointType.FIXED:
            continue
        element = elements[joint.name]
        np.testing.assert_allclose(floats(child(element, "axis").attrib["xyz"]), joint.axis, atol=1e-11)
        limit, dynamics = child(element, "limit").attrib, child(element, "dynamics").attrib
        assert (float(limit["lower"]), float(limit["upper"])) == joint.limits
        assert (float(dynamics["damping"]), float(dynamics["friction"])) == (joint.damping, joint.friction)


def test_a_continuous_joint_has_no_range() -> None:
    joint = child(robot(scene_of(fan()), "fan"), "joint")
    assert joint.attrib["type"] == "continuous"
    assert "lower" not in child(joint, "limit").attrib


def test_a_slide_without_limits_is_not_locked_at_zero() -> None:
    item = cabinet()
    free = dataclasses.replace(item.joints[0], limits=None)
    scene = scene_of(dataclasses.replace(item, joints=(free, *item.joints[1:])))
    limit = child(child(robot(scene, "cabinet"), "joint"), "limit").attrib
    assert (limit["lower"], limit["upper"]) == ("-1000", "1000")
    assert "cabinet.slide.limits" in {loss.path for loss in compile_urdf(scene).losses}


@SCENES
def test_no_floating_joints_and_every_file_is_there(scene: Scene) -> None:
    artifact = compile_urdf(scene)
    for item in scene.objects:
        root = ET.fromstring(artifact.files[f"{item.name}.urdf"])
        assert "floating" not in {joint.attrib["type"] for joint in root.iter("joint")}
        for mesh in [*root.iter("mesh"), *root.iter("texture")]:
            assert mesh.attrib["filename"] in artifact.files


def test_poses_hold_what_urdf_does_not() -> None:
    scene = full_scene()
    poses = json.loads(compile_urdf(scene).files["poses.json"])
    assert list(poses) == [item.name for item in scene.objects]
    for item in scene.objects:
        X_WO = Pose.of(poses[item.name]["p"], poses[item.name]["q_wxyz"])
        np.testing.assert_allclose(X_WO.p, item.X_WO.p, atol=1e-11)
        assert X_WO.angle_to(item.X_WO) < 1e-7
        assert poses[item.name]["fixed"] is item.fixed
    assert poses["cabinet"]["joints"] == {"slide": 0.07, "hinge": 0.6}


def test_a_capsule_is_a_cylinder_between_two_spheres() -> None:
    parts = robot(primitives_scene(), "pill").findall("link/collision")
    assert [part.attrib["name"] for part in parts] == ["shape_tube", "shape_top", "shape_bottom"]
    assert [origin(part).p[2] for part in parts] == [0, 0.03, -0.03]
    assert child(child(parts[0], "geometry"), "cylinder").attrib == {"radius": "0.02", "length": "0.06"}


def test_a_part_that_moves_freely_is_a_robot_of_its_own() -> None:
    scene = mechanisms()
    artifact = compile_urdf(scene)
    lid = ET.fromstring(artifact.files["pot.lid.urdf"])
    assert [link.attrib["name"] for link in lid.findall("link")] == ["lid", "flap", "knob"]
    placed = json.loads(artifact.files["poses.json"])
    item = scene.object("pot")
    X_WL = item.X_WO @ link_poses(item)["lid"]
    found = Pose.of(placed["pot.lid"]["p"], placed["pot.lid"]["q_wxyz"])
    np.testing.assert_allclose(found.p, X_WL.p, atol=1e-11)
    assert found.angle_to(X_WL) < 1e-7
    assert (placed["pot"]["joints"], placed["pot.lid"]["joints"]) == ({}, {"hinge": -0.3})


def test_a_ball_joint_is_welded_where_the_scene_has_it() -> None:
    scene = mechanisms()
    joint = scene.object("pendulum").joints[0]
    element = child(robot(scene, "pendulum"), "joint")
    assert element.attrib["type"] == "fixed"
    wanted = joint.X_PC @ joint.motion
    np.testing.assert_allclose(origin(element).p, wanted.p, atol=1e-11)
    assert origin(element).angle_to(wanted) < 1e-7


def test_a_follower_and_the_limit_of_a_drive() -> None:
    first, second = robot(mechanisms(), "gripper").findall("joint")
    assert child(second, "mimic").attrib == {"joint": "left_slide", "multiplier": "-0.5", "offset": "0.02"}
    assert first.find("mimic") is None
    assert (child(first, "limit").attrib["effort"], child(second, "limit").attrib["effort"]) == ("25", "1000000")


def test_losses_cover_mechanisms() -> None:
    paths = {loss.path for loss in compile_urdf(mechanisms()).losses}
    assert {
        "pendulum.swing", "pot.swivel", "gripper.left_slide.drive", "pot.hinge.drive", "ball.rolling_friction",
        "ball.torsional_friction", "pot.no_contact", "gripper.no_contact", "no_contact",
    } <= paths  # fmt: skip
    assert "table.rolling_friction" not in paths and "pendulum.no_contact" not in paths


def test_a_texture_goes_with_its_mesh() -> None:
    artifact = compile_urdf(scene_of(textured_object()))
    png = next(path for path in artifact.files if path.endswith(".png"))
    mtl = next(path for path in artifact.files if path.endswith(".mtl"))
    assert f"map_Kd {png.removeprefix('assets/')}" in artifact.files[mtl].decode()
    obj = artifact.files[mtl.replace(".mtl", ".obj")].decode()
    assert f"mtllib {mtl.removeprefix('assets/')}\n" in obj
    assert "vt 0.25 1\n" in obj  # v as in the scene: upward


def test_losses_cover_what_urdf_cannot_hold() -> None:
    losses = compile_urdf(full_scene()).losses
    paths = {loss.path for loss in losses}
    assert {"gravity", "crate.friction", "wedge.restitution", "cabinet.hinge.armature", "sun", "side"} <= paths
    assert "crate.restitution" not in paths
    assert len(paths) == len(losses)
    assert {loss.fidelity for loss in losses} == {Fidelity.DROPPED}


def test_two_builds_are_identical(manifest_elsewhere: Callable[[str], str]) -> None:
    assert compile_scene(full_scene(), "urdf").manifest.decode() == manifest_elsewhere("urdf")


def test_loader_runs_from_a_moved_folder(run_loader: Callable[[Scene, str], str]) -> None:
    scene = full_scene()
    printed = run_loader(scene, "urdf").splitlines()
    assert printed[-1].endswith(f"poses.json: {len(scene.objects)} objects")
    for line, item in zip(printed, scene.objects, strict=False):
        assert line.startswith(f"{item.name}: {len(item.links)} links, {len(item.joints)} joints, ")
        assert ("fixed at" in line) == item.fixed
