"""Every command: exit codes, JSON that is nothing but JSON, help, and starting fast."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path

import pytest

from simfoundry.cli import output
from simfoundry.cli.main import COMMANDS
from simfoundry.runtime.extras import EXTRAS
from simfoundry.spec.models.robot_file import robot_names
from tests.cli.command import MAIN, Done, absent, python, run, several, without

SCENE = """\
simfoundry: scene/1
name: small
objects:
  desk: {fixed: true, shape: {box: [0.8, 0.6, 0.04]}, pose: {xyz: [0, 0, -0.02]}}
  cup: {shape: {cylinder: {radius: 0.04, height: 0.1}}, mass: 0.3, pose: {xyz: [0.1, 0.05, 0.05], yaw_deg: 20}}
cameras:
  front: {size: [64, 48], fx: 60, fy: 60, pose: {xyz: [-0.8, 0.1, 0.7], look_at: [0, 0, 0]}}
relations: [OnTop(cup, desk)]
"""
TRIANGLES = "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
CORNERS = "v 0 0 0\nv {0} 0 0\nv 0 {0} 0\nv 0 0 {0}\n"


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SIMFOUNDRY_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    (tmp_path / "small.scene.yaml").write_text(SCENE)
    return tmp_path / "small.scene.yaml"


@pytest.fixture
def bad(tmp_path: Path) -> Path:
    (tmp_path / "bad.scene.yaml").write_text(SCENE.replace("mass:", "mas:"))
    return tmp_path / "bad.scene.yaml"


# -- exit codes and JSON --------------------------------------------------------------------------------------------


def test_a_good_scene_gives_0_and_json_everywhere(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    calls: tuple[list[str | Path], ...] = (
        ["check", scene],
        ["show", scene],
        ["settle", scene],
        ["compile", scene, "-o", out / "build"],
        ["render", scene, "--engine", "raycast", "-o", out / "a.png"],
        ["synthesize", scene, "-o", out / "capture"],
    )
    for args in calls:
        done = run(*args, "--json")
        assert (done.code, done.err) == (0, ""), (args, done)
        assert isinstance(done.json, dict)
        plain = run(*args)
        assert plain.code == 0 and plain.out and plain.err == "", args
    assert (out / "a.png").read_bytes().startswith(b"\x89PNG") and (out / "capture" / "depth.png").is_file()
    assert sorted(p.name for p in (out / "build").iterdir()) == ["loss.json", "mjcf", "pybullet", "urdf", "usd"]


@pytest.mark.parametrize("command", ["show", "settle", "compile", "render", "synthesize"])
def test_a_bad_scene_gives_2_and_its_findings(bad: Path, tmp_path: Path, command: str) -> None:
    more: list[str | Path] = ["-o", tmp_path / "out"] if command in ("compile", "synthesize") else []
    done = run(command, bad, *more)
    assert done.code == 2 and done.out == ""
    done.one_line("bad.scene.yaml:5:", "error[SF101]", "`mas`")
    as_json = run(command, bad, *more, "--json")
    assert as_json.code == 2 and as_json.err == ""
    assert "SF101" in {f["code"] for f in as_json.json["findings"]}
    assert not (tmp_path / "out").exists()


def test_check_gives_1_for_findings(bad: Path, scene: Path) -> None:
    assert run("check", bad).code == 1
    done = run("check", bad, scene, "--json")
    assert done.code == 1 and done.err == ""
    assert done.json["files"] == [str(bad), str(scene)] and "SF101" in {f["code"] for f in done.json["findings"]}
    assert run("check", scene.parent / "nothing.yaml").code == 2


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["show", "nowhere.scene.yaml"], "does not exist"),
        (["capture", "nowhere"], "does not exist"),
        (["check", "nowhere.yaml"], "nowhere.yaml does not exist"),
        (["compile", "nowhere.scene.yaml", "-t", "mjfc"], ""),
        (["settle"], "Missing argument"),
        (["render", "nowhere.scene.yaml", "--cmera", "front"], ""),
        (["shwo"], "did you mean `show`?"),
        (["demo", "nowhere"], "does not exist"),
    ],
)
def test_a_wrong_call_gives_2_and_says_why(args: list[str], words: str) -> None:
    done = run(*args)
    assert done.code == 2 and done.out == "" and words in done.err
    as_json = run(*args, "--json")
    assert as_json.code == 2 and as_json.err == "" and words in as_json.json["error"]


def test_a_misspelled_camera_or_target_is_named(scene: Path, tmp_path: Path) -> None:
    assert "did you mean `front`?" in run("render", scene, "-c", "fornt").err
    assert "did you mean `front`?" in run("synthesize", scene, "-c", "fornt", "-o", tmp_path / "c").err
    assert "did you mean `mjcf`" in run("compile", scene, "-t", "mjfc").err


def test_strict_compiling_gives_1_where_something_is_lost(scene: Path, tmp_path: Path) -> None:
    scene.write_text(SCENE.replace("mass: 0.3", "mass: 0.3, restitution: 0.4"))
    done = run("compile", scene, "-t", "mjcf", "-o", tmp_path / "out", "--strict", "--json")
    assert done.code == 1 and done.json["losses"]["mjcf"]["losses"]
    assert run("compile", scene, "-t", "mjcf", "-o", tmp_path / "out").code == 0


def test_compile_says_what_is_not_there(scene: Path, tmp_path: Path) -> None:
    done = run("compile", scene, "-t", "urdf", "-o", tmp_path / "out")
    lines = [line.strip() for line in done.out.splitlines()]
    assert "front is not written: URDF has no cameras; add them in the simulator." in lines
    reason = "URDF has no contact friction; the simulator's default applies."
    assert [line for line in lines if "friction are" in line] == [
        f"desk.friction, cup.friction are not written: {reason}"
    ]


def test_settle_says_how_to_keep_where_things_came_to_rest(scene: Path) -> None:
    scene.write_text(SCENE.replace("0.05, 0.05], yaw", "0.05, 0.2], yaw"))
    done = run("settle", scene)
    kept = scene.with_name("small_settled.scene.yaml")
    assert done.code == 1
    assert done.out.splitlines()[-1] == (f"to keep the settled poses: simfoundry settle {scene} -o {kept}")
    assert "keep" not in run("settle", scene, "-o", kept).out
    assert "keep" not in run("settle", kept).out


def test_what_is_not_finite_is_null_in_json(
    scene: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    output.print_json({"drift": math.inf, "all": [math.nan, 1.5]})
    assert json.loads(capsys.readouterr().out) == {"drift": None, "all": [None, 1.5]}
    monkeypatch.chdir(scene.parent)  # MuJoCo logs its warnings in the working folder
    scene.write_text(SCENE + "gravity: [0, 0, -1000000]\n")
    done = run("settle", scene, "--json")
    assert "Infinity" not in done.out and "NaN" not in done.out and done.json["objects"][0]["drift"] > 1000
    for number in ("1e400", "-1e300"):
        done = run("judge", scene, f"At(cup, {number}, 0)", "--json")
        assert done.code == 2 and f"`{number}` is out of range" in done.json["error"]


def test_an_engine_that_does_not_draw_here_is_a_sentence(scene: Path, tmp_path: Path) -> None:
    env = {"SIMFOUNDRY_CACHE": str(tmp_path / "cache"), "PYOPENGL_PLATFORM": "osmesa"}
    done = python(MAIN, "render", scene, "--engine", "egl", "-o", tmp_path / "a.png", **env)
    assert done.code == 2 and "Traceback" not in done.err and "'raycast'" in done.err


def test_schemas(tmp_path: Path) -> None:
    for kind in ("scene", "task", "asset", "capture", "cousins", "policy"):
        done = run("schema", kind)
        assert done.code == 0 and done.json["$defs"]["Document"]["properties"]["simfoundry"]
    assert run("schema").code == 2 and "scene, task, asset, capture, cousins, policy" in run("schema").err
    assert run("schema", "-o", tmp_path).code == 0 and (tmp_path / "scene.schema.json").is_file()


def test_folders_of_others_are_not_compiled_over(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run("compile", scene, "-t", "urdf", "-t", "mjcf", "-o", out).code == 0
    (out / "urdf" / "notes.txt").write_text("mine")
    before = (out / "mjcf" / "scene.xml").stat().st_ino
    done = run("compile", scene, "-t", "mjcf", "-t", "urdf", "-o", out)
    assert done.code == 2 and "notes.txt" in done.err and (out / "urdf" / "notes.txt").read_text() == "mine"
    assert (out / "mjcf" / "scene.xml").stat().st_ino == before  # none of it was written
    assert run("compile", scene, "-t", "urdf", "-o", out, "--force").code == 0
    assert not (out / "urdf" / "notes.txt").exists()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_may_not_be_written(scene: Path, tmp_path: Path) -> None:
    (tmp_path / "locked").mkdir(mode=0o555)
    done = run("compile", scene, "-t", "mjcf", "-o", tmp_path / "locked")
    assert done.code == 2 and "Permission denied" in done.err


def test_a_place_that_cannot_be_written_is_a_sentence(scene: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    done = run("compile", scene, "-t", "mjcf", "-o", tmp_path / "file" / "below")
    assert done.code == 2 and "Not a directory" in done.err and str(tmp_path / "file") in done.err
    assert "error" in run("compile", scene, "-t", "mjcf", "-o", tmp_path / "file" / "below", "--json").json


# -- meshes ---------------------------------------------------------------------------------------------------------

MESHES = {
    "empty": ("", "SF301"),
    "open": (CORNERS.format(0.1) + "f 1 3 2\nf 1 2 4\nf 1 4 3\n", "SF302"),
    "millimeters": (CORNERS.format(100) + TRIANGLES, "SF303"),
    "tiny": (CORNERS.format(1e-5) + TRIANGLES, "SF303"),
    "NaN": (CORNERS.format(0.1).replace("v 0 0 0", "v nan 0 0") + TRIANGLES, "SF301"),
    "points": (CORNERS.format(0.1), "SF301"),
    "no such corner": (CORNERS.format(0.1) + "f 1 2 9\n", "SF301"),
}


@pytest.mark.parametrize(("text", "code"), MESHES.values(), ids=MESHES)
def test_a_bad_mesh_is_found_at_the_line_that_names_it(tmp_path: Path, text: str, code: str) -> None:
    (tmp_path / "mug.obj").write_text(text)
    (tmp_path / "a.scene.yaml").write_text(
        "simfoundry: scene/1\nname: a\nobjects:\n  mug:\n    asset: mug.obj\n    mass: 0.3\n"
    )
    for command in ("compile", "settle", "show"):
        more: list[str | Path] = ["-o", tmp_path / "out"] if command == "compile" else []
        done = run(command, tmp_path / "a.scene.yaml", *more)
        assert done.code == 2, done
        done.one_line("a.scene.yaml:5:12", f"error[{code}]")
    assert not (tmp_path / "out").exists()


# -- help and speed -------------------------------------------------------------------------------------------------

HEAVY = ("numpy", "pxr", "mujoco", "pybullet", "trimesh", "scipy", "cv2", "shapely", "coacd", "PIL")
LOADED = f"""
import sys
from simfoundry.cli.main import main
for args in sys.argv[1:]:
    sys.argv = ['simfoundry', *args.split()]
    try:
        main()
    except SystemExit as end:
        print(args, sorted(set({HEAVY!r}) & set(sys.modules)), end.code, file=sys.stderr)
