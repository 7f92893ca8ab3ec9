"""A robot of one's own, by a robot file: it acts in rollouts, and what its file must say is said in one sentence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.task import load_task, need_robots
from simfoundry.geometry.frames import Pose
from simfoundry.scene.lower import lower_file
from simfoundry.spec.load import load
from simfoundry.spec.models.robot_file import OWN_ROBOTS, find_robot
from simfoundry.worlds import open_world
from simfoundry.worlds.mujoco_world import MujocoWorld
from tests.cli.command import run
from tests.conftest import REPOSITORY
from tests.evaluate.benches import ARM, SCENE, write_bench

FINGER = """
          <body name="{0}" pos="0.22 {1} 0">
            <inertial pos="0 0 0" mass="0.01" diaginertia="1e-5 1e-5 1e-5"/>
            <joint name="{0}" type="slide" axis="0 {2} 0" range="0 0.03" damping="1"/>
            <geom type="box" size="0.01 0.004 0.01" group="3"/>
          </body>
"""
JAWS = FINGER.format("left", 0.04, -1) + FINGER.format("right", -0.04, 1)
SERVOS = '<position name="left" joint="left" kp="50"/><position name="right" joint="right" kp="50"/>'
OWN = (
    ARM.replace('name="hand"', 'name="tool"')
    .replace('<body name="tool"', f'{JAWS}<body name="tool"')
    .replace("</actuator>", f"{SERVOS}</actuator>")
)
FILE = """
mjcf:
  file: models/arm.xml
  links: {hand: {link: tool, pose: {xyz: [0, 0, 0.01], yaw_deg: -90}}}
  joints: [turn, reach]
  gripper:
    command: {left: [0, 0.03], right: [0, 0.03]}
    joints: {left: [0, 0.03], right: [0, 0.03]}
"""


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """The task's file; beside it a robot file, and the model in a folder of its own."""
    task = write_bench(tmp_path, scene=SCENE.replace("{mjcf: arm.xml}", "{file: robots/my_arm.yaml}"))
    (tmp_path / "arm.xml").unlink()
    (tmp_path / "robots/models").mkdir(parents=True)
    (tmp_path / "robots/models/arm.xml").write_text(OWN)
    (tmp_path / "robots/my_arm.yaml").write_text(FILE)
    return task


@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_its_hand_and_gripper_are_those_of_its_file(bench: Path, engine: str) -> None:
    pytest.importorskip(engine, reason=f"{engine} is not installed")
    scene = lower_file(bench.with_name("bench.scene.yaml"))
    with open_world(scene, engine) as world:
        arm = world.robot("arm")
        assert arm.joints == ("joint1", "joint2")
        arm.set_targets({"joint1": 0.5, "joint2": 0.1})
        arm.set_gripper(1.0)
        world.step(round(2 / world.timestep))
        positions = arm.positions()
        assert list(positions.values()) == pytest.approx([0.5, 0.1], abs=0.02)
        assert arm.gripper() == pytest.approx(1.0, abs=0.05)
        turn = Pose.of(q=(np.cos(positions["joint1"] / 2), 0, 0, np.sin(positions["joint1"] / 2)))
        expected = turn.apply(np.array([0.22 + positions["joint2"], 0, 0.05]))
        np.testing.assert_allclose(arm.frame("hand").p, expected, atol=1e-6)
        assert arm.frame("hand").angle_to(turn) == pytest.approx(np.pi / 2, abs=1e-6)


def test_policies_do_its_tasks(bench: Path) -> None:
    result = run("eval", bench, "-p", "random", "-n", "1", "-o", bench.parent / "out", "--no-video")
    assert result.code == 0 and "0/1" in result.out, result.err
    stored = np.load(bench.parent / "out/rollouts/push/random/mujoco/000.npz")
    assert stored["actions"].shape[1] == 3  # two joints and the gripper


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "  links: {hand: {link: tool, pose: {xyz: [0, 0, 0.01], yaw_deg: -90}}}\n", "",
            "has no identifiable hand: arm.xml has no link `hand`; available links: root, turret, boom, left, "
            "right, tool; name it in a robot file",
        ),
        ("link: tool", "link: toll", "arm.xml has no link `toll`; available links: root"),
        ("joints: [turn, reach]", "joints: [turn, slide]", "no position actuator in arm.xml drives its joint `slide`"),
    ],
)  # fmt: skip
def test_what_its_file_must_say_is_said_before_the_first_rollout(bench: Path, old: str, new: str, said: str) -> None:
    (bench.parent / "robots/my_arm.yaml").write_text(FILE.replace(old, new))
    result = run("eval", bench, "-p", "random", "-n", "1", "-o", bench.parent / "out")
    assert result.code == 2 and said in result.err and "Traceback" not in result.err, result.err


