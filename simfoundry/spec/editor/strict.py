"""Schemas for validators that reject everything outside the standard, such as ajv in its strict mode."""

from __future__ import annotations

from typing import Any

# Name of the schema part that contains the schema for editors; the first line of each document refers to it.
EDITOR = "Editor"

# Extensions of JSON Schema for editors; strict validators reject a schema that contains them.
FOR_EDITORS = ("defaultSnippets", "enumDescriptions", "markdownDescription", "patternErrorMessage")

# Keywords whose value is a mapping with arbitrary keys, which may coincide with keywords.
_BY_NAME = ("$defs", "patternProperties", "properties")

# Keywords that apply to only one type of value, by type.
_OF_TYPE = {
    "number": ("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum", "multipleOf"),
    "string": ("pattern", "minLength", "maxLength", "format"),
    "array": ("items", "prefixItems", "minItems", "maxItems", "uniqueItems"),
    "object": (
        "properties",
        "patternProperties",
        "additionalProperties",
        "propertyNames",
        "required",
        "minProperties",
        "maxProperties",
    ),
}
_OF_TYPE["integer"] = _OF_TYPE["number"]


def strict_schema(part: Any) -> Any:
    """Return an equivalent schema that uses only standard keywords and one type in each part.

    Editors show the location of an error if a part has several types, and no location if it has alternatives. Strict
    validators accept only the latter.
    """
    if isinstance(part, list):
        return [strict_schema(item) for item in part]
    if not isinstance(part, dict):
        return part
    out = {key: _strict_value(key, value) for key, value in part.items() if key not in FOR_EDITORS}
    types = out.get("type")
    if not isinstance(types, list):
        return out
    alternatives = [{"type": one} | {key: out[key] for key in _OF_TYPE.get(one, ()) if key in out} for one in types]
    moved = {"type", *(key for one in alternatives for key in one)}
    rest = {key: value for key, value in out.items() if key not in moved}
    if "anyOf" in rest:
        return rest | {"allOf": [*rest.get("allOf", ()), {"anyOf": alternatives}]}
    return rest | {"anyOf": alternatives}


def _strict_value(key: str, value: Any) -> Any:
    if key in _BY_NAME and isinstance(value, dict):
        return {name: strict_schema(item) for name, item in value.items()}
    return value if key in ("const", "enum", "examples", "required") else strict_schema(value)
