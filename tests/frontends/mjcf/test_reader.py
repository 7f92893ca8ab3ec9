"""MJCF in: what MuJoCo says of the original, it says of what we compile from the import."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from simfoundry.frontends.draft import ImportOptions
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.importer import import_file
from simfoundry.geometry.shapes import Box
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import JointType
from tests.frontends.conftest import Importing

MODEL = """<mujoco model="arm">
  <default><default class="heavy"><geom density="3000"/>
    <default class="rough"><geom friction="1.3"/></default></default></default>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <camera name="eye" pos="1 0 1" xyaxes="0 1 0 -0.7071 0 0.7071" fovy="50" resolution="320 240"/>
    <body name="upper" pos="0.1 0.2 0.3" euler="10 20 30">
      <joint name="shoulder" type="hinge" axis="1 2 2" pos="0.05 0 -0.1" range="-40 60" ref="15" damping="0.3"
        armature="0.02" actuatorfrcrange="-7 9"/>
      <geom class="rough" type="box" size="0.1 0.05 0.2" euler="5 0 40"/>
      <body name="Lower Arm" pos="0 0 0.3" euler="0 45 0">
        <joint name="slide" type="slide" axis="0 0 1" range="-0.1 0.2" frictionloss="0.4"/>
        <geom class="heavy" type="capsule" fromto="0 0 0 0.1 0.1 0.2" size="0.03"/>
        <geom type="sphere" size="0.1" contype="0" conaffinity="0" mass="0"/>
      </body>
    </body>
    <body name="ball" pos="1 1 1"><freejoint/><geom type="sphere" size="0.1" mass="0.7"/></body>
  </worldbody>
  <tendon><fixed name="rope"><joint joint="slide" coef="1"/></fixed></tendon>
  <keyframe><key qpos="0.4 0.05 1 2 3 0.5 0.5 0.5 0.5"/></keyframe>
