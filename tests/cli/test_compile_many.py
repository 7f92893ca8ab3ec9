"""Many scenes: compiled side by side, passed over where nothing changed, and none stopped by another."""

from __future__ import annotations

import ctypes
import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simfoundry.assets import convex
from simfoundry.assets.solids import prism_mesh
from simfoundry.runtime.workers import Limits, report_progress
from simfoundry.targets.batch import COMPILED, CURRENT, FAILED, CompileJob, CompileOutcome, compile_all, compile_job
from tests.assets.meshes import block, obj
from tests.cli.command import run
from tests.conftest import REPOSITORY

SCENE = """\
simfoundry: scene/1
name: small
materials: {wood: {density: 500, friction: 0.6}}
objects:
  desk: {fixed: true, shape: {box: [1.0, 1.0, 0.1]}, material: wood, pose: {xyz: [0, 0, -0.05]}}
"""
MESH = "  {name}: {{asset: {name}.obj, material: wood, pose: {{xyz: [{x}, 0, 0]}}}}\n"


def ell(height: float) -> str:
    """An L, which no hull can stand for."""
    outline = np.array([[0, 0], [3, 0], [3, 1], [1, 1], [1, 3], [0, 3]]) * 0.05
    return obj(*prism_mesh(outline, height))


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache in which the meshes of these tests are decomposed once."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cache: Path) -> Path:
    """A project with the scenes `a`, `b` and `more/c`."""
    monkeypatch.setenv("SIMFOUNDRY_CACHE", str(cache))
    root = tmp_path / "project"
    (root / "more").mkdir(parents=True)
    (root / "simfoundry.yaml").write_text("")
    (root / "a.scene.yaml").write_text(SCENE + MESH.format(name="one", x=0.3) + MESH.format(name="two", x=-0.3))
    (root / "one.obj").write_text(ell(0.05))
    (root / "two.obj").write_text(ell(0.08))
    (root / "b.scene.yaml").write_text(SCENE)
    (root / "more" / "c.scene.yaml").write_text(SCENE.replace("small", "c"))
    monkeypatch.chdir(root)
    return root


def states(*args: str | Path, code: int = 0) -> dict[str, str]:
    """What became of each scene, compiled one at a time if nothing else is asked for: a process takes long to start."""
    done = run(
        "compile", *args, *([] if "-j" in args else ["-j", "1"]), "-o", "build", "-t", "mjcf", "-t", "urdf", "--json"
    )
    assert (done.code, done.err) == (code, ""), done
    return {scene["scene"]: scene["state"] for scene in done.json["scenes"]}


