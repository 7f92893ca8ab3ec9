"""Settling: overlaps open gently, what floats comes down, what cannot stay is named, and nothing else changes."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from simfoundry.cousins.layout.acceptance import settle_layout
from simfoundry.cousins.layout.twin import bare
from simfoundry.geometry.frames import frozen_array
from simfoundry.scene.lower import lower, lower_file
from simfoundry.scene.model import Scene
from simfoundry.spec.load import load, load_scene
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.worlds import World, open_world, world_names
from simfoundry.worlds.base import Contact
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.rest import supporters
from simfoundry.worlds.settle import ObjectSettle, SettleResult, settle
from tests.cli.command import run
from tests.conftest import REPOSITORY

Settle = Callable[..., SettleResult]

HEAD = """\
simfoundry: scene/1
name: settling
objects:
  desk: {fixed: true, shape: {box: [0.8, 0.6, 0.04]}, pose: {xyz: [0, 0, -0.02]}}
"""


def write(folder: Path, objects: str, relations: str = "") -> Path:
    file = folder / "settling.scene.yaml"
    file.write_text(HEAD + objects + relations, encoding="utf-8")
    return file


@pytest.fixture(params=sorted(world_names()))
def settled(request: pytest.FixtureRequest, tmp_path: Path) -> Settle:
    if request.param == "pybullet":
        pytest.importorskip("pybullet", reason="PyBullet is not installed")

    def run_engine(objects: str, relations: str = "") -> SettleResult:
        with open_world(lower_file(write(tmp_path, objects, relations)), request.param) as world:
            return settle(world)

    return run_engine


def of(result: SettleResult, name: str) -> ObjectSettle:
    return next(o for o in result.objects if o.name == name)


def test_overlapping_boxes_part_without_an_explosion(settled: Settle) -> None:
    result = settled(
        "  left: {shape: {box: [0.10, 0.08, 0.06]}, mass: 0.3, pose: {xyz: [0, 0, 0.03], yaw_deg: 10}}\n"
        "  right: {shape: {box: [0.06, 0.08, 0.09]}, mass: 0.2, pose: {xyz: [0.072, 0.01, 0.045], yaw_deg: 10}}\n"
    )
    left, right = of(result, "left"), of(result, "right")
    assert min(left.penetration_before, right.penetration_before) > 0.004
    assert max(left.penetration_after, right.penetration_after) < 0.001
    assert max(left.drift, right.drift) < 0.015
    assert max(left.tilt_deg, right.tilt_deg) < 1.0
    assert result.passed, [o.problems for o in result.objects]


def test_a_thing_in_the_table_comes_up(settled: Settle) -> None:
    result = settled("  box: {shape: {box: [0.1, 0.08, 0.06]}, mass: 0.3, pose: {xyz: [0, 0, 0.025], yaw_deg: 33}}\n")
    box = of(result, "box")
    assert box.penetration_before == pytest.approx(0.005, abs=2e-4)
    assert box.penetration_after < 0.001
    assert float(result.state.poses["box"].p[2]) == pytest.approx(0.03, abs=1e-3)
    assert box.tilt_deg < 0.5 and result.passed


def test_a_floating_thing_comes_down_flat(settled: Settle) -> None:
    result = settled(
        "  box: {shape: {box: [0.1, 0.08, 0.06]}, mass: 0.3, pose: {xyz: [0.1, 0.05, 0.042], yaw_deg: 33}}\n"
    )
    box = of(result, "box")
    assert float(result.state.poses["box"].p[2]) == pytest.approx(0.03, abs=1e-3)
    assert box.drift == pytest.approx(0.012, abs=1e-3)
    assert box.supports == ("desk",) and box.tilt_deg < 0.5 and result.passed


def test_a_thing_that_only_sank_a_little_passes(settled: Settle) -> None:
    result = settled("  box: {shape: {box: [0.1, 0.08, 0.06]}, mass: 0.3, pose: {xyz: [0, 0, 0.0303]}}\n")
    assert of(result, "box").drift < 0.001 and of(result, "box").passed


def test_a_pencil_on_its_tip_does_not_pass(settled: Settle) -> None:
    """Upright to the last bit, a simulator balances it for ever; one that leans falls by itself."""
    pencil = "  pencil: {shape: {capsule: {radius: 0.004, height: 0.16}}, mass: 0.01, pose: {xyz: [0, 0, 0.084]%s}}\n"
    upright = of(settled(pencil % ""), "pencil")
    assert not upright.passed
    assert any("topples" in p or "tilted" in p for p in upright.problems)
    leaning = of(settled(pencil % ", rpy_deg: [2, 1, 0]"), "pencil")
    assert leaning.tilt_deg > 45 and any("tilted" in p for p in leaning.problems)


@pytest.mark.parametrize(
    "steady",
    [
        "shape: {box: [0.03, 0.12, 0.2]}, mass: 0.3, pose: {xyz: [0, 0, 0.1], yaw_deg: 20}",
        "shape: {cylinder: {radius: 0.01, height: 0.18}}, mass: 0.1, pose: {xyz: [0, 0, 0.09]}",
        "shape: {sphere: 0.035}, mass: 0.1, pose: {xyz: [0, 0, 0.035], rpy_deg: [70, 20, 0]}",
        "shape: {capsule: {radius: 0.02, height: 0.1}}, mass: 0.1, pose: {xyz: [0, 0, 0.02], rpy_deg: [90, 0, 75]}",
    ],
    ids=["cereal", "candle", "ball", "pill"],
)
def test_what_stands_by_itself_passes(settled: Settle, steady: str) -> None:
    result = settled(f"  thing: {{{steady}}}\n")
    assert result.passed, of(result, "thing").problems


def test_a_can_on_its_side_stays(tmp_path: Path) -> None:
    """In MuJoCo: PyBullet's cylinders have no rolling resistance, and one on its side rolls away."""
    can = "shape: {cylinder: {radius: 0.04, height: 0.12}}, mass: 0.3, pose: {xyz: [0, 0, 0.04], rpy_deg: [90, 0, 30]}"
    with open_world(lower_file(write(tmp_path, f"  can: {{{can}}}\n")), "mujoco") as world:
        result = settle(world)
    assert result.passed, of(result, "can").problems


