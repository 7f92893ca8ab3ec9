"""Packages from outside that are broken: each fault names its package and its line, and all else works on."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import pytest

from simfoundry.backends import BACKENDS
from simfoundry.runtime.plugins import PluginError
from simfoundry.spec.diagnostics import SpecError
from simfoundry.targets.find import find_target, find_targets
from simfoundry.verify.engines import UnknownEngineError, all_engines, find_engine
from simfoundry.worlds import world_names
from tests.cli.command import run
from tests.foreign_package import documented_package, write_package

_, PAGES = documented_package()
LINT, BODIES, BOXES = (PAGES[f"my_package/{name}.py"] for name in ("lints", "bodies", "boxes"))
HIGHER, POLICY, PROFILE = (PAGES[f"my_package/{name}"] for name in ("higher.py", "policy.py", "my_sim/profile.yaml"))

SCENE = """\
simfoundry: scene/1
name: bench
materials: {wood: {density: 600, friction: 0.4}}
objects:
  table: {fixed: true, shape: {box: [1.2, 1.2, 0.04]}, material: wood, pose: {xyz: [0.4, 0, -0.02]}}
  block: {shape: {box: [0.05, 0.04, 0.03]}, material: wood, friction: 0.9, place: {on: table, xy: [0.32, 0.1]}}
robots: {arm: {model: demo_arm}}
cameras: {front: {size: [64, 48], fx: 50, fy: 50, pose: {xyz: [1.3, 0, 0.7], look_at: [0.3, 0, 0]}}}
"""
TASK = """\
simfoundry: task/1
name: lift
scene: bench.scene.yaml
instruction: Lift the block.
goal: Grasped(block)
horizon: 15
"""
HAND = '<mujoco><worldbody><body name="a"><geom size="0.1" mass="1"/></body></worldbody></mujoco>'
READER = """
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.registry import Importer


def read(path, options):
    raise ImportRefusedError(path, "it was called", 1)


IMPORTER = Importer({".xml": read}, accepts=lambda path: "sdfx" in path.read_text())
"""

Install = Callable[[Mapping[str, Mapping[str, str]], Mapping[str, str]], None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Installs the package ``faulty`` with entry points by group and files, until the test ends."""
    before = set(sys.modules)

    def write(entries: Mapping[str, Mapping[str, str]], files: Mapping[str, str]) -> None:
        write_package(tmp_path / "site", "faulty", entries, files)
        monkeypatch.syspath_prepend(tmp_path / "site")

    monkeypatch.setenv("SIMFOUNDRY_PROGRESS", "never")
    yield write
    for name in set(sys.modules) - before:
        if name.split(".")[0] in ("faulty", "my_package"):
            del sys.modules[name]


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "bench.scene.yaml"
    path.write_text(SCENE)
    (tmp_path / "lift.task.yaml").write_text(TASK)
    return path


def spoilt(text: str, before: str) -> str:
    """The code of a page, which divides by zero before one of its lines."""
    assert text.count(before) == 1
    indent = " " * (len(before) - len(before.lstrip()))
    return text.replace(before, f"{indent}1 / 0\n{before}")


def test_a_lint_that_cannot_be_imported_is_one_warning_and_the_others_run(install: Install, scene: Path) -> None:
    install({"simfoundry.lints": {"no_camera": "faulty:LINT"}}, {"faulty.py": "import nothing_here\n"})
    report = run("check", scene, scene.with_name("lift.task.yaml"), "--json").json
    found = report["findings"]
    assert (report["documents"], report["warnings"]) == (2, 1)
    assert [(d["code"], d["severity"], d["file"]) for d in found] == [("no_camera", "warning", "faulty:LINT")]
    assert (
        "cannot be loaded: ModuleNotFoundError: No module named 'nothing_here' (site/faulty.py:1)"
        in (found[0]["message"])
    )
    scene.write_text(SCENE.replace("place: {on: table, xy: [0.32, 0.1]}", "pose: {xyz: [0.32, 0.1, 0.3]}"))
    assert "SF411" in run("check", scene).err
    assert run("check", scene, "--format", "sarif").code == 1


def test_a_lint_that_raises_is_a_finding_of_its_document(install: Install, scene: Path) -> None:
    lint = spoilt(LINT, "    if not subject.scene.spec.cameras:\n")
    install({"simfoundry.lints": {"no_camera": "faulty:LINT"}}, {"faulty.py": lint})
    (scene.parent / "wrong.scene.yaml").write_text(SCENE.replace("name: bench", "nam: bench"))
    done = run("check", scene.parent)
    line = done.one_line("[LAB001]")
    where = lint.splitlines().index("    1 / 0") + 1
    assert "the `no_camera` lint from the package faulty 0.1 failed: ZeroDivisionError: division by zero" in line
    assert f"(site/faulty.py:{where})" in line and "bench.scene.yaml" in line
    assert "unknown key `nam`" in done.err
    scene.write_text(SCENE + "allow: {LAB001: its lint is broken}\n")
    assert run("check", scene).code == 0


