"""A package from outside, made of the code blocks of ``docs/extend``: every command sees what it brings."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from simfoundry.api import scenes
from simfoundry.backends.features import FEATURES
from simfoundry.data.dataset.formats import dataset_format
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.entries import open_policy, parse_policy
from simfoundry.runtime.plugins import PluginError
from simfoundry.spec.models.policy import PolicySpec
from simfoundry.spec.models.robot_file import find_robot, robot_names
from simfoundry.targets.find import find_target, target_names
from simfoundry.targets.generated import support_page
from tests.cli.command import run
from tests.conftest import REPOSITORY
from tests.data.synthetic import build, description, episode
from tests.foreign_package import documented_package, write_package

SCENE = """\
simfoundry: scene/1
name: bench
materials: {wood: {density: 600, friction: 0.4}}
objects:
  table: {fixed: true, shape: {box: [1.2, 1.2, 0.04]}, material: wood, pose: {xyz: [0.4, 0, -0.02], yaw_deg: 20}}
  block: {shape: {box: [0.05, 0.04, 0.03]}, material: wood, place: {on: table, xy: [0.32, 0.1]}}
robots:
  arm: {model: my_arm}
relations: [OnTop(block, table), Higher(block, 0.01)]
cameras: {front: {size: [64, 48], fx: 50, fy: 50, pose: {xyz: [1.3, 0, 0.7], look_at: [0.3, 0, 0]}}}
"""
TASK = """\
simfoundry: task/1
name: lift
scene: bench.scene.yaml
instruction: Lift the block.
goal: Higher(block, 0.2)
reset: {objects: {block: {x: [0.31, 0.33], y: [0.08, 0.12]}}}
horizon: 15
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder in which the pages' package is installed, first on the path of this and other processes."""
    folder = tmp_path_factory.mktemp("site")
    entries, files = documented_package()
    write_package(folder, "my-package", entries, files)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        patch.setenv("PYTHONPATH", f"{folder}:{REPOSITORY}")
        yield folder
    for name in [name for name in sys.modules if name.split(".")[0] == "my_package"]:
        del sys.modules[name]


