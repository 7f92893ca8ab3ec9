"""Schemas of documents that extend another: the same parts with fewer required keys."""

from __future__ import annotations

from typing import Any

Schema = dict[str, Any]

OVERLAY = "Overlay"
"""Prefix of the names of the relaxed parts."""

REMOVES = {"label": "null", "description": "Removes what the extended document says here.", "body": "null"}
NULL: Schema = {"type": "null", "description": REMOVES["description"], "defaultSnippets": [REMOVES]}


def loose(part: Any) -> Any:
    """Return a schema without required keys that allows null for any member; lists are replaced as a whole."""
    if isinstance(part, list):
        return [loose(item) for item in part]
    if not isinstance(part, dict):
        return part
    strict = ("required", "minProperties", "maxProperties")
    out = {key: value if key == "items" else loose(value) for key, value in part.items() if key not in strict}
    if "$ref" in out:
        out["$ref"] = out["$ref"].replace("#/$defs/", f"#/$defs/{OVERLAY}")
    if "properties" in part:
        out["properties"] = {name: _nullable(item) for name, item in out["properties"].items()}
    if isinstance(out.get("additionalProperties"), dict):
        out["additionalProperties"] = _nullable(out["additionalProperties"])
    return out


def _nullable(item: Schema) -> Schema:
    """Allow null for a value; texts for editors stay on the outer schema."""
    kept = ("title", "description", "markdownDescription", "defaultSnippets")
    words = {key: item[key] for key in kept if key in item}
    core = {key: value for key, value in item.items() if key not in kept}
    options = core.get("allOf") or core.get("anyOf") or [core]
    return {**words, "anyOf": [*options, NULL]}