@pytest.mark.parametrize("part", ["    z = terms", '`{a.name}` is {length(v)} above the origin"'])
def test_a_predicate_that_raises_is_a_finding_and_an_error_of_judge(install: Install, scene: Path, part: str) -> None:
    rule = HIGHER.replace(part, "    1 / 0\n    z = terms" if part.startswith(" ") else '{1 / 0}"')
    assert rule != HIGHER
    install({"simfoundry.predicates": {"Higher": "faulty:PREDICATE"}}, {"faulty.py": rule})
    text = "the `Higher` predicate from the package faulty 0.1 failed: ZeroDivisionError: division by zero (site/faulty"
    scene.write_text(SCENE + 'relations: ["Higher(block, 0.5)"]\n')
    checked = run("check", scene.parent)
    assert checked.code == 1 and text in checked.one_line("[SF406]") and "of 2 documents" in checked.out
    judged = run("judge", scene)
    assert judged.code == 2 and text in judged.one_line("Error:")


def test_a_policy_protocol_that_raises_ends_its_rollout_alone(install: Install, scene: Path) -> None:
    asking = spoilt(POLICY, "        row = [")
    install({"simfoundry.policies": {"asking": "faulty.ask:PROTOCOL", "beginning": "faulty.begin:PROTOCOL"}}, {
        "faulty/__init__.py": "",
        "faulty/ask.py": asking,
        "faulty/begin.py": spoilt(POLICY, '        """Connect to the server'),
    })  # fmt: skip
    task, out = scene.with_name("lift.task.yaml"), scene.with_name("out")
    policies = [f"{name}:localhost?action_space=joint_position" for name in ("asking", "beginning")]
    done = run("eval", task, "-p", policies[0], "-p", policies[1], "-n", "1", "--no-video", "-o", out, "--json")
    scores = {score["policy"]: score for score in done.json["scores"]}
    asked, begun = (next(s for name, s in scores.items() if part in name) for part in ("asking", "beginning"))
    assert (asked["invalid"], asked["missing"]) == (1, 0)
    assert begun["missing"] == 1
    where = asking.splitlines().index("        1 / 0") + 1
    text = "the `asking` policy protocol from the package faulty 0.1 failed: ZeroDivisionError: division by zero"
    assert f"{text} (faulty/ask.py:{where})" in done.out


def test_an_importer_that_cannot_be_imported_does_not_stop_the_others(install: Install, tmp_path: Path) -> None:
    install({"simfoundry.importers": {"boxes": "faulty:IMPORTER"}}, {"faulty.py": "import nothing_here\n"})
    (tmp_path / "hand.xml").write_text(HAND)
    (tmp_path / "shelf.boxes").write_text("board 0 0 0 1 1 1\n")
    assert run("import", tmp_path / "hand.xml", "-o", tmp_path / "hand.scene.yaml").code == 0
    refused = run("import", tmp_path / "shelf.boxes", "-o", tmp_path / "shelf.scene.yaml")
    assert refused.code == 2 and "unsupported file type; supported file types: .urdf" in refused.err
    assert "the `boxes` importer from the package faulty 0.1 cannot be loaded: ModuleNotFoundError" in refused.err


def test_an_importer_that_raises_is_named_with_its_line(install: Install, tmp_path: Path) -> None:
    text = spoilt(BOXES, "        body = BodyDraft")
    install({"simfoundry.importers": {"boxes": "faulty:IMPORTER"}}, {"faulty.py": text})
    (tmp_path / "shelf.boxes").write_text("board 0 0 0.01 0.5 0.3 0.02\n")
    refused = run("import", tmp_path / "shelf.boxes", "-o", tmp_path / "shelf.scene.yaml")
    where = text.splitlines().index("        1 / 0") + 1
    assert refused.code == 2 and "a bug in simfoundry" not in refused.err
    assert "shelf.boxes: the `boxes` importer from the package faulty 0.1 failed: ZeroDivisionError" in refused.err
    assert f"(site/faulty.py:{where})" in refused.err
    (tmp_path / "shelf.boxes").write_text("board 0 0 0.01 -0.5 0.3 0.02\n")  # the line before
    refused = run("import", tmp_path / "shelf.boxes", "-o", tmp_path / "shelf.scene.yaml")
    assert "shelf.boxes: its `box.0` is -0.5, which is invalid in a document" in refused.err


