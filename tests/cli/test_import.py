"""``simfoundry import``: what it prints, writes, refuses and returns."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from simfoundry.cli.convert import import_command

GOOD = """<robot name="cup"><link name="Cup"><inertial><mass value="0.2"/>
  <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><geometry><cylinder radius="0.04" length="0.1"/></geometry></collision>{more}</link></robot>"""


def _run(*arguments: object) -> Result:
    return CliRunner().invoke(import_command, [str(a) for a in arguments], standalone_mode=False)


@pytest.fixture
def cup(tmp_path: Path) -> Path:
    file = tmp_path / "cup.urdf"
    file.write_text(GOOD.format(more='<contact><stiffness value="3"/></contact>'))
    return file


def test_it_says_what_came_and_what_was_left_out(cup: Path, tmp_path: Path) -> None:
    out = tmp_path / "new/cup.asset.yaml"
    result = _run(cup, "-o", out)
    assert result.return_value == 0
    assert result.output.splitlines() == [
        f"{out}  from URDF: 1 body, 1 link",
        "1 element was left out:",
        "  `<stiffness>` of a link: the scene language cannot express it",
        "1 name changed: cup/Cup -> cup",
    ]
    assert "mass: 0.2" in out.read_text()
    assert [p.name for p in out.parent.iterdir()] == ["cup.asset.yaml"]


def test_strict_makes_what_was_left_out_a_finding(cup: Path, tmp_path: Path) -> None:
    assert _run(cup, "-o", tmp_path / "a.asset.yaml", "--strict").return_value == 1
    cup.write_text(GOOD.format(more=""))
    assert _run(cup, "-o", tmp_path / "b.asset.yaml", "--strict").return_value == 0


def test_json_has_every_note_and_name(cup: Path, tmp_path: Path) -> None:
    report = json.loads(_run(cup, "-o", tmp_path / "a.scene.yaml", "--json").output)
    assert report["notes"] == [
        {"kind": "dropped", "what": "`<stiffness>` of a link", "why": "the scene language cannot express it"}
    ]
    assert (report["format"], report["bodies"]) == ("URDF", 1)


def test_what_exists_is_replaced_only_by_force(cup: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.asset.yaml"
    out.write_text("mine")
    result = _run(cup, "-o", out)
    assert "already exists; choose another output or replace it with --force" in str(result.exception)
    assert out.read_text() == "mine"
    assert _run(cup, "-o", out, "--force").return_value == 0
    assert out.read_text() != "mine"


def test_one_bad_file_of_many_stops_no_other(cup: Path, tmp_path: Path) -> None:
    (tmp_path / "in/deep").mkdir(parents=True)
    (tmp_path / "in/deep/good.urdf").write_text(cup.read_text())
    (tmp_path / "in/bad.urdf").write_text("<robot name='x'>")
    (tmp_path / "in/package.xml").write_text("<package><name>x</name></package>")
    out = tmp_path / "out"
    result = _run(tmp_path / "in", "-o", out)
    assert result.return_value == 2
    bad, good, total = result.output.splitlines()
    assert bad.startswith(f"{tmp_path}/in/bad.urdf") and "refused: 1: the file is not valid XML" in bad
    assert good.endswith("1 body, 1 link; 1 difference from the file")
    assert total == "1 of 2 imported"
    assert sorted(p.relative_to(out).as_posix() for p in out.rglob("*.yaml")) == ["deep/good.asset.yaml"]


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("-o", "a.yaml"), "the output file must be named NAME.scene.yaml or NAME.asset.yaml"),
        (("-o", "a.scene.yaml", "--package", "x"), "expected NAME=PATH"),
    ],
)
def test_wrong_use_is_explained(cup: Path, tmp_path: Path, arguments: tuple[str, ...], reason: str) -> None:
    placed = [tmp_path / a if a.endswith(".yaml") else a for a in arguments]
    assert reason in str(_run(cup, *placed).exception)