def test_what_would_roll_off_the_table_is_calmed(settled: Settle) -> None:
    """Down a board of 25 degrees a ball gathers speed for the edge; calmed, it lies where the board ends."""
    result = settled(
        "  board: {fixed: true, shape: {box: [0.2, 0.2, 0.02]}, pose: {xyz: [0.2, 0, 0.06], rpy_deg: [0, 25, 0]}}\n"
        "  ball: {shape: {sphere: 0.03}, mass: 0.1, pose: {xyz: [0.16, 0.02, 0.13]}}\n"
    )
    ball = result.state.poses["ball"].p
    assert ball[2] == pytest.approx(0.03, abs=2e-3)  # on the table
    assert 0.25 < ball[0] < 0.45
    assert not result.passed and any("moved" in p for p in of(result, "ball").problems)


def test_what_falls_off_the_table_is_said_and_the_rest_settles(settled: Settle) -> None:
    result = settled(
        "  edge: {shape: {box: [0.1, 0.1, 0.1]}, mass: 0.3, pose: {xyz: [0.43, 0.1, 0.05], yaw_deg: 15}}\n"
        "  cup: {shape: {cylinder: {radius: 0.04, height: 0.1}}, mass: 0.2, pose: {xyz: [0, 0, 0.051]}}\n",
        "relations: [OnTop(edge, desk), OnTop(cup, desk)]\n",
    )
    edge, cup = of(result, "edge"), of(result, "cup")
    assert not result.passed and not result.at_rest
    assert any("fell off" in p for p in edge.problems) and "is not supported by anything" in edge.problems
    assert not edge.support_kept and edge.supports == ()
    assert cup.passed and cup.support_kept
    assert result.state.poses["edge"].p.tolist() == pytest.approx([0.43, 0.1, 0.05])  # not 300 m below


def test_lost_and_kept_support_is_reported(settled: Settle) -> None:
    result = settled(
        "  book: {shape: {box: [0.2, 0.15, 0.03]}, mass: 0.4, pose: {xyz: [0, 0, 0.015], yaw_deg: 12}}\n"
        "  tea: {shape: {box: [0.07, 0.06, 0.08]}, mass: 0.1, pose: {xyz: [0.02, 0.01, 0.071], yaw_deg: 40}}\n"
        "  cup: {shape: {cylinder: {radius: 0.03, height: 0.08}}, mass: 0.1, pose: {xyz: [0.25, 0.1, 0.04]}}\n",
        "relations: [OnTop(tea, book), OnTop(book, desk), OnTop(cup, book)]\n",
    )
    assert of(result, "tea").supports == ("book",) and of(result, "tea").support_kept
    assert of(result, "cup").supports == ("desk",) and not of(result, "cup").support_kept
    assert of(result, "cup").problems == ("no longer on book",)


def test_fixed_things_may_overlap(settled: Settle) -> None:
    result = settled(
        "  shelf: {fixed: true, shape: {box: [0.2, 0.2, 0.1]}, pose: {xyz: [0.2, 0, 0.03]}}\n"
        "  cup: {shape: {cylinder: {radius: 0.03, height: 0.08}}, mass: 0.1, pose: {xyz: [0.2, 0, 0.12]}}\n"
    )
    assert of(result, "cup").supports == ("shelf",) and result.passed
    assert [o.name for o in result.objects] == ["cup"]


