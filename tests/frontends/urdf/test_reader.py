"""URDF in: frames, masses, limits, shapes; and what a file may not do."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from simfoundry.frontends.draft import ImportOptions
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.importer import import_file
from simfoundry.geometry.frames import Pose, quat_from_rpy
from simfoundry.geometry.shapes import Box, Cylinder, Mesh
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import JointType
from tests.cli.command import run
from tests.frontends.conftest import Importing

INERTIAL = '<inertial><mass value="2"/><inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0" ixz="0" iyz="0"/></inertial>'
BOX = '<collision><geometry><box size="0.1 0.2 0.3"/></geometry></collision>'
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 3\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"


def _robot(*parts: str) -> str:
    return f'<robot name="Thing">{"".join(parts)}</robot>'


def _link(name: str, inside: str = INERTIAL + BOX) -> str:
    return f'<link name="{name}">{inside}</link>'


def _joint(kind: str, inside: str, name: str = "j", parent: str = "a", child: str = "b") -> str:
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{inside}</joint>'


def test_inertia_is_turned_into_the_axes_of_the_link(importing: Importing) -> None:
    inertial = """<inertial><origin xyz="0.1 -0.2 0.3" rpy="0.4 -0.5 0.6"/><mass value="1.5"/>
        <inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0.001" ixz="-0.002" iyz="0.003"/></inertial>"""
    _, scene = importing("a.urdf", _robot(_link("a", inertial + BOX)))
    (link,) = scene.objects[0].links
    tensor = np.array([[0.02, 0.001, -0.002], [0.001, 0.03, 0.003], [-0.002, 0.003, 0.04]])
    R = Pose.of(q=quat_from_rpy(0.4, -0.5, 0.6)).rotation
    assert link.mass == 1.5
    assert link.com == pytest.approx([0.1, -0.2, 0.3])
    assert link.inertia == pytest.approx(R @ tensor @ R.T, rel=1e-8)


def test_a_joint_keeps_pose_axis_limits_and_dynamics(importing: Importing) -> None:
    inside = """<origin xyz="0.3 0.1 -0.2" rpy="0.7 0.2 -1.1"/><axis xyz="1 2 -2"/>
        <dynamics damping="0.4" friction="0.2"/>
        <limit lower="-0.5" upper="1.25" effort="3" velocity="1"/>"""
    report, scene = importing("a.urdf", _robot(_link("a"), _link("b"), _joint("revolute", inside)))
    (joint,) = scene.objects[0].joints
    expected = Pose.of([0.3, 0.1, -0.2], quat_from_rpy(0.7, 0.2, -1.1))
    assert joint.type is JointType.REVOLUTE
    assert joint.X_PC.p == pytest.approx(expected.p)
    assert joint.X_PC.angle_to(expected) < 1e-8
    assert joint.axis == pytest.approx([1 / 3, 2 / 3, -2 / 3])
    assert joint.limits == pytest.approx((-0.5, 1.25))
    assert (joint.damping, joint.friction) == (0.4, 0.2)
    assert (joint.effort, joint.velocity) == pytest.approx((3.0, 1.0))
    assert not report.notes


def test_what_is_seen_and_what_touches_stay_apart(importing: Importing) -> None:
    visual = '<visual><origin xyz="0 0 1"/><geometry><cylinder radius="0.2" length="0.5"/></geometry></visual>'
    _, scene = importing("a.urdf", _robot(_link("a", INERTIAL + visual + BOX)))
    (link,) = scene.objects[0].links
    assert [v.geometry for v in link.visuals] == [Cylinder(0.2, 0.5)]
    assert link.visuals[0].X_LG.p == pytest.approx([0, 0, 1])
    (collider,) = link.colliders
    assert isinstance(collider.geometry, Box) and collider.geometry.size == pytest.approx([0.1, 0.2, 0.3])


def test_what_is_seen_and_touches_alike_is_one_part(importing: Importing, tmp_path: Path) -> None:
    both = BOX + BOX.replace("collision", "visual")
    importing("a.urdf", _robot(_link("a", INERTIAL + both)))
    text = (tmp_path / "out/thing_files/thing.asset.yaml").read_text()
    assert "use:" not in text and text.count("shape:") == 1