def content(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.mark.slow  # 5 s: it compiles twice in processes
def test_scenes_keep_the_shape_of_their_folder_and_are_compiled_once(project: Path) -> None:
    names = ["a.scene.yaml", "b.scene.yaml", "more/c.scene.yaml"]
    assert states(".", "-j", "2") == dict.fromkeys(names, COMPILED)
    before = content(project / "build")
    assert {"a/mjcf/scene.xml", "b/build.json", "more/c/loss.json"} <= before.keys()
    assert states(".") == dict.fromkeys(names, CURRENT)
    assert states(".", "--force") == dict.fromkeys(names, COMPILED)
    assert content(project / "build") == before
    done = run("compile", ".", "-j", "1", "-o", "build", "-t", "mjcf", "-t", "urdf")
    assert done.code == 0 and done.out.splitlines()[-1] == "3 up to date" and done.err == ""


def test_builds_of_many_are_those_of_one(project: Path) -> None:
    states(".")
    assert run("compile", "a.scene.yaml", "-o", "alone", "-t", "mjcf", "-t", "urdf").code == 0
    together = content(project / "build" / "a")
    together.pop("build.json")
    assert content(project / "alone") == together


CHANGES: dict[str, Callable[[Path], object]] = {
    "scene": lambda p: (p / "a.scene.yaml").write_text((p / "a.scene.yaml").read_text().replace("0.3", "0.31")),
    "mesh": lambda p: (p / "one.obj").write_text(ell(0.06)),
    "output gone": lambda p: (p / "build/a/mjcf/load.py").unlink(),
    "report": lambda p: (p / "build/a/loss.json").write_text("{}"),
    "record": lambda p: (p / "build/a/build.json").write_text("{"),
}


def test_what_changed_is_redone_and_nothing_else(project: Path) -> None:
    jobs = [CompileJob(Path(f"{name}.scene.yaml"), ("mjcf",), Path("build") / name) for name in "ab"]
    assert [compile_job(job).state for job in jobs] == [COMPILED, COMPILED]
    for name, change in CHANGES.items():
        change(project)
        assert [compile_job(job).state for job in jobs] == [COMPILED, CURRENT], name
        assert [compile_job(job).state for job in jobs] == [CURRENT, CURRENT], name


def test_an_edited_output_is_kept_until_somebody_says_otherwise(project: Path) -> None:
    job = CompileJob(Path("a.scene.yaml"), ("mjcf",), Path("build/a"))
    assert compile_job(job).state == COMPILED
    (project / "build/a/mjcf/scene.xml").write_text("<mujoco/>")
    refused = compile_job(job)
    assert refused.state == FAILED and "edited since they were generated (scene.xml)" in refused.error
    assert (project / "build/a/mjcf/scene.xml").read_text() == "<mujoco/>"
    assert compile_job(replace(job, force=True)).state == COMPILED


def test_comments_and_other_targets(project: Path) -> None:
    job = CompileJob(Path("b.scene.yaml"), ("mjcf",), Path("build/b"))
    assert [compile_job(job).state, compile_job(job).state] == [COMPILED, CURRENT]
    (project / "b.scene.yaml").write_text(f"# with a comment\n{SCENE}")
    assert compile_job(job).state == CURRENT
    assert compile_job(CompileJob(job.scene, ("mjcf", "usd"), job.out)).state == COMPILED
    assert compile_job(CompileJob(job.scene, ("usd", "mjcf"), job.out)).state == CURRENT


def test_textures_and_profiles_count(project: Path) -> None:
    corners, faces = block((0.1, 0.2, 0.3))
    (project / "one.obj").write_text(f"mtllib one.mtl\nusemtl m\n{obj(corners, faces)}")
    (project / "one.mtl").write_text("newmtl m\nKd 1 0 0\n")
    profile = (REPOSITORY / "targets" / "mjx" / "profile.yaml").read_text()
    (project / "mine.yaml").write_text(profile.replace("name: mjx", "name: mine"))
    job = CompileJob(Path("a.scene.yaml"), ("mine.yaml",), Path("build/a"))
    assert [compile_job(job).state, compile_job(job).state] == [COMPILED, CURRENT]
    (project / "one.mtl").write_text("newmtl m\nKd 0 1 0\n")
    assert [compile_job(job).state, compile_job(job).state] == [COMPILED, CURRENT]
    (project / "mine.yaml").write_text(profile.replace("name: mjx", "name: mine") + "\n# the same\n")
    assert compile_job(job).state == CURRENT
    changed = profile.replace("name: mjx", "name: mine").replace("description: ", "description: my own ")
    (project / "mine.yaml").write_text(changed)
    assert compile_job(job).state == COMPILED


def test_only_the_changed_object_is_decomposed(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SIMFOUNDRY_CACHE", str(project / "empty_cache"))
    decomposed: list[str] = []
    real = convex.decompose

    def counted(name: str, vertices: np.ndarray, faces: np.ndarray, _report: object) -> list[np.ndarray]:
        decomposed.append(name)
        return real(name, vertices, faces)

    monkeypatch.setattr(convex, "decompose", counted)
    job = CompileJob(Path("a.scene.yaml"), ("mjcf",), Path("build/a"))
    assert compile_job(job).state == COMPILED and decomposed == ["one.obj", "two.obj"]
    (project / "two.obj").write_text(ell(0.07))
    assert compile_job(job).state == COMPILED and decomposed[2:] == ["two.obj"]
    (project / "a.scene.yaml").write_text((project / "a.scene.yaml").read_text().replace("0.3", "0.35"))
    assert compile_job(job).state == COMPILED and decomposed[3:] == []


# -- what goes wrong ------------------------------------------------------------------------------------------------


def crash(*_: object) -> None:
    ctypes.string_at(0)


def crash_on_a(job: CompileJob) -> CompileOutcome:
    """What a segfault of a library does while the scene `a` is compiled."""
    if job.scene.name.startswith("a."):
        report_progress("object `one` (one.obj)")
        ctypes.string_at(0)
    return compile_job(job)


def hang_on_a(job: CompileJob) -> CompileOutcome:
    if job.scene.name.startswith("a."):
        report_progress("object `one` (one.obj)")
        time.sleep(600)
    return compile_job(job)


@pytest.mark.parametrize(
    ("function", "seconds", "why"),
    [
        ("crash_on_a", 600.0, "crashed (SIGSEGV)"),
        pytest.param("hang_on_a", 12.0, "did not respond for 12 s", marks=pytest.mark.slow),  # it waits for 12 s
    ],
)
@pytest.mark.usefixtures("project")
def test_a_crash_or_a_hang_fails_one_scene(function: str, seconds: float, why: str) -> None:
    """Only a hang reaches the limit: on a busy machine, a process takes some seconds to import and compile."""
    scenes = [Path(name) for name in ("a.scene.yaml", "b.scene.yaml", "more/c.scene.yaml")]
    jobs = [CompileJob(path, ("mjcf",), Path("build") / path.stem) for path in scenes]
    limits = Limits(seconds, 8 * 2**30)
    outcomes = compile_all(jobs, 2, limits=limits, function=f"tests.cli.test_compile_many:{function}")
    assert [o.state for o in outcomes] == [FAILED, COMPILED, COMPILED]
    assert outcomes[0].error == f"its process {why}, while processing object `one` (one.obj)"


@pytest.mark.slow  # 3 s
def test_a_failed_scene_stops_no_other(project: Path) -> None:
    (project / "one.obj").write_text("o nothing\n")
    (project / "b.scene.yaml").write_text(SCENE.replace("fixed", "fxed"))
    assert states(".", code=1) == {"a.scene.yaml": FAILED, "b.scene.yaml": FAILED, "more/c.scene.yaml": COMPILED}
    done = run("compile", ".", "-j", "1", "-o", "build", "-t", "mjcf", "-t", "urdf")
    assert done.code == 1 and done.out.splitlines()[-1] == "1 up to date, 2 failed"
    done.one_line("a.scene.yaml:6:", "SF301", "one.obj")
    done.one_line("b.scene.yaml:5:", "SF101", "`fxed`")
    assert not (project / "build" / "a").exists()


def test_a_crash_of_the_decomposition_is_a_finding_of_the_object(
    project: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SIMFOUNDRY_CACHE", str(project / "empty_cache"))
    monkeypatch.setattr(convex, "FUNCTION", "tests.cli.test_compile_many:crash")
    done = run("compile", "a.scene.yaml", "-o", "build", "-t", "mjcf")
    assert done.code == 2
    done.one_line("a.scene.yaml:6:", "error[SF301]", "one.obj could not be decomposed: CoACD crashed (SIGSEGV)")
    done.one_line("a.scene.yaml:7:", "two.obj could not be decomposed")
    assert not (project / "build").exists()


def test_two_scenes_for_one_folder_are_refused(project: Path) -> None:
    (project / "more" / "a.scene.yaml").write_text(SCENE)
    done = run("compile", "a.scene.yaml", "more/a.scene.yaml", "-o", "build")
    assert done.code == 2 and "would both be written to build/a" in done.err and not (project / "build").exists()
    (project / "empty").mkdir()
    assert "could not find any *.scene.yaml file below empty" in run("compile", "empty").err


@pytest.mark.slow  # 2 s
def test_files_of_others_are_kept_in_each_folder(project: Path) -> None:
    states("a.scene.yaml", "b.scene.yaml")
    (project / "build/b/mjcf/thesis.tex").write_text("mine")
    assert states("a.scene.yaml", "b.scene.yaml", code=1) == {"a.scene.yaml": CURRENT, "b.scene.yaml": FAILED}
    assert (project / "build/b/mjcf/thesis.tex").read_text() == "mine"


def test_builds_and_hidden_folders_are_passed_over(project: Path) -> None:
    for folder in ("build/kept", ".git/x"):
        (project / folder).mkdir(parents=True)
        (project / folder / "d.scene.yaml").write_text(SCENE)
    assert states(".").keys() == {"a.scene.yaml", "b.scene.yaml", "more/c.scene.yaml"}


def test_the_record_names_no_place_of_this_machine(project: Path) -> None:
    states(".")
    text = (project / "build/a/build.json").read_text()
    assert str(project) not in text and str(Path.home()) not in text
    assert json.loads(text)["inputs"]["files"].keys() == {"one.obj", "two.obj"}


def test_a_chain_without_end_is_refused(project: Path) -> None:
    def text(count: int) -> str:
        links = "".join(f"  l{k}: {{mass: 1, parts: {{a: {{shape: {{sphere: 0.01}}}}}}}}\n" for k in range(count))
        joints = "".join(f"  j{k}: {{type: fixed, parent: l{k}, child: l{k + 1}}}\n" for k in range(count - 1))
        return f"simfoundry: asset/1\nname: chain\nlinks:\n{links}joints:\n{joints}"

    (project / "b.scene.yaml").write_text(SCENE + "  chain: {asset: chain.asset.yaml}\n")
    (project / "chain.asset.yaml").write_text(text(200))
    assert run("compile", "b.scene.yaml", "-o", "build", "-t", "mjcf").code == 0
    (project / "chain.asset.yaml").write_text(text(201))
    done = run("compile", "b.scene.yaml", "-o", "build", "-t", "mjcf")
    assert done.code == 2
    done.one_line("error[SF206]", "`l200` is at the end of a chain of more than 200 links")


def test_what_is_too_light_for_a_simulator_is_refused(project: Path) -> None:
    (project / "b.scene.yaml").write_text(SCENE + "  dust: {shape: {sphere: 0.001}, mass: 1.0e-12}\n")
    done = run("compile", "b.scene.yaml", "-o", "build", "-t", "mjcf")
    assert done.code == 2
    done.one_line("error[SF104]", "`base` of 1e-12 kg", "too small for a simulator")
