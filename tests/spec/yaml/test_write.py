"""The canonical text says what the document says, and saying it again changes nothing."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simfoundry.spec.check.validate import validate
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.base import Model
from simfoundry.spec.models.reuse import FramedPose
from simfoundry.spec.models.scene import ObjectSpec, SceneSpec
from simfoundry.spec.models.shapes import BoxShape
from simfoundry.spec.yaml.text import parse
from simfoundry.spec.yaml.write import number, to_data, to_yaml
from tests.spec.strategies import ASSETS, SCENES, TEXTS


def same(a: Any, b: Any) -> bool:
    """Equal, numbers up to six decimals (tiny ones up to four digits, which is finer)."""
    if isinstance(a, float | int) and isinstance(b, float | int) and not isinstance(a, bool):
        return math.isclose(a, b, rel_tol=1e-14, abs_tol=5.1e-7)
    if isinstance(a, dict):
        return isinstance(b, dict) and list(a) == list(b) and all(same(a[k], b[k]) for k in a)
    if isinstance(a, tuple):
        return isinstance(b, tuple) and len(a) == len(b) and all(map(same, a, b))
    return type(a) is type(b) and bool(a == b)


def full(spec: Model) -> Any:
    """Plain data of a whole document, defaults included."""
    return spec.model_dump()


def reread(spec: Model) -> Model:
    document = parse(to_yaml(spec))
    again, findings = validate(type(spec), document)
    assert again is not None, (findings, document.text)
    return again


@given(SCENES)
def test_a_scene_survives_its_text(spec: SceneSpec) -> None:
    again = reread(spec)
    assert same(full(spec), full(again))
    assert to_yaml(again) == to_yaml(spec)


@given(ASSETS)
def test_an_asset_survives_its_text(spec: AssetSpec) -> None:
    again = reread(spec)
    assert same(full(spec), full(again))
    assert to_yaml(again) == to_yaml(spec)


@given(st.lists(TEXTS, max_size=5))
def test_every_text_survives(texts: list[str]) -> None:
    spec = SceneSpec(simfoundry="scene/1", name="a", description="".join(texts), relations=tuple(texts), objects={})
    again = reread(spec)
    assert again == spec


@given(st.floats(-1e18, 1e18))
def test_numbers_are_short_and_exact_to_six_decimals(value: float) -> None:
    text = number(value)
    back = parse(text).data
    assert math.isclose(back, value, rel_tol=1e-14, abs_tol=5.1e-7)
    assert number(float(back)) == text
    assert len(text) <= 24


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (-0.0, "0"),
        (-1e-9, "-1.0e-9"),
        (0.1 + 0.2, "0.3"),
        (1 / 3, "0.333333"),
        (100.0, "100"),
        (-1234.5, "-1234.5"),
        (1.23456e-5, "1.235e-5"),
        (1e300, "1.0e+300"),
    ],
)
def test_numbers_are_written_as_people_do(value: float, text: str) -> None:
    assert number(value) == text


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_what_is_no_number_is_not_written(value: float) -> None:
    with pytest.raises(ValueError, match="cannot be written"):
        number(value)


def plain_objects(count: int) -> dict[str, ObjectSpec]:
    return {
        f"object_with_a_long_name_{k}": ObjectSpec(
            shape=BoxShape(box=(0.123456, 0.234567, 0.345678)),
            mass=0.123456,
            material="some_material_with_a_long_name",
            pose=FramedPose(xyz=(1.234567, -2.345678, 3.456789), quat_wxyz=(0.5, -0.5, 0.5, -0.5)),
        )
        for k in range(count)
    }


@given(SCENES | ASSETS)
def test_lines_are_short_where_they_can_be(spec: Model) -> None:
    for line in to_yaml(spec).splitlines():
        assert len(line) <= 110 or '"' in line, line  # a text in quotes stays on its line


def test_lines_of_plain_documents_stay_below_the_width() -> None:
    spec = SceneSpec(simfoundry="scene/1", name="wide", objects=plain_objects(3))
    assert max(map(len, to_yaml(spec).splitlines())) <= 110


def test_the_form_of_a_scene_is_the_one_people_know() -> None:
    text = """\
simfoundry: scene/1
name: desk
gravity: [0, 0, -1.62]

objects:
  table:
    fixed: true
    shape: {box: [1.4, 0.7, 0.04]}
    pose: {xyz: [0.45, 0, -0.02]}
  cup:
    category: mug
    shape: {cylinder: {radius: 0.04, height: 0.1}}
    mass: {value: 0.2, range: [0.1, 0.3], source: "material: ceramic"}
    pose: {xyz: [0.4, 0.1, 0.05], yaw_deg: 30}

relations:
  - OnTop(cup, table)
  - Upright(cup)
"""
    spec, findings = validate(SceneSpec, parse(text))
    assert spec is not None and findings == []
    assert to_yaml(spec) == text
    assert to_yaml(spec, comment="first\n\nsecond").startswith("# first\n#\n# second\nsimfoundry: ")


def test_defaults_are_not_written_and_required_fields_are() -> None:
    spec = SceneSpec(simfoundry="scene/1", name="a", objects={"cup": ObjectSpec(shape=BoxShape(box=(1, 2, 3)))})
    assert to_data(spec) == {"simfoundry": "scene/1", "name": "a", "objects": {"cup": {"shape": {"box": (1, 2, 3)}}}}


def test_the_text_is_written_in_one_step(tmp_path: Path) -> None:
    from simfoundry.runtime.files import write_atomically

    target = tmp_path / "deep" / "a.scene.yaml"
    write_atomically(target, b"one")
    write_atomically(target, b"two")
    assert target.read_bytes() == b"two"
    assert [p.name for p in target.parent.iterdir()] == ["a.scene.yaml"]
    assert target.stat().st_mode & 0o777 == 0o644