@pytest.mark.parametrize(("scale", "size"), [("0.1 0.1 0.1", (0.1, 0.2, 0.3)), ("0.1 -0.2 0.05", (0.1, 0.4, 0.15))])
def test_meshes_are_scaled_and_mirrored(
    importing: Importing, tmp_path: Path, scale: str, size: tuple[float, ...]
) -> None:
    (tmp_path / "source").mkdir()
    (tmp_path / "source" / "t.obj").write_text(TETRAHEDRON)
    mesh = f'<collision><geometry><mesh filename="t.obj" scale="{scale}"/></geometry></collision>'
    _, scene = importing("a.urdf", _robot(_link("a", INERTIAL + mesh)))
    (collider,) = scene.objects[0].links[0].colliders
    assert isinstance(collider.geometry, Mesh)
    vertices, faces = collider.geometry.vertices, collider.geometry.faces
    assert np.ptp(vertices, axis=0) == pytest.approx(size)
    assert (vertices[:, 1].min() < -0.3) == ("-" in scale)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6 == pytest.approx(np.prod(size) / 6)


def _tray(path: Path) -> None:
    """An OBJ of a floor, two walls and a flat label, each a group; the last names its corners from the end."""
    text, count = "", 0
    for name, (x, z), (width, height) in (
        ("o floor", (0, 0.01), (0.4, 0.02)),
        ("g left wall", (-0.19, 0.1), (0.02, 0.2)),
        ("\to right", (0.19, 0.1), (0.02, 0.2)),
    ):
        corners = [
            (x + sx * width / 2, y, z + sz * height / 2) for y in (-0.2, 0.2) for sz in (-1, 1) for sx in (-1, 1)
        ]
        text += f"{name}\n" + "".join(f"v {x:g} {y:g} {z:g}\n" for x, y, z in corners)
        quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        text += "".join("f " + " ".join(f"{count + k + 1}/" for k in quad) + "\n" for quad in quads)
        count += 8
    text += "g\no label\nv 0 0 .02\nv .1 0 .02\nv 0 .1 .02\nf -3 -2 -1\no nothing\n"
    path.write_text(text)


def test_each_group_of_an_obj_touches_as_a_hull_of_its_own(importing: Importing, tmp_path: Path) -> None:
    """As in PyBullet, so that what is dropped into a drawer lands on its floor."""
    (tmp_path / "source").mkdir()
    _tray(tmp_path / "source" / "tray.obj")
    geometry = '<geometry><mesh filename="tray.obj" scale="1 2 -1"/></geometry>'
    shown = f"<visual>{geometry}</visual><collision>{geometry}</collision>"
    report, scene = importing("a.urdf", _robot(_link("a", INERTIAL + shown)))
    (link,) = scene.objects[0].links
    vertices = [c.geometry.vertices for c in link.colliders if isinstance(c.geometry, Mesh)]
    bounds = sorted((*v.min(axis=0).round(6), *v.max(axis=0).round(6)) for v in vertices)
    assert len(link.visuals) == 1 and len(bounds) == 3
    assert {n.what for n in report.notes} == {"collision mesh of `a`", "contact of `label` of link `a`"}
    walls = [(-0.2, -0.4, -0.2, -0.18, 0.4, 0.0), (0.18, -0.4, -0.2, 0.2, 0.4, 0.0)]
    assert np.array(bounds) == pytest.approx(np.array([walls[0], (-0.2, -0.4, -0.02, 0.2, 0.4, 0.0), walls[1]]))