@pytest.fixture(scope="module")
def scene(site: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene that uses the package's robot and predicate, with a task beside it."""
    assert site.is_dir()
    folder = tmp_path_factory.mktemp("bench")
    (folder / "lift.task.yaml").write_text(TASK)
    (folder / "bench.scene.yaml").write_text(SCENE)
    return folder / "bench.scene.yaml"


def test_check_knows_the_predicate_the_robot_and_the_lint(scene: Path) -> None:
    """The task's goal too; and a wrong argument is a finding, not a crash."""
    done = run("check", scene, scene.with_name("lift.task.yaml"), "--json")
    assert done.code == 0, done.out + done.err
    wrong = scene.with_name("wrong.scene.yaml")
    wrong.write_text(SCENE.replace("Higher(block, 0.01)", "Higher(block)").replace("name: bench", "name: wrong"))
    assert "`Higher`" in run("check", wrong).err
    blind = SCENE.partition("cameras:")[0].replace("name: bench", "name: wrong")
    wrong.write_text(blind)
    found = run("check", wrong).err
    assert "warning[LAB001] the scene has no camera" in found
    wrong.write_text(blind.replace("name: wrong", "name: wrong\nallow: {LAB001: it is for physics only}"))
    assert "LAB001" not in run("check", wrong).err
    wrong.unlink()
    assert "my_arm" in robot_names()
    robot = find_robot("my_arm")
    assert robot is not None and robot.payload == 1.5


def test_judge_says_whether_it_holds_and_why(scene: Path) -> None:
    """With the words of its rule."""
    done = run("judge", scene, "Higher(block, 0.01)", "Higher(block, 0.2)", "--json")
    assert [entry["value"] for entry in done.json["verdicts"]] == [True, False]
    assert "above the origin" in run("judge", scene, "Higher(block, 0.2)").out


def test_compile_and_verify_know_the_target_and_the_backend(scene: Path, tmp_path: Path) -> None:
    """The build has the target's loader, the report its losses, and what is read back is what the scene says."""
    done = run("compile", scene, "-t", "my_sim", "-t", "bodies", "-o", tmp_path, "--json")
    assert done.code == 0, done.out + done.err
    assert (tmp_path / "my_sim/load.py").is_file() and not (tmp_path / "bodies/load.py").exists()
    losses = done.json["losses"]
    assert losses["my_sim"]["features"]["mass"] == {"kept": 2}
    assert "dropped" in losses["bodies"]["features"]["fixed"] and losses["my_sim"]["features"]["fixed"] == {"kept": 1}
    read = run("verify", scene, "--engine", "my_sim", "--require", "my_sim", "--no-behaviors", "--json")
    assert read.code == 0, read.out + read.err
    (reading,) = read.json["readings"]
    assert reading["compared"] >= 10 and reading["mismatches"] == []
    build = json.loads((tmp_path / "bodies/bodies.json").read_text())
    build["bodies"]["block"]["mass"] *= 1.001
    (tmp_path / "bodies/bodies.json").write_text(json.dumps(build))
    (tmp_path / "my_sim/bodies.json").write_text(json.dumps(build))
    false = run("verify", scene, "--engine", "my_sim", "--no-behaviors", "--build", tmp_path, "--json")
    assert false.code == 1
    assert [d["quantity"] for d in false.json["readings"][0]["mismatches"]] == ["mass"]


def test_eval_runs_the_robot_with_the_policy_protocol(scene: Path, tmp_path: Path) -> None:
    """By its short form; the arm stays where it is, so the block is never lifted."""
    policy = "my_protocol:localhost?action_space=joint_position"
    task = scene.with_name("lift.task.yaml")
    done = run("eval", task, "-p", f"hold={policy}", "-n", "1", "--no-video", "-o", tmp_path / "out", "--json")
    assert done.code == 0, done.out + done.err
    assert '"hold"' in done.out
    choice = parse_policy(policy)
    assert isinstance(choice, PolicySpec) and open_policy(choice).name == "my_protocol"


@pytest.mark.usefixtures("site")
def test_import_reads_the_format_of_the_package(tmp_path: Path) -> None:
    """Alone, in a folder, and from Python; and its refusal names the line."""
    (tmp_path / "shelf.boxes").write_text("board 0 0 0.01 0.5 0.3 0.02\nbook 0.1 0 0.12 0.03 0.15 0.2\n")
    done = run("import", tmp_path / "shelf.boxes", "--density", "600", "-o", tmp_path / "shelf.scene.yaml", "--json")
    assert done.code == 0, done.out + done.err
    assert done.json["format"] == "boxes" and done.json["bodies"] == 2
    assert "1 of 1 imported" in run("import", tmp_path, "-o", tmp_path / "out").out
    assert scenes.load(tmp_path / "shelf.boxes").objects["book"].pose.xyz == (0.1, 0.0, 0.12)
    (tmp_path / "shelf.boxes").write_text("board 0 0 0.01 0.5 0.3\n")
    refused = run("import", tmp_path / "shelf.boxes", "--force", "-o", tmp_path / "shelf.scene.yaml")
    assert refused.code == 2 and "shelf.boxes:1: `board` has 5 numbers, not 6" in refused.err


@pytest.mark.usefixtures("site")
def test_the_support_matrix_has_columns_for_both() -> None:
    """Each feature is decided for the target, too."""
    page = support_page()
    assert "| `bodies` | bodies |" in page and "| `my_sim` | bodies | 1.0 |" in page
    header = next(line for line in page.splitlines() if line.startswith("| | "))
    assert {"my_sim", "bodies*"} <= {cell.strip() for cell in header.split("|")}
    assert page.count(f"| {FEATURES['mass'].label} |") == 1


@pytest.mark.usefixtures("site")
def test_a_target_that_breaks_takes_no_other_along(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its error is a sentence with the name of its package; a built-in target does not notice."""
    entries = {"simfoundry.targets": {"broken": "gone.broken"}, "simfoundry.backends": {"bad": "bad:BACKEND"}}
    write_package(tmp_path, "gone", entries, {"bad.py": "1 / 0"})
    monkeypatch.syspath_prepend(tmp_path)
    assert {"broken", "bad", "my_sim", "mujoco"} <= set(target_names())
    with pytest.raises(SimfoundryError, match=r"the `broken` target from the package gone 0.1 cannot be loaded"):
        find_target("broken")
    assert find_target("mujoco").name == "mujoco"
    scene = tmp_path / "one.scene.yaml"
    scene.write_text("simfoundry: scene/1\nname: one\nobjects: {block: {shape: {box: [0.1, 0.1, 0.1]}, mass: 1}}\n")
    done = run("compile", scene, "-t", "bad", "-t", "mjcf", "-o", tmp_path / "out")
    assert done.code == 1 and (tmp_path / "out/mjcf/scene.xml").is_file()
    (line,) = [line for line in done.err.splitlines() if "bad" in line]
    assert "the `bad` backend from the package gone 0.1 cannot be loaded: ZeroDivisionError" in line


@pytest.mark.usefixtures("site")
def test_datasets_are_written_in_the_format_of_the_package(tmp_path: Path) -> None:
    """And read again; and an exception in it is an error that names the package and the line."""
    stored = dataset_format("archives").read(build("archives", tmp_path / "built"))
    for k in range(len(stored)):
        found, wanted = stored.episode(k), episode(k)
        assert found.header == wanted.header
        assert all((found.arrays[name] == values).all() for name, values in wanted.arrays.items())
        for one, other in zip(found.frames(), wanted.frames(), strict=True):
            assert all((one[name] == image).all() for name, image in other.items())
    broken = replace(description(), features=({},))  # type: ignore[arg-type]
    with pytest.raises(PluginError, match=r"`archives` dataset format from the package my-package 0\.1 failed: .*"):
        dataset_format("archives").write_episode(broken, episode(0), tmp_path)
    (tmp_path / "built/out/000001.npz").write_bytes(b"nothing")
    with pytest.raises(PluginError, match=r"my_package/archives\.py:\d+"):
        dataset_format("archives").read(tmp_path / "built/out")