</mujoco>"""


def test_every_body_stands_and_weighs_as_in_mujoco(importing: Importing) -> None:
    _, scene = importing("arm.xml", MODEL)
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    arm = scene.object("upper")
    poses = link_poses(arm)
    for body, name in (("upper", "upper"), ("Lower Arm", "lower_arm")):
        link = next(k for k in arm.links if k.name == name)
        X = arm.X_WO @ poses[name]
        number = model.body(body).id
        assert link.mass == pytest.approx(model.body_mass[number], rel=1e-8)
        assert X.apply(link.com) == pytest.approx(data.xipos[number], abs=1e-8)
        R = data.ximat[number].reshape(3, 3)
        inertia = R @ np.diag(model.body_inertia[number]) @ R.T
        assert X.rotation @ link.inertia @ X.rotation.T == pytest.approx(inertia, rel=1e-6, abs=1e-9)
    assert scene.object("ball").X_WO.p == pytest.approx([1, 2, 3])
    assert arm.fixed and not scene.object("ball").fixed


def test_joints_keep_their_coordinates(importing: Importing) -> None:
    report, scene = importing("arm.xml", MODEL)
    shoulder, slide = scene.object("upper").joints
    assert (shoulder.type, slide.type) == (JointType.REVOLUTE, JointType.PRISMATIC)
    assert shoulder.limits == pytest.approx(np.radians([-40, 60]))
    assert slide.limits == pytest.approx((-0.1, 0.2))
    assert (shoulder.position, slide.position) == pytest.approx((0.4, 0.05))
    assert (shoulder.damping, shoulder.armature, slide.friction) == pytest.approx((0.3, 0.02, 0.4))
    assert (shoulder.effort, slide.effort) == (9.0, None)
    note = next(n for n in report.notes if "actuatorfrcrange" in n.what)
    assert (note.kind, note.detail) == ("changed", "9 instead of 7")


def test_defaults_of_nested_classes_are_mujocos(importing: Importing) -> None:
    _, scene = importing("arm.xml", MODEL)
    upper = scene.object("upper").links[1]
    assert upper.mass == pytest.approx(3000 * 0.2 * 0.1 * 0.4)
    assert upper.colliders[0].friction == 1.3
    lower = scene.object("upper").links[2]
    assert len(lower.colliders) == 1 and len(lower.visuals) == 2


def test_planes_cameras_and_what_is_left_out(importing: Importing) -> None:
    report, scene = importing("arm.xml", MODEL)
    floor = scene.object("floor")
    geometry = floor.links[0].colliders[0].geometry
    assert floor.fixed and isinstance(geometry, Box)
    assert floor.X_WO.p[2] + geometry.size[2] / 2 == pytest.approx(0)
    (camera,) = scene.cameras
    assert (camera.width, camera.height) == (320, 240)
    assert camera.fy == pytest.approx(120 / np.tan(np.radians(25)))
    assert camera.X_WC.rotation @ [0, 0, 1] == pytest.approx([-0.7071, 0, -0.7071], abs=1e-4)
    assert camera.X_WC.rotation @ [1, 0, 0] == pytest.approx([0, 1, 0], abs=1e-4)
    assert ("changed", "plane `floor`") in {(str(n.kind), n.what) for n in report.notes}
    assert scene.native is not None and scene.native["tendon"][0]["fixed"]["name"] == "rope"


def test_the_principal_point_is_where_mujoco_draws_it(importing: Importing) -> None:
    text = """<mujoco><worldbody><geom size="0.1"/>
      <camera name="eye" pos="1 0 1" resolution="640 480" sensorsize="0.00064 0.00048" focalpixel="500 600"
        principalpixel="20 70"/></worldbody></mujoco>"""
    (camera,) = importing("eye.xml", text)[1].cameras
    model = mujoco.MjModel.from_xml_string(text)
    data, drawn, view = mujoco.MjData(model), mujoco.MjvScene(model, 10), mujoco.MjvCamera()
    mujoco.mj_forward(model, data)
    view.type, view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, 0
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, view, mujoco.mjtCatBit.mjCAT_ALL, drawn)
    gl = drawn.camera[0]
    left, height = gl.frustum_width - gl.frustum_center, gl.frustum_top - gl.frustum_bottom
    center = (left / (2 * gl.frustum_width) * 640 - 0.5, gl.frustum_top / height * 480 - 0.5)
    assert (camera.cx, camera.cy) == pytest.approx(center, abs=1e-3)


def test_hinges_of_one_body_are_the_axes_of_one_joint(importing: Importing) -> None:
    text = """<mujoco><worldbody><body name="b" pos="0 0 1"><joint name="a" axis="1 0 0" pos="0 0 0.2" range="-90 90"/>
      <joint name="b" axis="0 1 0" pos="0 0 0.2" damping="2" ref="20"/><joint name="c" axis="0 0 1" pos="0 0 0.2"/>
      <geom type="box" size="0.1 0.2 0.3" pos="0 0 0.5"/></body></worldbody>
      <keyframe><key qpos="0.3 0.7 -0.4"/></keyframe></mujoco>"""
    for found, count in ((text.replace(' ref="20"', ""), 2), (text, 4)):  # with `ref`, the frames differ at zero
        report, scene = importing("b.xml", found)
        model = mujoco.MjModel.from_xml_string(found)
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_forward(model, data)
        (thing,) = scene.objects
        link = thing.links[-1]
        assert len(thing.links) == count and len(thing.joints) == 3
        assert (thing.X_WO @ link_poses(thing)[link.name]).apply(link.com) == pytest.approx(data.xipos[1], abs=1e-8)
        assert {j.name: j.position for j in thing.joints} == pytest.approx({"a": 0.3, "b": 0.7, "c": -0.4})
    assert any("negligible" in note.why for note in report.notes)


def test_two_joints_of_a_body_with_a_ball_joint_are_two_links(importing: Importing) -> None:
    text = """<mujoco><worldbody><body name="b"><joint name="x" type="slide" axis="1 0 0" range="-1 1"/>
      <joint name="h" type="ball" pos="0 0 0.2"/>
      <geom type="box" size="0.1 0.2 0.3" pos="0 0 0.5"/></body></worldbody>
      <keyframe><key qpos="0.3 0.8 0.6 0 0"/></keyframe></mujoco>"""
    _, scene = importing("b.xml", text)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    (thing,) = scene.objects
    link = thing.links[-1]
    X = thing.X_WO @ link_poses(thing)[link.name]
    assert X.apply(link.com) == pytest.approx(data.xipos[1], abs=1e-8)
    assert sum(k.mass for k in thing.links[1:-1]) == pytest.approx(1e-7 * link.mass)


def test_links_between_joints_of_a_light_body_are_lighter(importing: Importing) -> None:
    text = """<mujoco><worldbody><body name="b"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>
      <joint type="ball"/><geom size="0.01" mass="0.005"/></body></worldbody></mujoco>"""
    _, scene = importing("b.xml", text)
    *_, first, second, body = scene.objects[0].links
    assert body.mass == 0.005 and first.mass + second.mass < 1e-6 * body.mass
    assert np.linalg.eigvalsh(first.inertia).min() > 1e-15  # what MuJoCo takes for nothing


def test_servos_springs_equalities_and_exclusions(importing: Importing) -> None:
    text = """<mujoco><worldbody><body name="a"><geom size="0.1"/>
      <body name="b" pos="1 0 0"><joint name="j" axis="0 1 0" ref="10"/>
        <geom size="0.1" condim="6" friction="0.7 0.02 0.003"/>
        <body name="c" pos="1 0 0"><joint name="k" axis="0 1 0" stiffness="3" springref="20"/><geom size="0.1"/>
          <body name="d" pos="1 0 0"><joint name="m" axis="0 1 0" ref="30"/><geom size="0.1"/></body></body></body>
      </body>
      <body name="e" pos="0 0 5"><joint name="ball" type="ball"/><geom size="0.1"/></body></worldbody>
      <equality><joint joint1="m" joint2="j" polycoef="0.1 -2 0 0 0"/></equality>
      <contact><exclude body1="a" body2="c"/></contact>
      <actuator><position name="servo" joint="j" kp="50" kv="4" gear="2" forcerange="-6 6"/>
        <motor joint="k"/></actuator>
    </mujoco>"""
    report, scene = importing("m.xml", text)
    thing = scene.object("a")
    j, k, m = thing.joints
    assert j.drive is not None and k.drive is not None and m.mimic is not None
    assert (j.drive.stiffness, j.drive.damping, j.drive.force_limit) == pytest.approx((200, 16, 12))
    assert (k.drive.stiffness, k.drive.target) == pytest.approx((3, np.radians(20)))
    offset = np.radians(30) + 0.1 + 2 * np.radians(10)
    assert (m.mimic.joint, m.mimic.multiplier) == ("j", -2)
    assert m.mimic.offset == pytest.approx(offset)
    assert thing.no_contact == (("a", "c"),)
    collider = thing.links[1].colliders[0]
    assert (collider.friction, collider.torsional_friction, collider.rolling_friction) == (0.7, 0.02, 0.003)
    assert scene.object("e").joints[0].type is JointType.BALL
    assert [(a.name, a.type) for a in thing.actuators] == [("servo", "position"), ("actuator_1", "motor")]
    assert not report.notes


def test_inertias_are_those_that_mujoco_takes(importing: Importing) -> None:
    """Models keep a thing from turning by an inertia that nothing of its size has."""
    text = """<mujoco><default><joint armature="0.5"/></default><worldbody><body name="b"><joint type="free"/>
      <inertial pos="0 0 0" mass="0.1" diaginertia="1000 1000 1000"/><geom size="0.01"/></body></worldbody></mujoco>"""
    report, scene = importing("b.xml", text)
    assert np.diag(scene.objects[0].links[0].inertia) == pytest.approx([1000] * 3)
    assert [n.what for n in report.notes] == ["armature of free joint `joint_0`"]


def test_a_mesh_lies_beside_the_file_that_includes_it(tmp_path: Path) -> None:
    (tmp_path / "parts/meshes").mkdir(parents=True)
    (tmp_path / "parts/meshes/m.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    )
    (tmp_path / "parts/assets.xml").write_text('<mujoco><asset><mesh name="m" file="meshes/m.obj"/></asset></mujoco>')
    body = '<worldbody><body><geom type="mesh" mesh="m"/></body></worldbody>'
    (tmp_path / "a.xml").write_text(f'<mujoco><include file="parts/assets.xml"/>{body}</mujoco>')
    mujoco.MjModel.from_xml_path(str(tmp_path / "a.xml"))
    assert import_file(tmp_path / "a.xml", tmp_path / "a.scene.yaml").meshes == 1


HAND = """<mujoco><worldbody><body name="hand"><freejoint/><geom size=".1" mass="1"/>
  <body name="finger" pos=".2 0 0"><joint name="f" type="slide" range="0 .1"/><geom size=".05" mass=".1"/>
    <body name="pad" pos="0 0 .1"><inertial mass="0" pos="0 0 0" diaginertia="0 0 0"/>{pad}</body></body></body>
  <body name="cup" pos="1 0 0"><freejoint/><geom size=".05"/></body></worldbody>
  <contact><exclude body1="hand" body2="pad"/><exclude body1="cup" body2="pad"/>{more}</contact></mujoco>"""


def test_a_massless_body_stays_a_link_with_its_exclusions(importing: Importing) -> None:
    report, scene = importing("m.xml", HAND.format(pad='<geom size=".02" mass="0"/>', more=""))
    hand = scene.object("hand")
    assert [link.name for link in hand.links] == ["hand", "finger", "pad"] and hand.links[2].mass < 1e-6
    assert hand.no_contact == (("hand", "pad"),) and scene.no_contact == (("cup", "hand.pad"),)
    assert not report.notes


def test_a_camera_in_a_massless_body_rides_on_what_carries_it(importing: Importing) -> None:
    text = """<mujoco><worldbody><body name="arm"><joint/><geom size=".1"/>
      <body name="mount" pos=".2 0 0"><geom size=".05"/>
        <body name="cam_frame" pos="0 0 .1" euler="0 90 0"><camera name="eye" pos=".3 0 0"/></body></body></body>
    </worldbody></mujoco>"""
    _, scene = importing("m.xml", text)
    (mounted,) = scene.mounted
    assert (mounted.carrier, mounted.link) == ("arm", "cam_frame")
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    arm = scene.object("arm")
    X_WC = arm.X_WO @ link_poses(arm)["cam_frame"] @ mounted.camera.X_WC
    assert X_WC.p == pytest.approx(data.cam_xpos[0])
    assert X_WC.rotation @ np.diag([1, -1, -1]) == pytest.approx(data.cam_xmat[0].reshape(3, 3))


def test_names_made_for_links_and_joints_are_no_names_of_the_file(importing: Importing) -> None:
    """A base of two slides and a ball is three links, carried by one; an attached gripper may call its bodies so."""
    text = """<mujoco><worldbody>
      <body name="mobile"><joint name="x" type="slide" axis="1 0 0" range="-1 1"/>
        <joint name="y" type="slide" axis="0 1 0" range="-1 1"/><joint name="yaw" type="ball"/>
        <geom size=".1"/>
        <body name="arm" pos=".2 0 0"><joint name="elbow"/><geom size=".05"/>
          <body name="base" pos="0 0 .1"><geom size=".05"/>
            <body pos="0 0 .1"><joint name="base_mount" range="0 1"/><geom size=".02"/>
              <body name="mobile_1_of_3" pos="0 0 .1"><joint/><geom size=".02"/>
                <body name="body_4" pos="0 0 .1"><joint name="joint_5"/><geom size=".02"/></body></body></body>
          </body></body></body>
    </worldbody></mujoco>"""
    _, scene = importing("m.xml", text)
    thing = scene.object("mobile")
    assert len(thing.links) == 9 and len(thing.joints) == 8
    model = mujoco.MjModel.from_xml_string(text)
    assert sum(link.mass for link in thing.links[1:]) == pytest.approx(model.body_mass.sum(), rel=1e-6)


def test_an_unforeseen_error_is_a_refusal_with_its_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_: object) -> None:
        raise KeyError("pad")

    monkeypatch.setattr("simfoundry.frontends.asset_documents.pose_data", broken)
    source = tmp_path / "m.xml"
    source.write_text(HAND.format(pad="", more=""))
    with pytest.raises(
        ImportRefusedError, match=r"m\.xml:3: the importer failed .*KeyError: 'pad' \(frontends/asset_doc"
    ):
        import_file(source, tmp_path / "m.scene.yaml", ImportOptions())


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("<mujoco><worldbody><body><joint/></body></worldbody></mujoco>", "MuJoCo rejects the file: .*mass"),
        ('<mujoco><include file="../../../etc/hostname"/></mujoco>', "a.xml:1: `../../../etc/hostname`"),
        ('<mujoco><asset><mesh name="m" file="../../secret.stl"/></asset></mujoco>', "is outside"),
        ('<mujoco><asset><mesh name="m" file="none.stl"/></asset></mujoco>', "`none.stl` does not exist"),
        ('<mujoco><extension><plugin plugin="x"/></extension></mujoco>', "requires a plugin"),
        ('<!DOCTYPE r [<!ENTITY a "aa">]><mujoco/>', "defines the entity"),
        ("<mujoco/>", "the model has no bodies and no geoms"),
        ("<other/>", "unsupported root element `<other>`"),
        (
            '<mujoco><worldbody><geom name="g" size="1" pos="0 inf 0"/></worldbody></mujoco>',
            ":1: the pos of geom `g` is not",
        ),
        (
            '<mujoco><worldbody><geom name="g" size="1" quat="1e308 0 0 0"/></worldbody></mujoco>',
            "`g` is not a valid rotation: 0 0 0",
        ),
        (
            '<mujoco><worldbody><body><joint axis="0 0 1e308"/><geom size="1"/></body></worldbody></mujoco>',
            "the axis of joint number 1 is not a valid direction",
        ),
    ],
)
def test_what_cannot_be_read_is_refused_with_its_reason(tmp_path: Path, text: str, reason: str) -> None:
    source = tmp_path / "one/two/a.xml"
    source.parent.mkdir(parents=True)
    (tmp_path / "secret.stl").write_text("solid a\nendsolid a\n")
    source.write_text(text)
    with pytest.raises(ImportRefusedError, match=reason):
        import_file(source, tmp_path / "one/two/a.scene.yaml", ImportOptions())
    assert [p.name for p in source.parent.iterdir()] == ["a.xml"]


def test_a_keyframe_without_a_rotation_is_taken_as_mujoco_takes_it(importing: Importing) -> None:
    text = """<mujoco><worldbody><body name="ball"><freejoint/><geom size=".1"/></body></worldbody>
    <keyframe><key qpos="0 0 1 0 0 0 0"/></keyframe></mujoco>"""
    _, scene = importing("m.xml", text)
    assert scene.object("ball").X_WO.q.tolist() == [1, 0, 0, 0]
