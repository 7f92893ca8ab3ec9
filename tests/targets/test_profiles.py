"""Profiles: the project's own are whole, a wrong one is told where and what, and a new target is one new file."""

from __future__ import annotations

import ast
import importlib.util
import json
import os
import subprocess
import sys
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import pytest

from simfoundry.backends import BACKENDS, compile_scene
from simfoundry.scene.lower import lower_file
from simfoundry.spec.diagnostics import SpecError
from simfoundry.targets.compile import RULES, compile_target
from simfoundry.targets.event_terms import EVENTS_FILE
from simfoundry.targets.find import UnknownTargetError, find_target, read_profile, target_names
from tests.cli.command import run
from tests.conftest import of_the_checkout
from tests.mechanisms import pendulum
from tests.scenes import box, full_scene, pose, primitives_scene, scene_of, solid
from tests.targets.everything import write_everything

ROOT = Path(__file__).resolve().parents[2]
SIMULATORS = {"mujoco", "mjx", "pybullet", "isaacsim", "isaaclab", "newton", "sapien", "maniskill", "genesis", "drake"}
SIMULATORS |= {"mujoco_usd", "newton_usd", "omnigibson", "usdview"}
MODULES = {"drake": "pydrake", "usdview": "pxr", "mjx": "mujoco.mjx", "newton_usd": "newton",
           "mujoco_usd": "mujoco._usd"}  # fmt: skip
"""What to import to know that a simulator is here, where it is called otherwise."""

NEWTONS = ("newton", "newton_usd")

MINE = """\
simfoundry: target/1
name: my_sim
description: A simulator of my own.
backend: mjcf
options: {timestep: 0.001}
tested: {how: checked}
loader: my_load.py
combines: {friction: minimum}
restores: {restitution: the loader sets it}
gaps:
  mass: {fidelity: dropped, kind: never, reason: everything weighs nothing}
"""


ENGINE = "engine: {modules: {json: json}, install: nothing, note: no solver}\ngaps:\n"


def profile(tmp_path: Path, text: str = MINE) -> Path:
    (tmp_path / "my_load.py").write_text("print('mine')\n")
    (tmp_path / "my_sim.yaml").write_text(text)
    return tmp_path / "my_sim.yaml"


def test_every_simulator_has_a_profile_and_every_backend_is_a_target() -> None:
    assert set(target_names()) >= SIMULATORS | set(BACKENDS.names())
    assert target_names()[: len(BACKENDS.names())] == BACKENDS.names()
    assert len(set(target_names())) == len(target_names())


@pytest.mark.parametrize("name", sorted(SIMULATORS))
def test_a_profile_says_how_it_was_tested(name: str) -> None:
    spec = find_target(name).profile
    assert spec.name == name
    assert bool(spec.tested.versions) == (spec.tested.how == "run")
    assert spec.tested.how == "run" or spec.tested.note