def test_masses_that_nobody_states_are_warned_of_and_given_by_a_density(tmp_path: Path) -> None:
    source, out = tmp_path / "a.urdf", tmp_path / "a.asset.yaml"
    source.write_text(_robot(_link("a"), _link("b", BOX), _joint("continuous", "")))
    shown = run("import", source, "-o", out)
    assert (
        "warning: 1 link has no mass; solid shapes of 1000 kg/m^3 are assumed, for a total of 6 kg: b 6 kg;"
        in shown.out
    )
    assert run("import", source, "-o", out, "--force", "--json").json["assumed_masses"] == pytest.approx({"b": 6.0})
    shown = run("import", source, "-o", out, "--force", "--density", "600")
    assert "warning" not in shown.out and "600 kg/m^3" in shown.out
    assert "    density: 600\n" in out.read_text()
    source.with_suffix(".xml").write_text("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    refused = run("import", source.with_suffix(".xml"), "--density", "600")
    assert refused.code == 2 and "`--density` does not apply to MJCF" in refused.err


def test_a_frame_without_mass_becomes_part_of_what_carries_it(importing: Importing) -> None:
    tip = _link("tip", BOX.replace("collision", "visual"))
    text = _robot(
        _link("a"), tip, _link("b"),
        _joint("fixed", '<origin xyz="0 0 1" rpy="0 0 1.2"/>', "m", "a", "tip"),
        _joint("continuous", '<origin xyz="0.5 0 0"/>', "j", "tip", "b"),
    )  # fmt: skip
    report, scene = importing("a.urdf", text)
    (thing,) = scene.objects
    assert [link.name for link in thing.links] == ["a", "b"]
    assert link_poses(thing)["b"].p == pytest.approx([0.5 * math.cos(1.2), 0.5 * math.sin(1.2), 1])
    assert len(thing.links[0].visuals) == 1
    assert [n.what for n in report.notes] == ["link `tip`"]


def test_the_world_link_fixes_the_thing(importing: Importing) -> None:
    text = _robot('<link name="world"/>', _link("a"), _joint("fixed", '<origin xyz="0 0 0.5"/>', "m", "world", "a"))
    _, scene = importing("a.urdf", text)
    assert scene.objects[0].fixed
    assert scene.objects[0].links[0].com == pytest.approx([0, 0, 0.5])


def test_an_inertia_that_no_body_has_is_that_of_the_shapes(importing: Importing) -> None:
    wrong = INERTIAL.replace('izz="0.04"', 'izz="0"').replace("<mass", '<origin xyz="0.01 0 0"/><mass')
    report, scene = importing("a.urdf", _robot(_link("a", wrong + BOX)))
    (link,) = scene.objects[0].links
    assert link.com == pytest.approx([0.01, 0, 0])
    assert np.diag(link.inertia) == pytest.approx(2 / 12 * np.array([0.13, 0.10, 0.05]))
    assert [(str(n.kind), n.what) for n in report.notes] == [("changed", "inertia of `a`")]


def test_a_link_that_only_joins_two_joints_weighs_next_to_nothing(importing: Importing) -> None:
    """Joints with several degrees of freedom are often written as links of nothing between them."""
    joints = _joint("continuous", "") + _joint("continuous", '<axis xyz="0 1 0"/>', "k", "b", "c")
    report, scene = importing("a.urdf", _robot(_link("a"), _link("b", ""), _link("c"), joints))
    _, between, carried = scene.objects[0].links
    assert 0 < between.mass < 1e-6 * carried.mass and np.linalg.eigvalsh(between.inertia).min() > 1e-15
    assert "mass of `b`" in {n.what for n in report.notes}


def test_a_mass_without_inertia_at_a_fixed_joint_stays_a_point(importing: Importing) -> None:
    point = '<inertial><origin xyz="0.1 0 0"/><mass value="0.3"/><inertia ixx="0" iyy="0" izz="0"/></inertial>' + BOX
    _, scene = importing("a.urdf", _robot(_link("a"), _link("b", point), _joint("fixed", "")))
    link = scene.objects[0].links[1]
    assert link.mass == 0.3 and 0 < np.linalg.eigvalsh(link.inertia).max() < 1e-12
    _, scene = importing("a.urdf", _robot(_link("a"), _link("b", point), _joint("continuous", "")))
    assert np.linalg.eigvalsh(scene.objects[0].links[1].inertia).min() > 1e-4  # of its shapes


def test_an_inertia_that_overflows_is_that_of_the_shapes(importing: Importing) -> None:
    huge = '<inertial><origin rpy="1 2 3"/><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixz="1e308"/></inertial>'
    report, scene = importing("a.urdf", _robot(_link("a", huge + BOX)))
    assert np.isfinite(scene.objects[0].links[0].inertia).all()
    assert [n.what for n in report.notes] == ["inertia of `a`"]


@pytest.mark.parametrize("scheme", ["package://", "package:///"])
def test_packages_are_found_upward_by_name_or_as_told(tmp_path: Path, scheme: str) -> None:
    mesh = f'<collision><geometry><mesh filename="{scheme}bot/m/t.obj"/></geometry></collision>'
    source = tmp_path / "bot/urdf/a.urdf"
    source.parent.mkdir(parents=True)
    source.write_text(_robot(_link("a", INERTIAL + mesh)))
    out = tmp_path / "out/a.asset.yaml"
    with pytest.raises(ImportRefusedError, match=r"a\.urdf:1: .*--package bot=PATH"):
        import_file(source, out)
    assert (not out.exists() and not out.parent.exists()) or not list(out.parent.iterdir())
    for place in ("bot/m", "elsewhere/m"):
        (tmp_path / place).mkdir(parents=True)
    (tmp_path / "elsewhere/m/t.obj").write_text(TETRAHEDRON)
    assert import_file(source, out, ImportOptions({"bot": tmp_path / "elsewhere"})).meshes == 1
    (tmp_path / "bot/m/t.obj").write_text(TETRAHEDRON)
    assert import_file(source, out, ImportOptions(force=True)).meshes == 1


def test_mimic_and_contact_are_kept(importing: Importing) -> None:
    contact = """<contact><lateral_friction value="0.8"/><spinning_friction value="0.01"/>
        <rolling_friction value="0.002"/><restitution value="0.3"/></contact>"""
    limit = '<limit lower="-1" upper="1" effort="0" velocity="0"/>'
    text = _robot(
        _link("a", INERTIAL + BOX + contact), _link("b"), _link("c"), _joint("revolute", limit),
        _joint("revolute", limit + '<mimic joint="j" multiplier="-0.5" offset="0.1"/>', "k", "a", "c"),
    )  # fmt: skip
    report, scene = importing("a.urdf", text)
    (thing,) = scene.objects
    follower = next(j for j in thing.joints if j.name == "k")
    assert follower.mimic is not None
    assert (follower.mimic.joint, follower.mimic.multiplier, follower.mimic.offset) == ("j", -0.5, 0.1)
    collider = thing.links[0].colliders[0]
    assert (collider.friction, collider.restitution) == (0.8, 0.3)
    assert (collider.torsional_friction, collider.rolling_friction) == (0.01, 0.002)
    assert not report.notes


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("<robot name='a'>", r"a\.urdf:1: the file is not valid XML"),
        ("<sdf/>", r"a\.urdf:1: the root element must be `<robot>`, not `<sdf>`"),
        ('<!DOCTYPE r [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]><robot name="&b;"/>', "defines the entity `a`"),
        (_robot(), "the robot has no links"),
        (_robot(_link("a"), _link("a")), "there is more than one link named `a`"),
        (_robot(_link("a"), _link("b")), "the robot has 2 root links: `a`, `b`"),
        (_robot(_link("a"), _joint("fixed", "")), "refers to link `b`, which does not exist"),
        (
            _robot(_link("a"), _link("b"), _joint("fixed", "", "i"), _joint("fixed", "", "k", "b", "a")),
            "there is no root link",
        ),
        (_robot(_link("a", INERTIAL.replace('"2"', '"nan"'))), "`value` of `<mass>` must be a number, not `nan`"),
        (_robot(_link("a", INERTIAL.replace('"2"', '"-2"'))), "link `a` has an invalid mass of -2 kg"),
        (_robot(_link("a", BOX.replace("0.1 0.2", "0.1 -0.2"))), "has a negative size"),
        (_robot(_link("a", BOX.replace("0.1 0.2", "0.1"))), "`size` of `<box>` must be 3 numbers, not `0.1 0.3`"),
        (_robot(_link("a"), _link("b"), _joint("bendy", "")), "`bendy`, which is not a URDF joint type"),
        (_robot(_link("a"), '<link name="b"/>', _joint("continuous", "")), "moves but has neither a mass nor a shape"),
        (
            _robot(
                _link("a", '<visual><geometry><mesh filename="package://../../../../etc/passwd"/></geometry></visual>')
            ),
            "could not be found",
        ),
        (
            _robot(_link("a", '<visual><geometry><mesh filename="../../secret.obj"/></geometry></visual>')),
            "is outside",
        ),
    ],
)
def test_what_cannot_be_read_is_refused_with_its_reason(tmp_path: Path, text: str, reason: str) -> None:
    source = tmp_path / "one/two/a.urdf"
    source.parent.mkdir(parents=True)
    (tmp_path / "secret.obj").write_text(TETRAHEDRON)
    source.write_text(text)
    with pytest.raises(ImportRefusedError, match=reason):
        import_file(source, tmp_path / "one/two/a.scene.yaml")
    assert [p.name for p in source.parent.iterdir()] == ["a.urdf"]


def test_the_same_file_gives_the_same_bytes(importing: Importing, tmp_path: Path) -> None:
    text = _robot(_link("a"), _link("b"), _joint("continuous", '<origin rpy="0.1 0.2 0.3"/>'))
    importing("a.urdf", text)
    first = {p.name: p.read_bytes() for p in sorted((tmp_path / "out").rglob("*.yaml"))}
    importing("a.urdf", text)
    assert {p.name: p.read_bytes() for p in sorted((tmp_path / "out").rglob("*.yaml"))} == first


def test_a_planar_joint_has_three_axes(importing: Importing) -> None:
    inside = '<origin xyz="0 0 1"/><axis xyz="0 0 2"/><limit effort="3" velocity="1"/>'
    _, scene = importing("a.urdf", _robot(_link("a"), _link("b"), _joint("planar", inside)))
    slide_x, slide_y, turn = scene.objects[0].joints
    assert [str(joint.type) for joint in (slide_x, slide_y, turn)] == ["prismatic", "prismatic", "continuous"]
    assert [joint.axis.tolist() for joint in (slide_x, slide_y, turn)] == [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    assert slide_x.X_PC.p.tolist() == [0, 0, 1] and slide_y.X_PC.is_identity