@pytest.mark.parametrize("actuator", ["", '<motor name="turn" joint="turn"/><motor name="reach" joint="reach"/>'])
def test_an_arm_that_takes_no_positions_is_refused(bench: Path, actuator: str) -> None:
    model = bench.parent / "robots/models/arm.xml"
    start, end = OWN.index("<actuator>") + len("<actuator>"), OWN.index('<position name="left"')
    model.write_text(OWN[:start] + actuator + OWN[end:])
    with pytest.raises(SimfoundryError, match=r"no position actuator in arm\.xml drives its joint `turn`; add one"):
        need_robots(load_task(bench))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("mjcf: {file: models/arm.xml, arms: 2}", "my_arm.yaml: mjcf.arms: Extra inputs are not permitted"),
        (FILE.replace("  joints: [turn, reach]\n", ""), "`joints` must list the arm joints if the model has a gripper"),
        ("{}", "my_arm.yaml does not define a model; add `mjcf`, `urdf` or `usd`"),
        ("mjcf: [", "robots/my_arm.yaml is not a valid robot file: line "),
    ],
)
def test_a_faulty_robot_file_is_found_at_its_place_in_the_scene(bench: Path, text: str, said: str) -> None:
    (bench.parent / "robots/my_arm.yaml").write_text(text)
    (finding,) = load(bench.with_name("bench.scene.yaml")).errors
    assert said in finding.message and finding.path == "robots.arm.model.file" and finding.line == 11


def test_a_robot_file_and_bare_models_exclude_each_other(bench: Path) -> None:
    scene = bench.with_name("bench.scene.yaml")
    scene.write_text(SCENE.replace("{mjcf: arm.xml}", "{file: robots/my_arm.yaml, mjcf: robots/models/arm.xml}"))
    assert any(
        "`file` already defines all models; remove either `mjcf` or `file`" in str(e) for e in load(scene).errors
    )
    scene.write_text(SCENE.replace("{mjcf: arm.xml}", "{file: robots/absent.yaml}"))
    assert any("robots/absent.yaml" in e.message for e in load(scene).errors)


def test_the_robot_file_of_the_documentation_is_one(bench: Path) -> None:
    text = (REPOSITORY / "docs/robots.md").read_text().split("# robots/my_arm.yaml\n")[1].split("```")[0]
    data = yaml.safe_load(text)
    assert {"file", "links", "joints", "gripper"} <= set(data["mjcf"])
    (bench.parent / "robots/my_arm.yaml").write_text(text.replace("arm.xml", "models/arm.xml"))
    need_robots(load_task(bench))


def test_a_folder_of_robot_files_makes_them_known_by_name(bench: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What scenes rely on is in the file too, so nothing else has to know the robot."""
    scene, robots = bench.with_name("bench.scene.yaml"), bench.parent / "robots"
    scene.write_text(scene.read_text().replace("{file: robots/my_arm.yaml}", "my_arm"))
    assert any("my_arm" in d.message for d in load(scene).errors)
    monkeypatch.setenv(OWN_ROBOTS, str(robots))
    with pytest.raises(SimfoundryError, match="must define `reach`, `opening` and `home`"):
        find_robot("my_arm")
    assert any("must define `reach`, `opening` and `home`" in d.message for d in load(scene).errors)
    known = FILE.replace("links: {", "links: {boom: {link: boom}, ")
    (robots / "my_arm.yaml").write_text(f"reach: 0.4\nopening: 0.06\npayload: 0.5\nhome: [0.1, 0]\n{known}")
    assert not load(scene).errors
    arm = find_robot("my_arm")
    assert arm is not None
    assert (arm.reach, arm.payload, dict(arm.home)) == (0.4, 0.5, {"joint1": 0.1, "joint2": 0.0})
    lowered = lower_file(scene).robot("arm")
    assert (lowered.kind, lowered.reach) == ("my_arm", 0.4)


def test_a_gripper_reaches_the_force_that_its_file_states(bench: Path) -> None:
    """A servo of 50 N/m reaches 1.5 N over its travel of 3 cm; the robot file states 20 N."""
    file = bench.parent / "robots/my_arm.yaml"
    file.write_text(FILE + "  effort: {left: 20, turn: 3}\n")
    with open_world(lower_file(bench.with_name("bench.scene.yaml")), "mujoco") as world:
        assert isinstance(world, MujocoWorld)
        ranges = {name: world.model.actuator(f"arm.{name}").forcerange.tolist() for name in ("left", "right", "turn")}
        gain = float(world.model.actuator("arm.left").gainprm[0])
    assert ranges["left"] == [-20, 20] and ranges["right"] == ranges["turn"] == [0, 0]  # an arm keeps its servos
    assert gain * 0.03 > 20