@pytest.mark.parametrize("name", sorted(SIMULATORS))
def test_a_loader_is_code_that_runs_by_itself(name: str) -> None:
    files = compile_target(full_scene(), find_target(name)).files
    tree = ast.parse(files["load.py"])
    functions = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert "main" in functions and functions & {"load", "scene_cfg"}
    imported = {a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names}
    imported |= {str(n.module) for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
    assert not any(module.startswith("simfoundry") for module in imported)
    read = {node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    named = {word for word in read if word.endswith((".json", ".usda", ".xml")) and "/" not in word and " " not in word}
    named.discard(EVENTS_FILE)  # only builds of recipes have it
    assert named and named <= set(files), "a loader reads files that the build does not have"


def _present(name: str) -> bool:
    try:
        return importlib.util.find_spec(MODULES.get(name, name)) is not None
    except ModuleNotFoundError:
        return False


@pytest.mark.parametrize("name", sorted(SIMULATORS))
def test_where_the_simulator_is_its_loader_loads(name: str, tmp_path: Path) -> None:
    if not _present(name):
        pytest.skip(f"{name} is not installed")
    compile_target(primitives_scene(), find_target(name)).write(tmp_path / name)
    bare = {key: value for key, value in os.environ.items() if key not in ("DISPLAY", "WAYLAND_DISPLAY")}
    command = [sys.executable, str(tmp_path / name / "load.py")]
    done = subprocess.run(command, cwd=tmp_path, env=bare, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(("loaded ", "scene.usda"))


LAB = """\
import sys
from types import ModuleType, SimpleNamespace

def cfg(**fields): return SimpleNamespace(**fields)
cfg.InitialStateCfg = lambda **fields: SimpleNamespace(**{{"rot": {identity}, **fields}})
modules = {{
    "isaaclab": {{}},
    "isaaclab.sim": {{"UsdFileCfg": cfg}},
    "isaaclab.assets": {{"AssetBaseCfg": cfg, "RigidObjectCfg": cfg, "ArticulationCfg": cfg}},
    "isaaclab.scene": {{"InteractiveSceneCfg": cfg}},
}}
for name, content in modules.items():
    sys.modules[name] = ModuleType(name)
    vars(sys.modules[name]).update(content)
sys.modules["isaaclab"].sim = sys.modules["isaaclab.sim"]
import load
print([round(v, 6) for v in load.scene_cfg().brick.init_state.rot])
"""
"""Stands in for Isaac Lab's configuration classes, which need Isaac Sim; only their default rotation differs."""


@pytest.mark.parametrize(("identity", "order"), [((1.0, 0.0, 0.0, 0.0), "wxyz"), ((0.0, 0.0, 0.0, 1.0), "xyzw")])
def test_isaac_lab_gets_quaternions_in_its_own_order(identity: tuple[float, ...], order: str, tmp_path: Path) -> None:
    turned = pose(0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    scene = scene_of(solid("brick", box(0.1, 0.1, 0.1), turned))
    compile_target(scene, find_target("isaaclab")).write(tmp_path)
    command = [sys.executable, "-c", LAB.format(identity=identity)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True, timeout=60)
    expected = [round(float(turned.q["wxyz".index(letter)]), 6) for letter in order]
    assert json.loads(done.stdout) == expected


def test_a_new_target_is_a_new_file(tmp_path: Path) -> None:
    target = read_profile(profile(tmp_path))
    scene = full_scene()
    artifact, plain = compile_target(scene, target), compile_scene(scene, "mjcf")
    assert artifact.target == "my_sim"
    assert artifact.files["load.py"] == b"print('mine')\n"
    assert b'timestep="0.001"' in artifact.files["scene.xml"]
    assert b'timestep="0.002"' in plain.files["scene.xml"]
    losses = {loss.path: loss.reason for loss in artifact.losses}
    assert losses["mass"] == "everything weighs nothing (never)"
    assert losses["friction"] == "my_sim uses the smaller of a pair: 0.1 for 0.1 and 0.8; the scene specifies 0.283."
    assert not any("restitution" in path for path in losses)
    assert any("restitution" in loss.path for loss in plain.losses)


def test_newton_has_the_frictions_of_pairs_from_mjcf_and_the_larger_from_usd() -> None:
    rough = solid("rough", box(1, 1, 1), pose(0, 0, 0), friction=0.5)
    smooth = solid("smooth", box(1, 1, 1), pose(2, 0, 0), friction=0.35)
    scene = scene_of(rough, smooth)
    exact, larger = ({loss.path: loss.reason for loss in compile_target(scene, find_target(t)).losses} for t in NEWTONS)
    assert "friction" not in exact
    assert (
        larger["friction"] == "newton_usd uses the larger of a pair: 0.5 for 0.35 and 0.5; the scene specifies 0.418."
    )


def test_what_newton_reads_of_ball_joints_is_not_reported_lost() -> None:
    scene = scene_of(pendulum(pose(0, 0, 0, 0.3, 0.2, 0.1), damping=0.02, friction=0.01))
    plain = {loss.path for loss in compile_scene(scene, "usd").losses}
    damped = {path for path in plain if path.endswith((".damping", ".friction"))}
    assert damped, "the scene has no ball joint with damping"
    for target in NEWTONS:
        assert not damped & {loss.path for loss in compile_target(scene, find_target(target)).losses}


def test_compile_takes_names_and_paths(tmp_path: Path) -> None:
    scene, mine = write_everything(tmp_path), profile(tmp_path)
    done = run("compile", scene, "-o", tmp_path / "build", "-t", "sapien", "-t", mine, "-t", "usd", "-t", "usd")
    assert done.code == 0, done.err
    built = sorted(p.name for p in (tmp_path / "build").iterdir())
    assert built == ["loss.json", "my_sim", "sapien", "usd"]
    report = json.loads((tmp_path / "build" / "loss.json").read_text())
    assert list(report) == ["sapien", "my_sim", "usd"]
    assert report["my_sim"]["features"]["mass"] == {"dropped": 7}
    assert report["usd"]["features"]["mass"] == {"kept": 7}
    strict = run("compile", scene, "-o", tmp_path / "build", "-t", "sapien", "--strict")
    assert strict.code == 1


def test_an_unknown_target_names_the_nearest(tmp_path: Path) -> None:
    with pytest.raises(UnknownTargetError, match="no target is called `isaaclib`; did you mean `isaaclab`"):
        find_target("isaaclib")
    done = run("compile", write_everything(tmp_path), "-t", "isaaclib", "-o", tmp_path / "build")
    assert done.code == 2 and "did you mean `isaaclab`" in done.err
    assert not (tmp_path / "build").exists()


@pytest.mark.parametrize(
    ("old", "new", "code", "line", "words"),
    [
        ("backend: mjcf", "backend: mjfc", "SF201", 4, "no backend is called `mjfc`"),
        ("{timestep: 0.001}", "{time_step: 0.001}", "SF201", 5, "option of the backend `mjcf`"),
        ("{timestep: 0.001}", "{timestep: fast}", "SF103", 5, "expected a number"),
        ("how: checked", "how: guessed", "SF106", 6, "not valid here"),
        ("my_load.py", "your_load.py", "SF203", 7, "file `your_load.py` does not exist"),
        ("my_load.py", "../../../etc/passwd", "SF203", 7, "does not exist"),
        ("restores: {restitution", "restores: {bounciness", "SF201", 9, "no feature is called `bounciness`"),
        ("  mass:", "  maas:", "SF201", 11, "no feature is called `maas`"),
        ("kind: never", "kind: maybe", "SF106", 11, "not valid here"),
        ("name: my_sim", "name: your_sim", "SF106", 2, "its file is `my_sim.yaml`"),
        (
            "gaps:\n",
            "behaviors: {slip_angel: {low: 0, high: 1, reason: steep}}\ngaps:\n",
            "SF201",
            10,
            "no behavior is",
        ),
        (
            "gaps:\n",
            "tolerances: {read_back: {value: 1, reason: none}}\ngaps:\n",
            "SF107",
            10,
            "tolerances have no effect without an `engine`",
        ),
        ("gaps:\n", ENGINE, "SF203", 10, "file `readback.py` does not exist"),
        ("backend: mjcf", "backend: mjcf\nback_end: usd", "SF101", 5, "unknown key `back_end`"),
        ("description: A simulator of my own.", "", "SF102", 1, "`description` is missing"),
    ],
)
def test_a_wrong_profile_is_told_where_and_what(
    tmp_path: Path, old: str, new: str, code: str, line: int, words: str
) -> None:
    path = profile(tmp_path, MINE.replace(old, new))
    with pytest.raises(SpecError) as caught:
        read_profile(path)
    (finding,) = caught.value.diagnostics
    assert (finding.code, finding.line, finding.file) == (code, line, str(path))
    assert words in finding.message


def test_a_tolerance_of_an_unknown_quantity_is_told(tmp_path: Path) -> None:
    folder = tmp_path / "my_sim"
    folder.mkdir()
    (folder / "readback.py").touch()
    tolerances = "tolerances: {inertia: {value: 1, reason: none}, inertai: {value: 1, reason: none}}\n"
    text = MINE.replace("loader: my_load.py\n", "").replace("gaps:\n", f"{tolerances}{ENGINE}")
    (folder / "profile.yaml").write_text(text)
    with pytest.raises(SpecError) as caught:
        find_target(str(folder))
    (finding,) = caught.value.diagnostics
    assert (
        (finding.code, finding.line) == ("SF201", 9) and "`inertai`" in finding.message and "`inertia`" in finding.hint
    )


def test_a_path_object_is_a_target_of_ones_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "my_sim"
    folder.mkdir()
    (folder / "my_load.py").touch()
    (folder / "profile.yaml").write_text(MINE)
    monkeypatch.chdir(tmp_path)
    assert find_target(Path("my_sim")) == find_target("./my_sim")
    assert find_target(Path("my_sim/profile.yaml")) == find_target("./my_sim/profile.yaml")


def test_all_that_is_wrong_is_told_at_once(tmp_path: Path) -> None:
    wrong = MINE.replace("backend: mjcf", "backend: mjfc").replace("  mass:", "  maas:")
    with pytest.raises(SpecError) as caught:
        read_profile(profile(tmp_path, wrong))
    assert [d.line for d in caught.value.diagnostics] == [4, 11]


def test_a_value_of_the_wrong_type_hides_no_other_fault(tmp_path: Path) -> None:
    """What depends on the wrong value is not told: it may be right once the value is."""
    wrong = MINE.replace("{friction: minimum}", "{friction: smallest}").replace("{timestep: 0.001}", "{steps: 1}")
    wrong = wrong.replace("backend: mjcf", "backend: urdf").replace("  mass:", "  maas:")
    with pytest.raises(SpecError) as caught:
        read_profile(profile(tmp_path, wrong))
    assert [(d.code, d.line) for d in caught.value.diagnostics] == [("SF201", 5), ("SF106", 8), ("SF201", 11)]
    tolerances = "engine: json\ntolerances: {mass: {value: 1, reason: none}}\ngaps:\n"
    for old, new, line in [
        ("name: my_sim", "name: My Sim", 2),
        ("gaps:\n", tolerances, 10),
        (
            "{friction: minimum}\nrestores: {restitution: the",
            "{restitution: minimum}\nrestores: {restitution: 5, mass: the",
            9,
        ),
    ]:
        assert old in MINE
        with pytest.raises(SpecError) as caught:
            read_profile(profile(tmp_path, MINE.replace(old, new).replace("timestep: 0.001", "")))
        assert [d.line for d in caught.value.diagnostics] == [line]


def test_a_rule_for_a_coefficient_that_no_file_states_is_an_error(tmp_path: Path) -> None:
    """It would replace the loss of the coefficient by a loss of a few percent."""
    text = MINE.replace("backend: mjcf\noptions: {timestep: 0.001}", "backend: urdf")
    with pytest.raises(SpecError) as caught:
        read_profile(profile(tmp_path, text))
    (finding,) = caught.value.diagnostics
    assert (finding.code, finding.line, finding.path) == ("SF107", 7, "combines.friction")
    assert finding.message == "the backend `urdf` drops `friction`; list it under `restores`, or remove the rule"
    path = profile(tmp_path, text.replace("restores: {", "restores: {friction: the loader sets it, "))
    losses = {loss.path: loss.reason for loss in compile_target(full_scene(), read_profile(path)).losses}
    assert losses["friction"].startswith("my_sim uses the smaller of a pair")


def test_rules_for_a_pair_agree_where_both_are_equal() -> None:
    for words, rule in RULES.values():
        equal = rule(0.4, 0.4)
        assert equal == pytest.approx(0.16 if words == "the product" else 0.4)


def test_no_loss_where_all_surfaces_are_equal() -> None:
    alike = scene_of(solid("a", box(1, 1, 1), pose(0, 0, 0)), solid("b", box(1, 1, 1), pose(2, 0, 0)))
    assert [loss for loss in compile_target(alike, find_target("drake")).losses if loss.path == "friction"] == []
    other = solid("b", box(1, 1, 1), pose(2, 0, 0), friction=0.8)
    mixed = scene_of(solid("a", box(1, 1, 1), pose(0, 0, 0), friction=0.3), other)
    (loss,) = (loss for loss in compile_target(mixed, find_target("drake")).losses if loss.path == "friction")
    assert loss.reason == "drake uses the harmonic mean of a pair: 0.436 for 0.3 and 0.8; the scene specifies 0.49."


@of_the_checkout
def test_the_wheel_has_the_profiles(tmp_path: Path) -> None:
    hatchling = pytest.importorskip("hatchling.builders.wheel", reason="hatchling builds the wheel")
    builder = hatchling.WheelBuilder(str(ROOT))
    (wheel,) = builder.build(directory=str(tmp_path), versions=["standard"])
    names = set(zipfile.ZipFile(wheel).namelist())
    files = [p for p in (ROOT / "targets").rglob("*") if p.suffix in (".yaml", ".py")]
    assert len(files) > 30
    assert {f"simfoundry/shipped/{p.relative_to(ROOT).as_posix()}" for p in files} <= names


def test_physics_and_poses_speak_of_the_same_files(tmp_path: Path) -> None:
    files = compile_target(lower_file(write_everything(tmp_path)), find_target("sapien")).files
    poses, physics = (json.loads(files[name]) for name in ("poses.json", "physics.json"))
    assert list(physics["objects"]) == list(poses) and "cabinet.lid" in poses  # the lid is loose: a URDF of its own
    for name, item in physics["objects"].items():
        robot = ET.fromstring(files[poses[name]["urdf"]])
        links = [link.get("name") for link in robot.findall("link")]
        assert list(item["links"]) == links
        assert all(set(pair) <= set(links) for pair in item["silent"])
        assert set(poses[name]["joints"]) <= set(item["joints"])
