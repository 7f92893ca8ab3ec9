"""``simfoundry verify``: exit codes, JSON, the page."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from simfoundry.reports.verification import page
from simfoundry.verify.behaviors import BEHAVIORS
from simfoundry.verify.compare import Difference, ReadbackComparison
from simfoundry.verify.engines import find_engine
from simfoundry.verify.run import BehaviorResult, ProofStatus, ReadbackResult
from tests.cli.command import run

SCENE = """simfoundry: scene/1
name: small
objects:
  table: {fixed: true, shape: {box: [1, 1, 0.04]}, mass: 20}
  cup: {shape: {cylinder: {radius: 0.04, height: 0.1}}, mass: 0.3, pose: {xyz: [0, 0, 0.07]}}
"""


@pytest.fixture
def spec(tmp_path: Path) -> Path:
    path = tmp_path / "small.scene.yaml"
    path.write_text(SCENE)
    return path


def test_a_good_scene(spec: Path, tmp_path: Path) -> None:
    html = tmp_path / "report.html"
    done = run("verify", spec.parent, "--engine", "mujoco", "--engine", "usd", "--no-behaviors", "--html", html)
    assert done.code == 0, done.out + done.err
    assert "small" in done.out and "0 differ" in done.out
    text = html.read_text()
    assert "data:image/png;base64," in text and '<td class="ok"' in text and "://" not in text


def test_a_false_build(spec: Path, tmp_path: Path) -> None:
    assert run("compile", spec, "-t", "mjcf", "-o", tmp_path / "build").code == 0
    xml = tmp_path / "build" / "mjcf" / "scene.xml"
    xml.write_text(xml.read_text().replace('mass="0.3"', 'mass="0.4"'))
    done = run("verify", spec, "--build", tmp_path / "build", "--engine", "mujoco", "--no-behaviors", "--json")
    assert done.code == 1
    data = done.json
    assert data["ok"] is False
    (reading,) = data["readings"]
    (wrong,) = reading["mismatches"]
    assert (wrong["name"], wrong["quantity"], wrong["expected"], wrong["got"]) == ("cup", "mass", 0.3, 0.4)
    assert wrong["error"] == pytest.approx(1 / 3)


def test_numbers_that_are_none_are_null_in_json(spec: Path, tmp_path: Path) -> None:
    assert run("compile", spec, "-t", "usd", "-o", tmp_path / "build").code == 0
    stage = tmp_path / "build" / "usd" / "scene.usda"
    stage.write_text(stage.read_text().replace("float physics:mass = 0.3", "float physics:mass = nan"))
    done = run("verify", spec, "--build", tmp_path / "build", "--no-behaviors", "--json")
    assert done.code == 1
    assert "NaN" not in done.out
    readings = {r["engine"]: r for r in done.json["readings"]}
    assert "usd" in readings and "mujoco" not in readings  # of which there is no build
    assert [(d["name"], d["got"]) for d in readings["usd"]["mismatches"]] == [("cup", None)]


def test_a_build_that_does_not_load(spec: Path, tmp_path: Path) -> None:
    assert run("compile", spec, "-t", "mjcf", "-o", tmp_path / "build").code == 0
    (tmp_path / "build" / "mjcf" / "scene.xml").write_text("<mujoco><nonsense/></mujoco>")
    done = run("verify", spec, "--build", tmp_path / "build", "--engine", "mujoco", "--no-behaviors")
    assert done.code == 1
    assert "small in mujoco: ValueError: XML Error" in done.out


def test_a_missing_engine_is_a_line_unless_it_is_required(spec: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SIMFOUNDRY_ENGINES", "")
    done = run("verify", spec, "--engine", "mujoco", "--engine", "sapien", "--no-behaviors")
    if "pip install sapien" not in done.out:
        pytest.skip("SAPIEN is installed here")
    assert done.code == 0
    assert "not installed" in done.out
    required = run("verify", spec, "--require", "sapien", "--no-behaviors")
    assert required.code == 1
    assert "sapien is required, but it was not found" in required.err


def test_what_cannot_be(spec: Path, tmp_path: Path) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    for arguments, message in (
        (["--engine", "bullet"], "no engine is called `bullet`"),
        ([str(empty)], "does not contain any scenes"),
        (["--no-behaviors"], "there is nothing to verify"),
        (["--build", str(empty)], "--build requires exactly one scene"),
        ([str(spec), "--build", str(empty), "--engine", "mujoco"], "contains none of mjcf"),
    ):
        done = run("verify", *arguments)
        assert done.code == 2, arguments
        assert message in done.err
        assert "Traceback" not in done.err
    shutil.rmtree(empty)


def test_the_page_escapes_every_text() -> None:
    evil = "<script>alert('x')</script>\"&"
    wrong = Difference(evil, "mass", evil, evil, 1.0)
    lost = Difference(evil, "friction", 1.0, 2.0, 1.0, covered=evil)
    readings = [
        ReadbackResult(evil, "mujoco", ReadbackComparison(3, (wrong,), (lost,), (evil,)), "", 0.1),
        ReadbackResult(evil, "usd", None, evil, 0.1),
    ]
    results = [BehaviorResult("free_fall", "mujoco", 2.0, ProofStatus.KNOWN, evil, ""),
               BehaviorResult("period", "mujoco", None, ProofStatus.FAILED, "", evil)]  # fmt: skip
    text = page(readings, results, BEHAVIORS, {"mujoco": None, "usd": None}, {evil: b"png"})
    assert "<script" not in text
    assert text.count("&lt;script&gt;") >= 8
    assert 'alt="&lt;script&gt;alert(&#39;x&#39;)&lt;/script&gt;&#34;&amp;"' in text
    assert "alert('x')" not in text
    assert find_engine("mujoco").name in text
