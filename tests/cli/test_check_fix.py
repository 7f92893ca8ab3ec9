"""`simfoundry check --fix`: what is certain is corrected in the files, and the rest is reported."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.command import run

SLIPPED = """\
simfoundry: scene/1
name: a
materials: {oka: {density: 700}}   # kept
objects:
  cup: {shape: {sphere: 0.04}, mas: 0.2, colr: [1, 0, 0]}
  mug_2: {shape: {sphere: 0.04}, mass: 0.2, material: oak}
relations: [OnTop(cup, mug_1)]
"""


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("simfoundry.yaml").touch()
    Path("a.scene.yaml").write_text(SLIPPED)
    return Path("a.scene.yaml")


def test_certain_corrections_are_written_and_named(path: Path) -> None:
    path.chmod(0o640)
    done = run("check", "--fix", "--no-lints", path)
    assert done.code == 1 and path.stat().st_mode & 0o777 == 0o640
    fixed = SLIPPED.replace("mas:", "mass:").replace("colr:", "color:").replace("material: oak", "material: oka")
    assert path.read_text() == fixed
    assert "fixed a.scene.yaml:5:32: replaced `mas` by `mass`\n" in done.out
    assert "mug_1" in done.err and "mas`" not in done.err, "another number may be another object"


def test_the_difference_is_shown_and_nothing_is_written(path: Path) -> None:
    done = run("check", "--fix", "--diff", path)
    assert done.code == 1 and path.read_text() == SLIPPED
    assert "-  cup: {shape: {sphere: 0.04}, mas: 0.2, colr: [1, 0, 0]}\n" in done.out
    assert run("check", "--diff", path).code == 2


def test_output_for_programs_stays_as_it_is(path: Path) -> None:
    done = run("check", "--fix", "--no-lints", "--json", path)
    assert {d["word"] for d in done.json["findings"]} == {"mug_1"}


def test_what_cannot_be_read_is_only_reported(path: Path) -> None:
    path.write_bytes(b"simfoundry: scene/1\nname: \xff\n")
    done = run("check", "--fix", path)
    assert done.code == 1 and "SF001" in done.err and path.read_bytes().endswith(b"\xff\n")


def test_differences_for_programs_are_part_of_the_one_object(path: Path) -> None:
    done = run("check", "--fix", "--diff", "--no-lints", "--json", path)
    assert done.code == 1 and path.read_text() == SLIPPED
    assert list(done.json["diffs"]) == ["a.scene.yaml"] and "mas" in {d["word"] for d in done.json["findings"]}
    run("check", "--fix", path)
    assert run("check", "--fix", "--diff", "--no-lints", "--json", path).json["diffs"] == {}
    assert run("check", "--fix", "--diff", "--format", "sarif", path).code == 2