def test_a_ball_between_steep_walls_rests_on_something(settled: Settle) -> None:
    walls = "".join(
        f"  wall_{k}: {{fixed: true, shape: {{box: [0.01, 0.3, 0.2]}}, "
        f"pose: {{xyz: [{side * 0.045}, 0, 0.12], rpy_deg: [0, {side * 14}, 0]}}}}\n"
        for k, side in enumerate((-1, 1))
    )
    ends = "".join(
        f"  end_{k}: {{fixed: true, shape: {{box: [0.2, 0.01, 0.3]}}, pose: {{xyz: [0, {side * 0.05}, 0.15]}}}}\n"
        for k, side in enumerate((-1, 1))
    )
    result = settled(walls + ends + "  ball: {shape: {sphere: 0.036}, mass: 0.1, pose: {xyz: [0, 0, 0.115]}}\n")
    assert "is not supported by anything" not in of(result, "ball").problems
    assert float(result.state.poses["ball"].p[2]) > 0.06  # it hangs between the walls


def test_nothing_to_settle(settled: Settle) -> None:
    result = settled("")
    assert result.objects == () and result.passed


def test_settling_twice_gives_the_same(settled: Settle) -> None:
    objects = (
        "  a: {shape: {box: [0.1, 0.08, 0.06]}, mass: 0.3, pose: {xyz: [0, 0, 0.028], rpy_deg: [1, 2, 33]}}\n"
        "  b: {shape: {cylinder: {radius: 0.03, height: 0.09}}, mass: 0.2, pose: {xyz: [0.06, 0.02, 0.05]}}\n"
    )
    one, two = settled(objects), settled(objects)
    for name in ("a", "b"):
        assert np.array_equal(one.state.poses[name].p, two.state.poses[name].p)
        assert np.array_equal(one.state.poses[name].q, two.state.poses[name].q)
    assert one.to_json() == two.to_json()


def test_supporters_are_those_below() -> None:
    def contact(a: str, b: str, *normal: float) -> Contact:
        return Contact(a, b, 1e-4, frozen_array(normal), frozen_array([0, 0, 0]))

    contacts = [
        contact("desk", "cup", 0, 0, 1),
        contact("cup", "lid", 0.1, 0, 0.99),
        contact("cup", "book", 0, -0.2, -0.98),
        contact("wall", "cup", 1, 0, 0.05),
    ]
    assert supporters("cup", contacts) == ("book", "desk")
    assert supporters("cup", contacts, 0.02) == ("book", "desk", "wall")
    assert supporters("lid", contacts) == ("cup",) and supporters("desk", contacts) == ()


# -- the command --------------------------------------------------------------------------------------------------

SCENE = """\
simfoundry: scene/1
name: settling
viewpoint: front
materials:
  wood: {density: 700, friction: 0.5}
objects:
  desk:
    fixed: true
    shape: {box: [0.8, 0.6, 0.04]}
    material: wood
    pose: {xyz: [0, 0, -0.02]}
  box:
    category: carton
    shape: {box: [0.1, 0.08, 0.06]}
    mass: {value: 0.3, range: [0.2, 0.4], source: scale}
    color: [0.8, 0.2, 0.1]
    pose: {xyz: [0.1, 0.05, 0.034], yaw_deg: 33}
  lidded:
    asset: lidded.asset.yaml
    fixed: true
    joints: {lid: 0.9}
    pose: {xyz: [-0.2, 0, 0.05], yaw_deg: 25}
cameras:
  front: {size: [64, 48], fx: 60, fy: 60, pose: {xyz: [-0.8, 0.1, 0.7], look_at: [0, 0, 0]}}
relations: [OnTop(box, desk)]
"""
ASSET = """\
simfoundry: asset/1
name: lidded
links:
  body: {density: 500, parts: {block: {shape: {box: [0.12, 0.1, 0.1]}}}}
  lid: {density: 500, parts: {plate: {shape: {box: [0.12, 0.1, 0.01]}, pose: {xyz: [0.06, 0, 0.005]}}}}
joints:
  lid: {type: revolute, parent: body, child: lid, pose: {xyz: [-0.06, 0, 0.052]}, axis: [0, -1, 0], limits_deg: [0, 70]}
"""


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    (tmp_path / "lidded.asset.yaml").write_text(ASSET)
    (tmp_path / "settling.scene.yaml").write_text(SCENE)
    return tmp_path / "settling.scene.yaml"


