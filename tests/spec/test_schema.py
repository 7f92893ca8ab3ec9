"""The schemas that editors use are those of the models."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from simfoundry.spec.schema import schema, schemas
from tests.conftest import REPOSITORY

SCENE = """
simfoundry: scene/1
name: desk
materials: {wood: {density: 700, color: [0.5, 0.3, 0.1]}}
objects:
  table: {fixed: true, shape: {box: [1.4, 0.7, 0.04]}, material: wood}
  cup: {shape: {cylinder: {radius: 0.04, height: 0.1}}, mass: {value: 0.2, range: [0.1, 0.3], by: vlm}}
  desk: {asset: desk.asset.yaml, joints: {slide: 0.1, flap: {deg: 30}}}
cameras:
  front: {size: [640, 480], fx: 500, fy: 500, pose: {xyz: [1, 0, 1], look_at: [0, 0, 0]}}
relations: ["OnTop(cup, table)"]
"""
ASSET = """
simfoundry: asset/1
name: door
links:
  frame: {parts: {box: {shape: {box: [1, 1, 1]}}}, density: 600}
  door: {parts: {box: {mesh: door.glb, scale: 0.001}}, density: 600}
joints:
  hinge: {type: revolute, parent: frame, child: door, limits_deg: [0, 90]}
"""
CAPTURE = """
simfoundry: capture/1
name: desk
frames:
  first:
    color: color.png
    depth: {image: depth.png, scale: 0.001}
    camera: {fx: 500, fy: 500, cx: 320, cy: 240}
"""


@pytest.mark.parametrize("name", schemas())
def test_checked_in_schemas_are_fresh(name: str, update_goldens: bool) -> None:
    path = REPOSITORY / "schemas" / name
    if update_goldens:
        path.write_text(schemas()[name], encoding="utf-8")
    assert path.read_text(encoding="utf-8") == schemas()[name]


def test_no_schema_is_left_over() -> None:
    assert {p.name for p in (REPOSITORY / "schemas").iterdir()} == set(schemas())


def errors(kind: str, data: Any) -> list[str]:
    jsonschema = pytest.importorskip("jsonschema", reason="jsonschema checks what editors check")
    jsonschema.Draft202012Validator.check_schema(schema(kind))
    return [e.message for e in jsonschema.Draft202012Validator(schema(kind)).iter_errors(data)]


@pytest.mark.parametrize(
    ("kind", "text", "right", "wrong"),
    [
        ("scene/1", SCENE, "material: wood", "materiel: wood"),
        ("scene/1", SCENE, "radius: 0.04", "radius: -0.04"),
        ("scene/1", SCENE, "cup: {shape", "Cup: {shape"),
        ("scene/1", SCENE, "{deg: 30}", "{degrees: 30}"),
        ("scene/1", SCENE, "[1.4, 0.7, 0.04]", "[1.4, 0.7]"),
        ("scene/1", SCENE, "scene/1", "scene/2"),
        ("asset/1", ASSET, "type: revolute", "type: hinge"),
        ("asset/1", ASSET, "scale: 0.001", "scale: 0"),
        ("capture/1", CAPTURE, "cy: 240", "cz: 240"),
    ],
)
def test_a_valid_document_validates_and_a_slip_does_not(kind: str, text: str, right: str, wrong: str) -> None:
    assert errors(kind, yaml.safe_load(text)) == []
    assert text.count(right) >= 1
    assert errors(kind, yaml.safe_load(text.replace(right, wrong))) != []


OVERLAY = """
simfoundry: scene/1
extends: twin.scene.yaml
objects:
  cup: {mass: 0.3, pose: {yaw_deg: 30}}
  plate: null
  bowl: {place: null, pose: {xyz: [0, 0, 1]}}
cameras: {front: {fx: 510}}
"""


@pytest.mark.parametrize(
    ("right", "wrong"), [("mass: 0.3", "mas: 0.3"), ("yaw_deg: 30", "yaw_deg: east"), ("fx: 510", "fx: -1")]
)
def test_an_overlay_need_not_be_whole_and_slips_are_still_seen(right: str, wrong: str) -> None:
    assert errors("scene/1", yaml.safe_load(OVERLAY)) == []
    assert errors("scene/1", yaml.safe_load(OVERLAY.replace(right, wrong))) != []
    assert errors("scene/1", yaml.safe_load(OVERLAY.replace("extends: twin.scene.yaml", "name: a"))) != []


def test_every_field_is_described() -> None:
    for name, text in schemas().items():
        for title, model in json.loads(text)["$defs"].items():
            for field, body in model.get("properties", {}).items():
                described = "description" in body or "$ref" in {**body, **body.get("anyOf", [{}])[0]}
                assert described, (name, title, field)


def test_documents_name_the_schema_files() -> None:
    assert set(schemas()) == {f"{kind}.schema.json" for kind in ("scene", "task", "asset", "capture", "cousins")}
    assert Path(REPOSITORY / "schemas").is_dir()
