"""The authors' release in: files as their documentation describes them, with every trap that it names."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from simfoundry.frontends.draft import ImportOptions
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.importer import ImportReport, import_file
from simfoundry.geometry.frames import Pose, quat_from_rpy, to_xyzw
from simfoundry.scene.lower import lower_file
from simfoundry.spec.load import load, load_kind
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import TaskSpec
from simfoundry.spec.yaml.write import to_data

CUP = """<robot name="cup"><link name="base_link">
  <inertial><mass value="0.21"/><inertia ixx="1e-4" iyy="1.1e-4" izz="1.2e-4" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><geometry><cylinder radius="0.04" length="0.1"/></geometry></collision></link></robot>"""
DRAWERS = """<robot name="organizer"><link name="base_link">
  <inertial><mass value="2"/><inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><geometry><box size="0.3 0.2 0.2"/></geometry></collision></link>
  <link name="drawer_1_link"><inertial><mass value="0.4"/>
  <inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><geometry><box size="0.2 0.1 0.05"/></geometry></collision></link>
  <joint name="base_link_to_drawer_1_link" type="prismatic"><parent link="base_link"/><child link="drawer_1_link"/>
  <axis xyz="1 0 0"/><limit lower="0" upper="0.2" effort="1" velocity="1"/></joint></robot>"""
TURN = quat_from_rpy(0.1, -0.2, 0.9)


def _object(name: str, category: str, model: str, **more: Any) -> dict[str, Any]:
    args = {"name": name, "category": category, "model": model, "dataset_name": "real2sim-assets", "scale": [1, 1, 1]}
    return {
        "class_module": "omnigibson.objects.dataset_object", "class_name": "DatasetObject", "args": {**args, **more},
    }  # fmt: skip


def _state(x: float, y: float, z: float, **more: Any) -> dict[str, Any]:
    root = {"pos": [x, y, z], "ori": to_xyzw(TURN).tolist(), "lin_vel": [0, 0, 0], "ang_vel": [0, 0, 0]}
    return {"root_link": root, **more}


@pytest.fixture
def release(tmp_path: Path) -> Path:
    """A scene of the release with its folders; returns the scene file."""
    for category, model, text in (("blue_cup", "qwerty", CUP), ("desk_organizer", "asdfgh", DRAWERS)):
        folder = tmp_path / "s10_sim/objects" / category / model / "urdf"
        folder.mkdir(parents=True)
        (folder / f"{model}.urdf").write_text(text)
    listed = {"0": {"category": "blue_cup", "model": "qwerty", "name": "iter_0", "friction": 0.35}}
    (tmp_path / "s10_sim/scene_objects_info.json").write_text(json.dumps(listed))
    infos = {
        "iter_0": _object("iter_0", "blue_cup", "qwerty"),
        "iter_1": _object("iter_1", "blue_cup", "qwerty", mass=0.2),
        "iter_2": _object("iter_2", "desk_organizer", "asdfgh", fixed_base=True),
        "robot0": {
            "class_module": "omnigibson.robots.franka",
            "class_name": "FrankaPanda",
            "args": {"end_effector": "robotiq"},
        },
        "gs_background": {"class_module": "omnigibson.objects.usd_object", "class_name": "USDObject", "args": {}},
    }
    states = {
        "iter_0": _state(0.4, 0.1, 0.05), "iter_1": _state(0.5, -0.1, 0.05),
        "iter_2": _state(0.6, 0.3, 0.1, joint_pos=[0.07]), "robot0": _state(-1, 0, 0, joint_pos=[0.1] * 9),
    }  # fmt: skip
    states["iter_1"]["root_link"]["lin_vel"] = [0, 0, -0.2]
    scene = {
        "init_info": {"args": {"use_floor_plane": True}}, "objects_info": {"init_info": infos},
        "state": {"registry": {"object_registry": states}}, "ground_plane_info": {"position": [0, 0, 0.03]},
    }  # fmt: skip
    (tmp_path / "s13_og").mkdir()
    file = tmp_path / "s13_og/reconstructed_og_scene.json"
    file.write_text(json.dumps(scene))
    return file


def _imported(release: Path) -> tuple[ImportReport, Path]:
    out = release.parent / "desk.scene.yaml"
    return import_file(release, out, ImportOptions(force=True)), out


def test_what_stands_in_four_files_becomes_one_scene(release: Path) -> None:
    _, out = _imported(release)
    scene = lower_file(out)
    cup, organizer, table = (scene.object(n) for n in ("blue_cup", "desk_organizer", "table"))
    assert cup.links[0].mass == pytest.approx(0.21)
    assert cup.links[0].colliders[0].friction == 0.35
    assert cup.X_WO.angle_to(Pose.of(q=TURN)) < 1e-8
    assert scene.object("blue_cup_2").links[0].colliders[0].friction == 0.5
    assert organizer.fixed and organizer.joints[0].position == pytest.approx(0.07)
    assert table.fixed and table.X_WO.p[2] + 0.02 == pytest.approx(0.03)
    spec = load_kind(out, "scene/1").spec
    assert isinstance(spec, SceneSpec)
    assert spec.robots["robot0"].model == "franka_robotiq"
    assert spec.robots["robot0"].pose.xyz == (-1, 0, 0)


def test_every_trap_is_said(release: Path) -> None:
    report, _ = _imported(release)
    said = {(str(n.kind), n.what) for n in report.notes}
    assert {
        ("dropped", "velocity of `iter_1`"),
        ("dropped", "`mass` of `iter_1` in the scene"),
        ("dropped", "`gs_background`"),
        ("changed", "posture of robot `robot0`"),
        ("changed", "`ground_plane_info`"),
        ("changed", "the infinite plane that serves as the table"),
    } <= said


TASK = """task_name: droid_desk_put_away
language_instruction: "Put the cup in the drawer"
og_task_config:
  type: PickPlaceTask
  activity_name: ${task_name}
  semantic_group_mapping: {robot: [agent], cup: [iter_0], cups: [blue_cup, iter_1], organizer: [desk_organizer]}
  goal_predicates_all:
    - {state: OnTop, state_kwargs: null, value: true, group: cup, other_group: organizer}
    - {state: Open, value: false, group: organizer, other_group: null}
  goal_predicates_any: [{state: Touching, value: false, group: robot, other_group: cup}]
  milestone_predicates:
    - {name: placed, state: OnTop, value: true, group: cup, other_group: organizer, requires: [picked_cup]}
    - {name: picked_cup, state: IsGrasping, value: true, group: robot, other_group: cup, requires: []}
  group_init_joint_positions: {organizer: {base_link_to_drawer_1_link: 0.10}}
  group_xyz_randomization: {cup: [0.165, 0.11, 0]}
  group_z_rot_randomization: {cup: 3.14}
  ground_plane_z_randomization: 0.10
  termination_config: {max_steps: 900}