"""


@pytest.mark.parametrize("command", COMMANDS)
def test_help_helps(command: str) -> None:
    done = run(command, "--help")
    assert done.code == 0 and done.out.startswith(f"Usage: simfoundry {command}")
    assert len(done.out.splitlines()) > 6


def test_the_list_of_commands() -> None:
    done = run("--help")
    assert done.code == 0 and all(f"  {command}  " in done.out for command in COMMANDS)
    assert "Exit codes" in done.out and run("--version").out.startswith("simfoundry, version ")


def test_help_and_check_load_nothing_heavy(scene: Path) -> None:
    calls = ["--help", *(f"{command} --help" for command in COMMANDS), "schema scene", "check small.scene.yaml"]
    done = python(f"import os; os.chdir({str(scene.parent)!r})\n{LOADED}", *calls)
    needed = {calls[-1]: ["numpy"]}  # its lints measure shapes
    assert done.err.splitlines() == [f"{call} {needed.get(call, [])} 0" for call in calls]


def test_no_progress_bar_in_a_log(scene: Path, tmp_path: Path) -> None:
    """Not even where color is forced, as CI services do."""
    done = python(MAIN, "settle", scene, SIMFOUNDRY_CACHE=str(tmp_path), FORCE_COLOR="1", TERM="xterm")
    assert done.code == 0 and done.err == ""


# -- packages that are not there ------------------------------------------------------------------------------------


def parts(done: Done) -> dict[str, dict[str, object]]:
    return {p["name"]: p for p in json.loads(done.out)["parts"]}


def test_doctor_finds_everything_here() -> None:
    done = run("doctor", "--json")
    assert done.code == 0 and done.err == ""
    assert [p["name"] for p in done.json["parts"] if p["required"] and not p["version"]] == []


@pytest.mark.slow  # 2 s
def test_doctor_names_what_is_missing() -> None:
    done, plain = several(absent("shapely", "pybullet"), ["doctor", "--json"], ["doctor"])
    assert done.code == 1 and done.err == ""
    facts = parts(done)
    assert facts["shapely"]["version"] == "" and facts["shapely"]["remedy"] == "pip install shapely"
    assert facts["pybullet"]["version"] == "" and facts["trimesh"]["version"]
    assert str(facts["pybullet"]["remedy"]).startswith("pip install 'simfoundry[pybullet]'")
    assert "MISSING shapely" in plain.out


def test_doctor_lists_extras_robots_renderers_and_models_with_what_brings_each() -> None:
    """None of what is absent here is required."""
    away = {"SIMFOUNDRY_IMAGES_URL": "http://127.0.0.1:1", "SIMFOUNDRY_ROBOTS": "/nowhere"}
    done, without_folder = several(
        absent("mink", "mujoco_menagerie", "pybullet", "robot_descriptions"),
        ["doctor", "--json"],
        ["doctor"],
        env=[away, {"SIMFOUNDRY_ROBOTS": ""}],
    )
    assert done.code == 0 and done.err == ""
    facts, sections = parts(done), list(dict.fromkeys(p["section"] for p in json.loads(done.out)["parts"]))
    assert sections == ["packages", "extras", "robots", "renderers", "models"]
    assert {name for name, part in facts.items() if part["section"] == "extras"} == set(EXTRAS)
    assert {name for name, part in facts.items() if part["section"] == "robots"} == set(robot_names())
    assert facts["expert"]["version"] == ""
    assert facts["expert"]["remedy"] == "pip install 'simfoundry[expert]' (missing: mink)"
    assert "SIMFOUNDRY_ROBOTS is set to /nowhere, but this folder does not exist" in str(facts["yam"]["remedy"])
    assert facts["raycast"]["version"] and facts["images"]["version"] and not facts["meshes"]["version"]
    assert all(part["version"] or part["remedy"] for part in facts.values())
    assert "-> install the robot models with `pip install 'simfoundry[robots]'`" in without_folder.out
    assert "ok      demo_arm               mjcf" in without_folder.out


def test_a_missing_package_is_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "a.scene.yaml").write_text(SCENE.replace("cylinder: {radius: 0.04, height: 0.1}", PRISM))
    done = python(without("mapbox_earcut", "shapely"), "show", tmp_path / "a.scene.yaml")
    assert done.code == 2 and "Traceback" not in done.err and "simfoundry doctor" in done.err
    assert "is not installed; install with `pip install " in done.err


PRISM = "prism: {outline: [[0, 0], [0.1, 0], [0.05, 0.02], [0, 0.1]], height: 0.05}"


def test_settle_and_compile_work_without_pybullet(scene: Path, tmp_path: Path) -> None:
    compiled, settled, refused = several(
        absent("pybullet"),
        ["compile", scene, "-o", tmp_path / "out"],
        ["settle", scene],
        ["settle", scene, "--engine", "pybullet"],
    )
    assert compiled.code == 0 and (tmp_path / "out" / "pybullet" / "world.json").is_file()
    assert settled.code == 0
    assert refused.code == 2 and "pip install" in refused.err and "Traceback" not in refused.err
