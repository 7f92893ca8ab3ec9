"""What something else would refuse for the document's sake, `check` reports at its line; sound documents pass."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from simfoundry.spec.diagnostics import Severity
from tests.corpora.mutations import findings
from tests.corpora.refusals import ROOTS, refusal, refusals

CELL, SORT, CABINET, OVER, ARM = (
    "cell.scene.yaml",
    "sort.task.yaml",
    "cabinet.asset.yaml",
    "over.scene.yaml",
    "arm.yaml",
)
ROCK = "pose: {rock: {xyz: [0.35, 0.1, 0.0151]}}"

GAPS = {
    "camera on a joint": (CELL, "mount: cabinet.drawer", "mount: cabinet.lid", CELL, "SF201"),
    "camera on no link of a robot file": (CELL, "mount: cabinet.drawer", "mount: other.nolink", CELL, "SF201"),
    "place on a joint": (CELL, "on: cabinet.top", "on: cabinet.lid", CELL, "SF201"),
    "closed without limits": (CELL, "Open(cabinet.drawer)", "Open(cabinet.knob)", CELL, "SF201"),
    "closed, but fixed": (CELL, "Open(cabinet.drawer)", "Open(cabinet.lid)", CELL, "SF201"),
    "closed ball joint": (CELL, "Open(cabinet.drawer)", "Closed(cabinet.hook)", CELL, "SF201"),
    "no such link of a known robot": (SORT, "Grasped(pill, arm)", "Touching(pill, arm.nolink)", SORT, "SF201"),
    "no cavity": (SORT, 'Inside(rock, tray)", ', 'Inside(rock, plate)", ', SORT, "SF202"),
    "step starts off its support": (SORT, "xy: [0.35, 0.2]", "xy: [3.35, 0.2]", SORT, "SF210"),
    "task starts off its support": (SORT, ROCK, "place: {rock: {on: table, xy: [5, 0]}}", SORT, "SF210"),
    "task moves a container": (SORT, ROCK, "pose: {tray: {xyz: [0, 0, 0], rpy_deg: [90, 0, 0]}}", SORT, "SF210"),
    "task moves a reference": (SORT, ROCK, "pose: {tray: {xyz: [0.4, 5, 0]}}", SORT, "SF210"),
    "background": (CELL, "background: {mesh: rock.obj", "background: {mesh: bad.obj", CELL, "SF301"),
    "splat": (CELL, "background: {mesh: rock.obj", "background: {splat: bad.ply", CELL, "SF301"),
    "URDF": (CELL, "model: {file: arm.yaml}", "model: {urdf: bad.urdf}", CELL, "SF214"),
    "MJCF": (CELL, "model: {file: arm.yaml}", "model: {mjcf: bad.xml}", CELL, "SF214"),
    "URDF that is not text": (CELL, "model: {file: arm.yaml}", "model: {urdf: bytes.urdf}", CELL, "SF214"),
    "MJCF that includes itself": (CELL, "model: {file: arm.yaml}", "model: {mjcf: cycle.xml}", CELL, "SF214"),
    "USD": (CELL, "model: {file: arm.yaml}", "model: {usd: bad.usda}", CELL, "SF214"),
    "joint of a robot file": (
        CELL,
        "model: {file: arm.yaml}",
        "model: {file: arm.yaml}, joints: {j: 1}",
        CELL,
        "SF201",
    ),
    "joint that cannot be commanded": (ARM, "joint6, joint7]", "joint6, joint9]", CELL, "SF214"),
    "hand on no link": (ARM, "hand: {link: hand,", "hand: {link: handy,", CELL, "SF214"),
    "model is missing": (ARM, "pkg:simfoundry/robots/demo_arm.xml", "nothing.xml", CELL, "SF214"),
    "axis": (CABINET, "axis: [1, 0, 0], limits", "axis: [1.0e+200, 0, 0], limits", CELL, "SF104"),
    "gravity": (CELL, "gravity: [0, 0, -9.81]", "gravity: [0, 0, -1.0e+300]", CELL, "SF104"),
    "light": (CELL, "intensity: 0.4", "intensity: 1.0e+300", CELL, "SF104"),
    "direction of a light": (CELL, "direction: [0.6, 0.3, -1]", "direction: [1.0e+200, 0.3, -1]", CELL, "SF104"),
    "thickness": (CABINET, "box: [0.18, 0.26, 0.01]", "box: [0.18, 0.26, 1.0e-300]", CELL, "SF104"),
}
"""File, what stands there, what shall stand there, the document that is checked, and the code."""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    shutil.copytree(ROOTS[0], tmp_path / "p")
    (tmp_path / "p" / "simfoundry.yaml").touch()
    (tmp_path / "p" / "bad.obj").write_text("v 0 0 0\n")
    (tmp_path / "p" / "bad.ply").write_text("ply\nformat ascii 1.0\nend_header\n")
    (tmp_path / "p" / "bad.xml").write_text("<mujoco><worldbody><bod")
    (tmp_path / "p" / "bad.urdf").write_text("<robot name='x'><link")
    (tmp_path / "p" / "bytes.urdf").write_bytes(b"<robot name='x'>\xff</robot>")
    (tmp_path / "p" / "cycle.xml").write_text("<mujoco><include file='cycle.xml'/></mujoco>")
    (tmp_path / "p" / "bad.usda").write_text("nothing")
    return tmp_path / "p"


@pytest.mark.parametrize("name", GAPS)
def test_what_would_be_refused_is_reported_at_its_line(name: str, project: Path) -> None:
    file, old, new, checked, code = GAPS[name]
    text = (project / file).read_text()
    assert text.count(old) == 1
    (project / file).write_text(text.replace(old, new))
    _, found = findings(project / checked)
    errors = [d for d in found if d.severity is Severity.ERROR]
    assert {d.code for d in errors} == {code}, errors
    if file != ARM:  # the scene names the robot file
        assert text.partition(old)[0].count("\n") + 1 in {d.line for d in errors}, errors
        assert {Path(d.file).name for d in errors} == {file}


@pytest.mark.parametrize("name", [CELL, OVER, SORT])
def test_sound_documents_pass_and_work(name: str, project: Path) -> None:
    assert findings(project / name)[1] == []
    assert refusal(project / name) == ""


def test_an_overlay_is_told_what_it_breaks_in_its_base(project: Path) -> None:
    """The place stands in the base, which is sound by itself."""
    path = project / OVER
    path.write_text(path.read_text().replace("objects:\n", "objects:\n  table: {pose: {xyz: [9, 9, -0.02]}}\n", 1))
    found = [d for d in findings(path)[1] if d.code == "SF210"]
    assert {Path(d.file).name for d in found} == {CELL, OVER}
    assert any("`tray`" in d.message and Path(d.file).name == CELL for d in found)


def test_the_selected_variant_is_what_names_refer_to(project: Path) -> None:
    (project / "plain.asset.yaml").write_text(
        "simfoundry: asset/1\nname: plain\nlinks: {frame: {mass: 1, parts: {b: {shape: {box: [0.2, 0.3, 0.2]}}}}}\n"
    )
    path = project / CELL
    variants = "  cabinet:\n    variant: plain\n    variants: {plain: {asset: plain.asset.yaml}}\n"
    path.write_text(path.read_text().replace("  cabinet:\n", variants, 1))
    messages = {d.message for d in findings(path)[1] if d.severity is Severity.ERROR}
    assert "no link or part of `cabinet` is called `top`" in messages
    assert "no link of `cabinet` is called `drawer`" not in messages  # a camera on it is left out, which is a loss


@pytest.mark.slow  # 7 s: it compiles many documents
def test_odd_documents_pass_the_check_only_if_everything_takes_them() -> None:
    outcomes = refusals(60, seed=3, roots=ROOTS[:1])
    assert outcomes.crashed == []
    assert outcomes.gaps == {}
    assert outcomes.taken > 10 and outcomes.found > 10