"""


def _task(release: Path, text: str) -> tuple[ImportReport, TaskSpec]:
    _, scene = _imported(release)
    source = release.parent / "put_away.yaml"
    source.write_text(text)
    out = release.parent / "put_away.task.yaml"
    report = import_file(source, out, ImportOptions(scene=scene, force=True))
    spec = load(out).spec
    assert isinstance(spec, TaskSpec)
    return report, spec


def test_a_task_keeps_goal_steps_starts_and_ranges(release: Path) -> None:
    report, task = _task(release, TASK)
    text = (release.parent / "put_away.task.yaml").read_text()
    for goal in ("OnTop(blue_cup, desk_organizer)", "Closed(desk_organizer)", "Released(blue_cup)"):
        assert goal in text
    assert list(task.subtasks) == ["picked_cup", "placed"]
    assert task.subtasks["picked_cup"].goal == "Grasped(blue_cup)"
    assert task.start.joints["desk_organizer"] == {"base_link_to_drawer_1_link": 0.1}
    region = task.reset.objects["blue_cup"]
    assert region.x == pytest.approx((0.235, 0.565)) and region.y == pytest.approx((-0.01, 0.21))
    assert region.yaw_deg == pytest.approx((-math.degrees(3.14), math.degrees(3.14)))
    assert (task.horizon, task.control_hz, task.scene) == (900, 15, "desk.scene.yaml")
    said = {(str(n.kind), n.what) for n in report.notes}
    assert ("dropped", "`ground_plane_z_randomization`") in said
    assert ("assumed", "`OnTop(blue_cup, desk_organizer)`") in said


def test_all_and_any_are_about_the_objects_of_a_group(release: Path) -> None:
    every = "goal_predicates_all: [{state: Lifted, group: cups}]"
    some = "goal_predicates_any: [{state: OnTop, group: cups, other_group: organizer}]"
    goals = f"{every}\n  {some}"
    start, end = TASK.index("goal_predicates_all"), TASK.index("milestone")
    _, task = _task(release, TASK[:start] + goals + "\n  " + TASK[end:])
    lifted = {"all": ("Lifted(blue_cup)", "Lifted(blue_cup_2)")}
    on_top = {"any": ("OnTop(blue_cup, desk_organizer)", "OnTop(blue_cup_2, desk_organizer)")}
    assert to_data(task)["goal"] == {"all": (lifted, on_top)}


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        (TASK[TASK.index("  goal_predicates_all") : TASK.index("  milestone")], "", "the goal is empty"),
        ("cup: [iter_0]", "cup: [iter_9]", "the scene has no object `iter_9`"),
        ("cup: [iter_0]", "cup: []", "the group `cup` is empty"),
        ("state: Open,", "state: Cooked,", "the state `Cooked` of .* has no corresponding predicate"),
        (
            "other_group: organizer}\n    - {state: Open",
            "other_group: cups}\n    - {state: Open",
            "must match exactly one object",
        ),
        ("requires: []", "requires: [placed]", "require each other in a cycle"),
        ("og_task_config", "config", "no `og_task_config`"),
    ],
)
def test_tasks_that_mean_nothing_are_refused(release: Path, old: str, new: str, reason: str) -> None:
    with pytest.raises(ImportRefusedError, match=reason):
        _task(release, TASK.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ('"qwerty"', '"../../x"', "no usable category and model"),
        ('"qwerty"', '"zzz"', "could not find the URDF of `iter_0`: objects/blue_cup/zzz"),
        ('"registry"', '"nothing"', "the file has no `state.registry.object_registry`"),
        ('"scale": [1, 1, 1]', '"scale": [1, 2, 1]', "only uniform scales"),
        ('"pos"', '"position"', "no usable `root_link.pos`"),
        ("{", "[", "the file is not valid JSON"),
    ],
)
def test_scenes_that_cannot_be_read_are_refused(release: Path, old: str, new: str, reason: str) -> None:
    release.write_text(release.read_text().replace(old, new))
    with pytest.raises(ImportRefusedError, match=reason):
        _imported(release)


def test_an_even_scale_is_applied(release: Path) -> None:
    release.write_text(release.read_text().replace('"scale": [1, 1, 1]', '"scale": [2, 2, 2]', 1))
    _, out = _imported(release)
    cup = lower_file(out).object("blue_cup").links[0]
    assert cup.mass == pytest.approx(0.21) and cup.inertia[2, 2] == pytest.approx(4.8e-4)
    assert cup.colliders[0].geometry.radius == pytest.approx(0.08)  # type: ignore[union-attr]
