"""Robots in MJCF: what the robot's own file says is what the scene has."""

from __future__ import annotations

import re
import shutil
import warnings
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from simfoundry.backends.mjcf import compile_mjcf
from simfoundry.geometry.frames import Pose
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene
from simfoundry.scene.robot import ModelFormat
from tests.robots.conftest import lowered

EXACT = 5e-6
"""MuJoCo writes six significant digits of what is neither a pose, a mass nor a limit."""


def built(scene: Scene, folder: Path) -> tuple[Any, Any]:
    """The compiled scene as MuJoCo loads it, in its initial state; a warning is an error."""
    compile_mjcf(scene).write(folder / "built")
    shutil.move(folder / "built", folder / "moved")  # it must not matter where it lies
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = mujoco.MjModel.from_xml_path(str(folder / "moved" / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("initial").id)
    mujoco.mj_forward(model, data)
    return model, data


@pytest.mark.parametrize(("name", "robot"), [("lift", "arm"), ("yam", "right"), ("demo_lift", "arm")])
def test_a_robot_is_as_its_own_file_has_it(
    request: pytest.FixtureRequest, tmp_path: Path, name: str, robot: str
) -> None:
    scene: Scene = request.getfixturevalue(name)
    native = mujoco.MjModel.from_xml_path(str(scene.robot(robot).models[ModelFormat.MJCF].file))
    model, _ = built(scene, tmp_path)
    _same_bodies(native, model, robot)
    _same_joints(native, model, robot)
    _same_actuators(native, model, robot)
    assert [native.geom_type[g] for g in range(native.ngeom)] == [model.geom_type[g] for g in _geoms(model, robot)]
    fingers = model.geom_solmix[_geoms(model, robot)] > 1  # what they hold is to follow them within two steps
    assert 0 < fingers.sum() < len(fingers)
    expected = np.where(fingers[:, None], (2 * model.opt.timestep, 1.0), native.geom_solref)
    assert model.geom_solref[_geoms(model, robot)] == pytest.approx(expected)
    for field in ("geom_friction", "geom_solimp", "geom_contype", "geom_conaffinity", "geom_priority"):
        assert getattr(model, field)[_geoms(model, robot)] == pytest.approx(getattr(native, field)), field
    own = [k for k in range(model.neq) if _owner(model, int(model.eq_obj1id[k]), int(model.eq_type[k])) == robot]
    assert len(own) == native.neq > 0
    assert model.eq_data[own] == pytest.approx(native.eq_data, abs=EXACT)
    assert model.eq_type[own].tolist() == native.eq_type.tolist()


def _same_bodies(native: Any, model: Any, robot: str) -> None:
    for b in range(1, native.nbody):
        twin = model.body(f"{robot}.{native.body(b).name}")
        assert twin.mass == pytest.approx(native.body(b).mass, rel=1e-11)
        assert twin.inertia == pytest.approx(native.body(b).inertia, rel=1e-9)
        assert twin.ipos == pytest.approx(native.body(b).ipos, abs=1e-11)
        assert twin.pos == pytest.approx(native.body(b).pos, abs=1e-11)


def _same_joints(native: Any, model: Any, robot: str) -> None:
    fields = ("type", "axis", "range", "stiffness", "solref", "solimp", "limited")
    dofs = ("damping", "armature", "frictionloss", "solimp", "solref")
    for j in range(native.njnt):
        twin = model.joint(f"{robot}.{native.joint(j).name}").id
        for field in fields:
            found, expected = getattr(model, f"jnt_{field}")[twin], getattr(native, f"jnt_{field}")[j]
            assert found == pytest.approx(expected, abs=EXACT), field
        for field in dofs:
            found = getattr(model, f"dof_{field}")[model.jnt_dofadr[twin]]
            assert found == pytest.approx(getattr(native, f"dof_{field}")[native.jnt_dofadr[j]], abs=EXACT), field


def _same_actuators(native: Any, model: Any, robot: str) -> None:
    assert native.nu > 0
    for k in range(native.nu):
        twin = model.actuator(f"{robot}.{native.actuator(k).name}")
        for field in ("gainprm", "biasprm", "ctrlrange", "forcerange", "biastype", "trntype"):
            expected = getattr(native, f"actuator_{field}")[k]
            assert getattr(model, f"actuator_{field}")[twin.id] == pytest.approx(expected, abs=EXACT), field


def _geoms(model: Any, robot: str) -> list[int]:
    root = model.body(robot).id
    return [g for g in range(model.ngeom) if model.body_rootid[model.geom_bodyid[g]] == root]


def _owner(model: Any, of: int, kind: int) -> str:
    joint = kind == mujoco.mjtEq.mjEQ_JOINT
    return str((model.joint(of) if joint else model.body(of)).name).partition(".")[0]


def test_the_scene_decides_how_it_is_stepped(yam: Scene, tmp_path: Path) -> None:
    model, _ = built(yam, tmp_path)
    assert model.opt.timestep == 1 / 500
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert model.opt.impratio == 10
    assert model.nlight == 1  # the scene's; the robot's file brings one for its own pictures
    assert model.nkey == 1


def test_it_starts_where_the_scene_has_it_and_stays(lift: Scene, tmp_path: Path) -> None:
    robot = lift.robot("arm")
    model, data = built(lift, tmp_path)
    for name, position in robot.positions.items():
        assert data.joint(f"arm.{name}").qpos[0] == pytest.approx(position)
    assert data.body("arm").xpos == pytest.approx(robot.X_WB.p)
    assert Pose.of(q=data.body("arm.link0").xquat).angle_to(robot.X_WB) < 1e-6
    mujoco.mj_step(model, data, nstep=1000)
    for name, position in robot.positions.items():
        assert data.joint(f"arm.{name}").qpos[0] == pytest.approx(position, abs=np.radians(1))
    assert data.joint("arm.left_driver_joint").qpos[0] == pytest.approx(0, abs=0.01)
    assert not any(data.warning[k].number for k in range(len(data.warning)))


def test_a_mounted_camera_rides_on_its_link(lift: Scene, tmp_path: Path) -> None:
    mounted = lift.mounted[0].camera
    model, data = built(lift, tmp_path)
    flip = Pose.of(q=(0.0, 1.0, 0.0, 0.0))  # MuJoCo's camera looks along -z
    for _ in range(2):
        hand = Pose.of(data.site("arm.hand").xpos, _quat(data.site("arm.hand").xmat))
        expected = hand @ mounted.X_WC @ flip
        found = Pose.of(data.cam_xpos[model.camera("wrist").id], _quat(data.cam_xmat[model.camera("wrist").id]))
        assert found.p == pytest.approx(expected.p, abs=1e-5)
        assert found.angle_to(expected) < 1e-5
        data.joint("arm.joint2").qpos[0] += 0.7
        mujoco.mj_forward(model, data)
    assert model.body(model.cam_bodyid[model.camera("wrist").id]).name == "arm.base"
    assert tuple(model.cam_resolution[model.camera("wrist").id]) == (64, 48)


def test_the_hand_is_named_alike_in_every_robot(lift: Scene, yam: Scene, panda_lift: Scene, tmp_path: Path) -> None:
    """Its z axis points to the fingertips, and the fingers open along y."""
    fingers = {
        "lift": (lift, "arm", "left_driver", "right_driver"),
        "yam": (yam, "left", "link_left_finger", "link_right_finger"),
        "panda": (panda_lift, "arm", "panda_leftfinger", "panda_rightfinger"),
    }
    for name, (scene, robot, one, other) in fingers.items():
        model, data = built(scene, tmp_path / name)
        hand = data.site(f"{robot}.hand").xmat.reshape(3, 3)
        ends = [_middle(model, data, f"{robot}.{finger}") for finger in (one, other)]
        assert abs(hand[:, 1] @ (ends[0] - ends[1])) > 0.9 * np.linalg.norm(ends[0] - ends[1]), name
        assert hand[:, 2] @ (sum(ends) / 2 - data.site(f"{robot}.hand").xpos) > 0.03, name


def _middle(model: Any, data: Any, body: str) -> Any:
    """The middle of all that hangs on a body."""
    below = [b for b in range(model.nbody) if body in _chain(model, b)]
    return np.mean([data.xipos[b] for b in below], axis=0)


def _chain(model: Any, b: int) -> list[str]:
    names = []
    while b:
        names.append(model.body(b).name)
        b = int(model.body_parentid[b])
    return names


def _quat(matrix: Any) -> Any:
    q = np.zeros(4)
    mujoco.mju_mat2Quat(q, np.ravel(matrix))
    return q


def test_a_robot_of_ones_own_starts_in_the_home_of_its_file(robot_data: Path, tmp_path: Path) -> None:
    shutil.copytree(robot_data / "i2rt_yam_menagerie", tmp_path / "yam")
    scene = tmp_path / "own.scene.yaml"
    scene.write_text(
        "simfoundry: scene/1\nname: own\nrobots: {own: {model: {mjcf: yam/yam.xml}, joints: {joint1: 0.5}}}\n"
    )
    _, data = built(lower_file(scene), tmp_path)
    assert [data.joint(f"own.joint{k}").qpos[0] for k in range(1, 4)] == pytest.approx([0.5, 1.047, 1.047])
    assert [data.actuator(f"own.joint{k}").ctrl[0] for k in range(1, 4)] == pytest.approx([0.5, 1.047, 1.047])


def test_a_geom_may_be_added_in_any_class_of_a_robot(lift: Scene, tmp_path: Path) -> None:
    """A class that names a material names the robot's, with the robot's prefix."""
    compile_mjcf(lift).write(tmp_path / "built")
    file = tmp_path / "built" / "scene.xml"
    text = file.read_text()
    classes = re.findall(r'<default class="(arm\.[^"]+)"', text)
    assert "arm.visual" in classes and 'material="arm.black_rq"' in text.partition("<asset>")[0]
    added = "".join(f'<geom class="{name}" type="mesh" mesh="arm.base"/>' for name in classes)
    file.write_text(text.replace("<worldbody>", f"<worldbody>{added}", 1))
    model = mujoco.MjModel.from_xml_path(str(file))
    assert model.material(model.geom_matid[classes.index("arm.visual")]).name == "arm.black_rq"


def test_a_build_names_no_place_of_this_machine(lift: Scene, yam: Scene, panda_lift: Scene) -> None:
    for scene in (lift, yam, panda_lift):
        for robot in scene.robots:
            for native in robot.models.values():
                assert str(native.file.parent).encode() not in compile_mjcf(scene).files["scene.xml"]


def test_two_compiles_are_equal(yam: Scene) -> None:
    first, second = compile_mjcf(yam), compile_mjcf(yam)
    assert first.files == second.files


def test_a_gripper_is_attached_to_an_arm(robot_data: Path, tmp_path: Path) -> None:
    """The maker's arm and gripper of the YAM are two files without actuators."""
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "yam.yaml").write_text(f"""\
mjcf:
  file: {robot_data}/i2rt_yam_official/arm/yam/yam.xml
  attach:
    gripper: {{file: {robot_data}/i2rt_yam_official/gripper/linear_4310/linear_4310.xml, to: link6}}
  links: {{base: {{link: base}}, hand: {{link: gripper.gripper, pose: {{rpy_deg: [0, 180, 0]}}}}}}
  joints: [joint1, joint2, joint3, joint4, joint5, joint6]
  gripper: {{joints: {{gripper.joint7: [0.0475, 0], gripper.joint8: [0.0475, 0]}}}}
""")
    scene = tmp_path / "one.scene.yaml"
    scene.write_text("simfoundry: scene/1\nname: one\nrobots: {left: {model: yam}}\n")
    model, data = built(lowered(scene, tmp_path / "own"), tmp_path)
    assert model.body(model.body("left.gripper.gripper").parentid[0]).name == "left.link6"
    assert data.joint("left.gripper.joint7").qpos[0] == pytest.approx(0.0475)
    assert sorted(model.actuator(k).name for k in range(model.nu)) == [
        "left.gripper.joint8",
        *(f"left.joint{k}" for k in range(1, 7)),
    ]  # joint7 follows joint8 by an equality of the file
    mujoco.mj_step(model, data, nstep=1000)
    assert data.joint("left.joint2").qpos[0] == pytest.approx(1.047, abs=np.radians(1))
    losses = {loss.path: loss.reason for loss in compile_mjcf(lowered(scene, tmp_path / "own")).losses}
    assert losses["left.actuators"].startswith("The model has no actuators")
