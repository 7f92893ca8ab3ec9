"""The schemas that editors use are those of the models."""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given

from simfoundry.spec.editor.schema import schema, schemas
from simfoundry.spec.editor.strict import FOR_EDITORS, strict_schema
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.yaml.text import parse
from simfoundry.spec.yaml.write import to_data
from tests.cli.command import run
from tests.conftest import REPOSITORY
from tests.spec.strategies import ASSETS, SCENES

SCENE = """
simfoundry: scene/1
name: desk
materials: {wood: {density: 700, color: [0.5, 0.3, 0.1]}}
objects:
  table: {fixed: true, shape: {box: [1.4, 0.7, 0.04]}, material: wood}
  cup: {shape: {cylinder: {radius: 0.04, height: 0.1}}, mass: {value: 0.2, range: [0.1, 0.3], source: vlm}}
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
    found = [e.message for e in jsonschema.Draft202012Validator(_schema(kind)).iter_errors(data)]
    strict = jsonschema.Draft202012Validator(_file(kind))
    editor = jsonschema.Draft202012Validator({"$ref": "#/$defs/Editor", "$defs": _file(kind)["$defs"]})
    assert strict.is_valid(data) == (not found)
    assert [e.message for e in editor.iter_errors(data)] == found
    return found


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
    names = ("scene", "task", "asset", "capture", "cousins", "policy", "dataset")
    assert set(schemas()) == {f"{kind}.schema.json" for kind in names}
    assert Path(REPOSITORY / "schemas").is_dir()


@functools.cache
def _schema(kind: str) -> Any:
    return schema(kind)


@functools.cache
def _file(kind: str) -> Any:
    return json.loads(schemas()[f"{kind.partition('/')[0]}.schema.json"])


KEYWORDS = {
    *("$schema", "$id", "$ref", "$defs", "$comment", "title", "description", "type", "enum", "const"),
    *("if", "then", "else", "allOf", "anyOf", "oneOf", "not", "required", "pattern", "minLength", "maxLength"),
    *("properties", "patternProperties", "additionalProperties", "propertyNames", "minProperties", "maxProperties"),
    *(
        "examples",
        "items",
        "prefixItems",
        "minItems",
        "maxItems",
        "minimum",
        "maximum",
        "exclusiveMinimum",
        "exclusiveMaximum",
    ),
}
"""What of JSON Schema 2020-12 may stand in a schema; there is no `format`, which strict validators refuse as well."""


def _keywords(part: Any) -> Iterator[str]:
    for key, value in part.items() if isinstance(part, dict) else ():
        yield key
        named = key in ("$defs", "properties", "patternProperties")
        below = value.values() if named else value if key in ("allOf", "anyOf", "oneOf", "prefixItems") else (value,)
        for inner in below if key not in ("const", "enum") else ():
            yield from _keywords(inner)


@pytest.mark.parametrize("name", schemas())
def test_schemas_hold_keywords_of_the_standard_only_but_for_the_part_of_editors(name: str) -> None:
    """Validators that are strict, as ajv is by default, refuse a schema with any other."""
    whole = json.loads(schemas()[name])
    editor = whole["$defs"].pop("Editor")
    assert set(_keywords(whole)) <= KEYWORDS
    assert "#/$defs/Editor" not in json.dumps(whole), "what nothing refers to, validators do not read"
    assert set(_keywords(editor)) - KEYWORDS <= set(FOR_EDITORS)
    references = {part["$ref"] for part in _mappings(editor) if "$ref" in part}
    assert references and all(reference.startswith("#/$defs/Editor/$defs/") for reference in references)


@pytest.mark.parametrize("name", schemas())
def test_a_part_has_one_type(name: str) -> None:
    """As strict validators want it; a keyword that one of several types has must not be lost on the way."""
    whole = json.loads(schemas()[name])
    del whole["$defs"]["Editor"]
    assert not [part for part in _mappings(whole) if isinstance(part.get("type"), list)]


def _mappings(part: Any) -> Iterator[dict[str, Any]]:
    if isinstance(part, dict):
        yield part
    for inner in part.values() if isinstance(part, dict) else part if isinstance(part, list) else ():
        yield from _mappings(inner)


def test_a_part_of_several_types_is_divided_and_keeps_the_rest() -> None:
    union = {"type": ["number", "object"], "minimum": 0, "properties": {"pattern": {"type": "string"}}, "title": "mass"}
    number, mapping = (
        {"type": "number", "minimum": 0},
        {"type": "object", "properties": {"pattern": {"type": "string"}}},
    )
    assert strict_schema(union) == {"title": "mass", "anyOf": [number, mapping]}
    both = strict_schema(union | {"anyOf": [{"enum": [1, {}]}]})
    assert both == {"title": "mass", "anyOf": [{"enum": [1, {}]}], "allOf": [{"anyOf": [number, mapping]}]}
    named = {"properties": {"defaultSnippets": {"type": "string", "defaultSnippets": [1]}}}
    assert strict_schema(named) == {"properties": {"defaultSnippets": {"type": "string"}}}


def test_schemas_are_written(tmp_path: Path) -> None:
    assert run("schema", "-o", str(tmp_path)).code == 0
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == schemas()
    assert run("schema", "scene").out == schemas()["scene.schema.json"]


def _keys(kind: str) -> list[tuple[str, str, Any]]:
    """Every key of a schema that documents without `extends` are held against: its part, its name, its schema."""
    parts = {n: p for n, p in _schema(kind)["$defs"].items() if not n.startswith("Overlay")}
    return [(part, key, body) for part, model in parts.items() for key, body in model.get("properties", {}).items()]


KINDS = ("scene/1", "task/1", "asset/1", "capture/1", "cousins/1", "policy/1", "dataset/1")
PURE = {
    *("friction", "restitution", "color", "confidence", "intensity", "direction", "axis", "quat_wxyz"),
    *("grid", "count", "seed", "relations_per_object", "names", "invalid", "background", "horizon", "min", "max"),
    *("open", "closed", "threshold", "retries", "index", "multiplier", "stack", "parameters", "gear"),
    *("segment", "noise", "cutoff", "solver_iterations", "gravity_compensation", "weight", "share"),
    *("uniform", "log_uniform", "times", "shift", "normal", "choose", "from", "until"),
    *("gripper_noise", "image_noise", "depth_dropout", "distortion"),
}
"""Keys of numbers without a unit (the ends of a range are in the unit of the range, noise is in that of the sensor, and
distributions are in that of the value that varies)."""


def _numbers(kind: str, body: Any) -> bool:
    """Whether a number may stand at a place, alone or in a list."""
    parts = _schema(kind)["$defs"]
    types = body.get("type", [])
    if "number" in types or "integer" in types:
        return True
    inner = [*body.get("allOf", ()), *body.get("anyOf", ()), *([body["items"]] if "items" in body else [])]
    inner += body.get("prefixItems", [])
    inner += [parts[body["$ref"].rpartition("/")[2]]] if "$ref" in body else []
    return any(_numbers(kind, part) for part in inner if part.get("type") != "object")


@pytest.mark.parametrize("kind", KINDS)
def test_a_schema_is_one(kind: str) -> None:
    jsonschema = pytest.importorskip("jsonschema", reason="jsonschema checks what editors check")
    jsonschema.Draft202012Validator.check_schema(_schema(kind))


@pytest.mark.parametrize("kind", KINDS)
def test_every_key_of_a_number_says_its_unit(kind: str) -> None:
    units = re.compile(
        r"\[(m|kg|deg|px|s|Hz|rad or m|rad/s or m/s|kg/m\^3|kg m\^2|m/s\^2|N|kg, or)[^\]]*\]|meters|of one unit|steps"
    )
    keys = [(part, key, body) for part, key, body in _keys(kind) if _numbers(kind, body)]
    assert len(keys) > 3
    factors = {"GainsSpec.stiffness", "GainsSpec.damping"}
    without = {f"{part}.{key}" for part, key, body in keys if not units.search(body["description"]) and key not in PURE}
    assert without - factors <= {"Document.relations", "Listed.all", "Listed.any", "Condition.all", "Condition.any"}


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_in_a_whole_document_is_null_and_choices_are_explained(kind: str) -> None:
    for part, key, body in _keys(kind):
        cores = [body, *body.get("allOf", ()), *body.get("anyOf", ())]
        assert not any("null" in core.get("type", []) for core in cores), (part, key)
        for core in cores:
            assert len(core.get("enum", ())) == len(core.get("enumDescriptions", ())), (part, key)
        assert "default" not in body and body["title"] == key


@pytest.mark.parametrize("kind", KINDS)
def test_what_a_key_brings_along_is_valid_there(kind: str) -> None:
    """Each first value, with its holes filled in as they are offered."""
    jsonschema = pytest.importorskip("jsonschema", reason="jsonschema checks what editors check")
    whole = _schema(kind)
    tried = 0
    for part, key, body in _keys(kind):
        for snippet in body.get("defaultSnippets", ()):
            value = _filled(snippet["body"])
            one = {"$defs": whole["$defs"], **body}
            wrong = [e.message for e in jsonschema.Draft202012Validator(one).iter_errors(value)]
            assert wrong == [], (part, key, value)
            tried += 1
    assert tried > 10


def _filled(body: Any) -> Any:
    """What a person gets who takes a first value as it is."""
    if isinstance(body, dict):
        return {str(_filled(key)): _filled(value) for key, value in body.items()}
    if isinstance(body, list | tuple):
        return [_filled(item) for item in body]
    return json.loads(json.dumps(parse(re.sub(r"\$\{\d+:([^{}]*)\}", r"\1", body)).data))


@given(spec=SCENES | ASSETS)
def test_whatever_the_models_take_the_schema_takes(spec: SceneSpec | AssetSpec) -> None:
    """But for the texts of relations, of which the models take any."""
    data = json.loads(json.dumps(to_data(spec)))
    data.pop("relations", None)
    assert errors(spec.simfoundry, data) == []
