"""JSON Schemas of the documents, for editors."""

from __future__ import annotations

import json
from typing import Any

from simfoundry.spec.kinds import KINDS, model_of

DIALECT = "https://json-schema.org/draft/2020-12/schema"


def schemas() -> dict[str, str]:
    """File name to text of every schema, as checked in below ``schemas/``."""
    return {f"{kind.split('/')[0]}.schema.json": _text(kind) for kind in KINDS}


def schema(kind: str) -> dict[str, Any]:
    """The JSON Schema of one kind of document, as ``scene/1``.

    A document that extends another is held against a looser copy: nothing is required, and null removes.
    """
    body = _closed(model_of(kind).model_json_schema())
    parts: dict[str, Any] = body.pop("$defs")
    overlay = {f"{OVERLAY}{name}": _overlay(part) for name, part in {**parts, "Document": body}.items()}
    return {
        "$schema": DIALECT,
        "$id": f"simfoundry/{kind}",
        "title": f"SimFoundry {kind}",
        "description": body.pop("description"),
        "$defs": {**parts, "Document": body, **overlay},
        "if": {"required": ["extends"], "properties": {"extends": {"type": "string"}}},
        "then": {"$ref": f"#/$defs/{OVERLAY}Document"},
        "else": {"$ref": "#/$defs/Document"},
    }


OVERLAY = "Overlay"
"""What the names of loosened parts begin with."""


def _overlay(part: Any) -> Any:
    """The same schema without required keys, in which null may stand for any member."""
    if isinstance(part, list):
        return [_overlay(item) for item in part]
    if not isinstance(part, dict):
        return part
    out = {key: _overlay(value) for key, value in part.items() if key != "required"}
    if "$ref" in out:
        out["$ref"] = out["$ref"].replace("#/$defs/", f"#/$defs/{OVERLAY}")
    for key in ("properties", "patternProperties"):
        if key in out and isinstance(part[key], dict):
            out[key] = {name: _nullable(item) for name, item in out[key].items()}
    if isinstance(out.get("additionalProperties"), dict):
        out["additionalProperties"] = _nullable(out["additionalProperties"])
    return out


def _nullable(item: dict[str, Any]) -> dict[str, Any]:
    """A value, or null to remove it; the words that an editor shows stay outside."""
    if any(option == {"type": "null"} for option in item.get("anyOf", ())):
        return item
    words: dict[str, Any] = {key: item[key] for key in ("description", "title", "default") if key in item}
    inner = {key: value for key, value in item.items() if key not in words}
    return {**words, "anyOf": [inner, {"type": "null"}]}


def _closed(body: Any) -> Any:
    """The same schema, in which a mapping by name takes nothing but names (pydantic leaves other keys open)."""
    if isinstance(body, list):
        return [_closed(item) for item in body]
    if not isinstance(body, dict):
        return body
    closed = {key: _closed(item) for key, item in body.items()}
    return closed | {"additionalProperties": False} if "patternProperties" in closed else closed


def _text(kind: str) -> str:
    return json.dumps(schema(kind), indent=2, ensure_ascii=False) + "\n"
