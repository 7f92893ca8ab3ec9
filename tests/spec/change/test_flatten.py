"""A flattened document says what the composed one says, whole, and once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hypothesis import given

from simfoundry.spec.change.flatten import digest, flatten, full
from simfoundry.spec.check.validate import validate
from simfoundry.spec.load import load
from simfoundry.spec.models.base import DocumentSpec, Model
from simfoundry.spec.yaml.text import parse
from tests.cli.command import run
from tests.spec.compose.test_extends import TWIN
from tests.spec.strategies import ASSETS, SCENES


@given(SCENES | ASSETS)
def test_flattening_keeps_the_meaning_and_flattening_again_changes_nothing(spec: DocumentSpec) -> None:
    text = flatten(spec)
    again, findings = validate(type(spec), parse(text))
    assert again is not None, findings
    assert again.model_dump() == {**spec.model_dump(), "extends": None}
    assert flatten(again) == text


def leaves(data: Any, defaults: type[Model]) -> set[str]:
    return {name for name, field in defaults.model_fields.items() if field.default not in (None, ...) and name in data}


def test_defaults_are_written_out(tmp_path: Path) -> None:
    (tmp_path / "a.scene.yaml").write_text(TWIN)
    spec = load(tmp_path / "a.scene.yaml").spec
    assert spec is not None
    data = full(spec)
    assert data["gravity"] == (0, 0, -9.81)
    zeros = {"torsional_friction": 0, "rolling_friction": 0, "restitution": 0}
    assert data["materials"]["wood"] == {"density": 700, "friction": 0.5, **zeros}
    assert data["objects"]["cup"]["collision"] == "auto" and data["objects"]["cup"]["fixed"] is False
    assert "place" not in data["objects"]["cup"] and "friction" not in data["objects"]["cup"]


def test_an_overlay_becomes_whole_and_finds_its_files_from_anywhere(tmp_path: Path) -> None:
    (tmp_path / ".git").mkdir()
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib" / "a.obj").write_text("")
    text = TWIN.replace("shape: {cylinder: {radius: 0.04, height: 0.1}}", "asset: a.obj")
    (tmp_path / "lib" / "twin.scene.yaml").write_text(text)
    (tmp_path / "b.scene.yaml").write_text(
        "simfoundry: scene/1\nextends: lib/twin.scene.yaml\nobjects: {plate: null, cup: {mass: 0.3}}\nrelations: []\n"
    )
    done = run("flatten", str(tmp_path / "b.scene.yaml"), "-o", str(tmp_path / "deep" / "c.scene.yaml"))
    assert done.code == 0, done.err
    whole = load(tmp_path / "deep" / "c.scene.yaml")
    assert whole.all_findings() == []
    assert whole.spec is not None and whole.spec.extends is None
    data = full(whole.spec)
    assert list(data["objects"]) == ["desk", "cup"]
    assert (data["objects"]["cup"]["mass"], data["objects"]["cup"]["asset"]) == (0.3, "../lib/a.obj")
    assert run("flatten", str(tmp_path / "b.scene.yaml"), "-o", str(tmp_path / "b.scene.yaml"), "--force").code == 2


def test_the_hash_is_that_of_the_meaning(tmp_path: Path) -> None:
    one, two, three = (tmp_path / f"{name}.scene.yaml" for name in ("one", "two", "three"))
    one.write_text(TWIN)
    two.write_text(TWIN.replace("mass: 0.2", "fixed: false, mass: 2.0e-1").replace("name: twin", "name: twin # a"))
    three.write_text(TWIN.replace("mass: 0.2", "mass: 0.21"))
    hashes = [run("flatten", "--hash", str(path)).out.strip() for path in (one, two, three)]
    assert hashes[0] == hashes[1] != hashes[2]
    spec = load(one).spec
    assert spec is not None and digest(flatten(spec)) == hashes[0]


def test_a_document_with_errors_is_not_flattened(tmp_path: Path) -> None:
    path = tmp_path / "a.scene.yaml"
    path.write_text(TWIN.replace("mass: 0.2", "mass: -1"))
    done = run("flatten", str(path))
    assert done.code == 2 and "SF104" in done.err and done.out == ""