@pytest.mark.parametrize("own", ['accepts=lambda path: "sdfx" in path.read_text()', 'xml_root="sdfx"'])
def test_an_importer_of_xml_needs_a_root_or_a_function(install: Install, tmp_path: Path, own: str) -> None:
    text = READER.replace('accepts=lambda path: "sdfx" in path.read_text()', own)
    install({"simfoundry.importers": {"sdfx": "faulty:IMPORTER"}}, {"faulty.py": text})
    for root in ("sdfx", "other"):
        (tmp_path / f"{root}.xml").write_text(f"<{root}/>")
    (tmp_path / "hand.xml").write_text(HAND.replace("mujoco>", "mujoco><!-- sdfx -->", 1))
    out = tmp_path / "one.scene.yaml"
    assert "sdfx.xml:1: it was called" in run("import", tmp_path / "sdfx.xml", "-o", out).err
    assert run("import", tmp_path / "hand.xml", "-o", out).code == 0
    refused = run("import", tmp_path / "other.xml", "-o", out, "--force").err
    roots = "`<robot>`, `<mujoco>`" + (", `<sdfx>`" if "xml_root" in own else "")
    assert refused.rstrip().endswith(f"unsupported root element `<other>`; supported root elements: {roots}")


@pytest.mark.parametrize(
    ("old", "new", "cause"),
    [
        ('json_text({"gravity"', 'str({"gravity"', "TypeError: the content of bodies.json must be bytes (site/faulty"),
        ("    check_names(scene)\n", "    1 / 0\n", "ZeroDivisionError: division by zero (site/faulty.py:"),
        (
            'if name != "collision_shape"',
            'if name not in ("collision_shape", "visuals")',
            "cannot be loaded: ValueError: `features` has no entry for visuals (site/faulty.py:",
        ),
    ],
)  # fmt: skip
def test_a_backend_that_fails_leaves_the_other_targets(
    install: Install, scene: Path, old: str, new: str, cause: str
) -> None:
    assert old in BODIES
    install({"simfoundry.backends": {"bodies": "faulty:BACKEND"}}, {"faulty.py": BODIES.replace(old, new)})
    done = run("compile", scene, "-t", "bodies", "-t", "mjcf", "-o", scene.with_name("build"))
    assert done.code == 1 and scene.with_name("build").joinpath("mjcf/scene.xml").is_file()
    assert "the `bodies` backend from the package faulty 0.1" in done.one_line(cause)


@pytest.mark.parametrize("profile", [None, PROFILE.replace("steps: false", "steps: maybe")])
def test_a_target_with_a_wrong_profile_leaves_the_others(install: Install, scene: Path, profile: str | None) -> None:
    files = {"faulty/__init__.py": "", "faulty/bodies.py": BODIES, "faulty/my_sim/__init__.py": ""}
    backend = {"simfoundry.backends": {"bodies": "faulty.bodies:BACKEND"}}
    if profile is not None:
        files["faulty/my_sim/profile.yaml"] = profile
    install({"simfoundry.targets": {"my_sim": "faulty.my_sim"}, **backend}, files)
    build = scene.with_name("build")
    for name in ("one", "two"):
        (scene.parent / f"{name}.scene.yaml").write_text(SCENE.replace("name: bench", f"name: {name}"))
    done = run("compile", scene, "-t", "my_sim", "-t", "mjcf", "-o", build)
    assert done.code == 1 and (build / "mjcf/scene.xml").is_file()
    assert "faulty/my_sim/profile.yaml" in done.one_line("my_sim is not written")
    many = run(
        "compile", scene, scene.with_name("one.scene.yaml"), "-j", "1", "-t", "my_sim", "-t", "mjcf", "-o", build
    )
    assert many.code == 1 and (build / "one/mjcf/scene.xml").is_file()
    assert run("compile", scene, "-t", "my_sim", "-o", scene.with_name("alone")).code == 2
    assert {e.name for e in all_engines()} >= {"mujoco"} and "mujoco" in world_names()
    for find in (find_target, find_engine):
        with pytest.raises(SpecError, match=r"profile\.yaml"):
            find("my_sim")
    with pytest.raises(UnknownEngineError):
        find_engine("my_sym")


@pytest.mark.usefixtures("scene")
def test_only_a_target_that_nobody_else_can_replace_raises(install: Install) -> None:
    install({"simfoundry.targets": {"gone": "faulty.gone"}}, {})
    found, reasons = find_targets(["gone", "mjcf"])
    assert [target.name for target in found] == ["mjcf"] and "the package faulty 0.1" in reasons["gone"]
    with pytest.raises(PluginError, match="the `gone` target"):
        find_targets(["gone"])


def test_faults_of_what_is_built_in_are_not_hidden() -> None:
    """They are bugs of this project, whose traceback a report needs."""
    with pytest.raises(ZeroDivisionError), BACKENDS.running("mjcf"):
        _ = 1 / 0