def spec_of(path: Path) -> SceneSpec:
    spec = load_scene(path).spec
    assert isinstance(spec, SceneSpec)
    return spec


def test_the_settled_file_differs_in_poses_and_joints_only(scene_file: Path) -> None:
    out = scene_file.parent / "rest.scene.yaml"
    done = run("settle", scene_file, "-o", out, "--json")
    assert done.code == 0 and done.err == "" and done.json["passed"] and done.json["out"] == str(out)
    assert load(out).all_findings() == []
    before, after = spec_of(scene_file), spec_of(out)
    assert after.objects["box"].pose.xyz == pytest.approx((0.1, 0.05, 0.03), abs=1e-3)
    assert after.objects["box"].pose.yaw_deg == pytest.approx(33, abs=0.2)
    assert after.objects["lidded"].joints["lid"] == pytest.approx(
        0.0, abs=1e-3
    )  # the lid fell shut, not past its limit
    same = {
        name: item.model_copy(update={"pose": before.objects[name].pose, "joints": before.objects[name].joints})
        for name, item in after.objects.items()
    }
    assert after.model_copy(update={"objects": same}) == before
    again = scene_file.parent / "again.scene.yaml"
    assert run("settle", out, "-o", again).code == 0
    assert spec_of(again).objects["box"].pose.xyz == pytest.approx(after.objects["box"].pose.xyz, abs=2e-4)


def test_settling_to_another_folder_is_refused(scene_file: Path) -> None:
    other = scene_file.parent / "other"
    other.mkdir()
    done = run("settle", scene_file, "-o", other / "rest.scene.yaml")
    assert done.code == 2 and "to the original folder" in done.err and not list(other.iterdir())


def test_a_failing_scene_exits_with_1_and_names_the_object(scene_file: Path) -> None:
    scene_file.write_text(SCENE.replace("xyz: [0.1, 0.05, 0.034]", "xyz: [0.45, 0.05, 0.034]"))
    done = run("settle", scene_file)
    assert done.code == 1
    row = next(line for line in done.out.splitlines() if line.startswith("box"))
    assert "fell off" in row and "did not come to rest" in done.out
    assert not run("settle", scene_file, "--json").json["passed"]


def test_worlds_are_left_in_the_settled_state(scene_file: Path) -> None:
    scene: Scene = lower_file(scene_file)
    world: World
    with open_world(scene, "mujoco") as world:
        result = settle(world)
        now = world.state()
    for name, X_WO in result.state.poses.items():
        assert np.allclose(now.poses[name].p, X_WO.p, atol=1e-12)
        assert math.isclose(now.poses[name].angle_to(X_WO), 0.0, abs_tol=1e-7)


def test_what_is_hopeless_is_not_simulated_further(scene_file: Path) -> None:
    stages: list[str] = []
    with open_world(lower_file(scene_file), "mujoco") as world:
        result = settle(world, progress=lambda stage, share: stages.append(stage), is_hopeless=lambda: True)
    assert {*stages} == {"depenetrate"} and result.at_rest


STACK = """\
simfoundry: scene/1
name: stack
objects:
  desk: {{fixed: true, shape: {{box: [8, 8, 0.04]}}, pose: {{xyz: [0, 0, -0.02], rpy_deg: [0, {tilt}, 0]}}}}
  plate: {{asset: {assets}/plate.asset.yaml, place: {{on: desk, xy: [0, 0]}}}}
  plate_2: {{asset: {assets}/plate.asset.yaml, place: {{on: plate, xy: [0, 0]}}}}
  bowl: {{asset: {assets}/bowl.asset.yaml, place: {{on: plate_2, xy: [0, 0]}}}}
  ball: {{shape: {{sphere: 0.033}}, mass: 0.058, {where}}}
"""


@pytest.mark.parametrize(
    ("where", "tilt", "rests"),
    [
        ("place: {inside: bowl, xy: [0.03, 0.02]}", 0, True),
        ("pose: {xyz: [1, 0, 0.033]}", 0, True),
        ("pose: {xyz: [1, 0, 0.0161]}", 1, False),
    ],
    ids=["in a bowl on two plates", "on a desk", "on a slope"],
)
def test_a_ball_rests_where_a_hollow_holds_it(where: str, tilt: float, rests: bool) -> None:
    folder = REPOSITORY / "specs"
    text = STACK.format(assets="assets", where=where, tilt=tilt)
    scene = lower(load(folder / "stack.scene.yaml", text=text))
    with MujocoWorld(scene) as world:
        settled = settle(world)
    assert ("ball" in settled.lost) is not rests, settled.lost
    with MujocoWorld(bare(scene)) as world:
        assert ("ball" in settle_layout(world, settled.state).restless) is not rests
