"""Generate JSON Schemas for documents, which editors use for completion, hover texts, and error messages.

The schemas are generated from the models and adapted for editors. Alternatives of different types, such as a number or
a mapping with a range, are combined into one schema, so that editors can show the location of an error instead of "no
match". Each key has a description with its unit, and an initial value. ``null`` is allowed only in documents that
extend another document, where it removes a value.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from simfoundry.spec.editor import snippets
from simfoundry.spec.editor.snippets import (
    Body,
    literal,
    one_line,
    predicates,
    robots,
    sentence,
    title,
    without_placeholders,
)
from simfoundry.spec.editor.strict import EDITOR, strict_schema
from simfoundry.spec.models.base import PATTERNS
from simfoundry.spec.models.kinds import KINDS, model_of
from simfoundry.spec.models.predicate import PREDICATES, built_in_predicates

Schema = dict[str, Any]

DIALECT = "https://json-schema.org/draft/2020-12/schema"
_PART_SHAPES = {
    *("BoxShape", "SphereShape", "EllipsoidShape", "CylinderShape", "CapsuleShape", "ConeShape", "PrismShape"),
    *("LatheShape", "OpenBoxShape"),
}
# Names of the schema parts that combine alternatives, each with the models that it combines.
UNIONS = {
    "PartShape": _PART_SHAPES,
    "Shape": {*_PART_SHAPES, "CompoundShape"},
    "Condition": {"AllOf", "AnyOf", "NoneOf"},
    "Quantity": {"Estimate"},
    "JointPosition": {"Degrees"},
    "RobotModel": {"RobotFiles"},
}

# Pattern for the end of a predicate. Inside braces, YAML splits ``goal: OnTop(cup, desk)`` at the comma and parses the
# end as a key.
FRAGMENT = r"^[^(]*\)$|^[-+]?[0-9.]+$"


def _predicate_pattern() -> str:
    """Return a pattern for a predicate, or for a part of one if YAML has split it at a comma in brackets."""
    aliases = (alias for predicate in built_in_predicates().values() for alias in predicate.aliases)
    return rf"^\s*({'|'.join((*PREDICATES.built_in, *aliases))})\s*\([^()]*\)?\s*$|^[^()]*\)$"


# Name of the schema part for conditions in a list, where YAML parses the middle of ``At(cup, 0.1, 0.2)`` as a number.
LISTED = "Listed"


# Keywords that describe a value, and keywords whose value is not a schema.
_WORDS = ("title", "description", "markdownDescription", "defaultSnippets")
_LITERAL = (*_WORDS, "enum", "const", "required", "pattern")


def schemas() -> dict[str, str]:
    """Return the name and content of every file in ``schemas/``.

    The schema itself uses only standard keywords, so that strict validators accept it. The part `EDITOR` is the
    equivalent schema for editors, with snippets and messages. Validators do not read it, because nothing refers to it.
    """
    return {f"{kind.split('/')[0]}.schema.json": _text(kind) for kind in KINDS}


def schema(kind: str) -> Schema:
    """Return the JSON Schema for editors for a document kind, such as ``scene/1``.

    A document that extends another document is validated against a relaxed copy of the schema, which has no required
    keys and in which null removes a value.
    """
    parts = _Parts(model_of(kind).model_json_schema()).all()
    if "parameters" in parts["Document"]["properties"]:
        parts = with_expressions(parts) | {"Expression": EXPRESSION}
    overlay = {f"{OVERLAY}{name}": loose(part) for name, part in parts.items()}
    if "templates" in parts["Document"]["properties"]:
        _allow_removal(parts["Document"]["properties"]["objects"])
    never_null = {key: parts["Document"]["properties"][key] for key in ("simfoundry", "extends")}
    overlay[f"{OVERLAY}Document"]["properties"] |= never_null
    extends = {"title": "extends", "type": "string"}
    return {
        "$schema": DIALECT,
        "$id": f"simfoundry/{kind}",
        "title": f"SimFoundry {kind}",
        "description": parts["Document"]["description"],
        "$defs": {**parts, **overlay},
        "if": {"type": "object", "required": ["extends"], "properties": {"extends": extends}},
        "then": {"$ref": f"#/$defs/{OVERLAY}Document"},
        "else": {"$ref": "#/$defs/Document"},
    }


# A number that is computed from parameters.
EXPRESSION: Schema = {
    "title": "expression",
    "description": "An expression with parameters, such as `2 * $gap`.",
    "type": "string",
    "pattern": r"^[-+*/(). 0-9eE$a-z_]*\$[a-z][-+*/(). 0-9eE$a-z_]*$",
    "patternErrorMessage": "expected a number, or an expression with parameters such as `2 * $gap`",
}


def with_expressions(part: Any) -> Any:
    """Return a schema that accepts an expression wherever it accepts a number but no other string."""
    if isinstance(part, list):
        return [with_expressions(item) for item in part]
    if not isinstance(part, dict):
        return part
    out = {key: value if key in _LITERAL else with_expressions(value) for key, value in part.items()}
    types = part.get("type")
    listed = [types] if isinstance(types, str) else types if isinstance(types, list) else []
    if {"number", "integer"}.isdisjoint(listed) or "string" in listed:
        return out
    words = {key: out.pop(key) for key in _WORDS if key in out}
    return words | {"anyOf": [out, {"$ref": "#/$defs/Expression"}]}


@dataclass
class _Parts:
    """The parts of a model's schema, adapted for editors."""

    raw: Schema
    joined: dict[str, Schema] = field(default_factory=dict)

    def all(self) -> dict[str, Schema]:
        """Return all parts by name. The part for the entire document is named ``Document``."""
        title = self.raw["title"]
        apart = set().union(*UNIONS.values())
        parts = {name: self.model(name, body) for name, body in self.raw["$defs"].items() if name not in apart}
        words = {"title": title.removesuffix("Spec").lower(), "description": self.raw["description"]}
        parts["Document"] = self.model(title, self.raw) | words
        return dict(sorted((parts | self.joined).items()))

    def model(self, owner: str, body: Schema) -> Schema:
        """Return the schema of a mapping with known keys, starting with the key for the document kind."""
        keys = sorted(body["properties"], key=lambda key: key != "simfoundry")
        properties = {key: self.key(owner, key, body["properties"][key]) for key in keys}
        required = sorted(body.get("required", ()), key=keys.index)
        whole = {
            "$comment": body["description"],
            "type": "object",
            "properties": properties,
            **({"required": required} if required else {}),
            "additionalProperties": False,
        }
        return whole | _fragments(properties)

    def key(self, owner: str, key: str, body: Schema) -> Schema:
        """Return the schema for a key, including its description and an initial value."""
        core, text = self.core(body), self.text(owner, key, body)
        default = body.get("default")
        plain = default if isinstance(default, int | float | str | list) and default != [] else None
        if plain is not None and "efault" not in text:
            text = f"{text.rstrip('.')}; default: {literal(plain)}."
        words = _words(key, text)
        if "enum" in core or "const" in core:
            return words | core
        first = snippets.initial_value(owner, key, plain)
        return words | ({"anyOf": [core]} if first is None else _snippet(first, text) | {"allOf": [core]})

    def text(self, owner: str, key: str, body: Schema) -> str:
        """Return the description of a key, or the description of its value if the key has none."""
        said = body.get("description") or snippets.lookup("descriptions", f"{owner}.{key}")
        return str(said or self.raw["$defs"][body["$ref"].rpartition("/")[2]]["description"])

    def core(self, body: Schema) -> Schema:
        """Return the schema for a value, without descriptions."""
        options = _options(body)
        if len(options) > 1:
            named = {option["$ref"].rpartition("/")[2] for option in options if "$ref" in option}
            union = next((name for name, models in UNIONS.items() if named == models), None)
            if union is None:
                return self.join(options)
            if union not in self.joined:
                self.joined[union] = {}  # conditions are recursive
                self.joined[union] = self.join(options) | _special(union)
            return {"$ref": f"#/$defs/{union}"}
        (body,) = options
        if "$ref" in body:
            return {"$ref": body["$ref"]}
        if "patternProperties" in body:
            ((pattern, value),) = body["patternProperties"].items()
            words = {"title": PATTERNS[pattern].placeholder, "description": sentence(PATTERNS[pattern].rule)}
            keys = words | _pattern(pattern) | body.get("propertyNames", {})
            bounds = {key: body[key] for key in ("minProperties",) if key in body}
            return {"type": "object", "propertyNames": keys, "additionalProperties": self.member(value), **bounds}
        if isinstance(body.get("additionalProperties"), dict):
            return {"type": "object", "additionalProperties": self.member(body["additionalProperties"])}
        plain = {k: v for k, v in body.items() if k not in ("title", "description", "default")}
        if "prefixItems" in plain:
            items = [self.core(item) for item in plain.pop("prefixItems")]
            return plain | ({"items": items[0]} if all(i == items[0] for i in items) else {"prefixItems": items})
        if "items" in plain:
            return plain | {"items": self.item(plain["items"])}
        if plain.get("type") == "boolean":
            plain = {"enum": [False, True]}
        if "enum" in plain:
            return plain | {"enumDescriptions": snippets.meanings(list(map(literal, plain["enum"])))}
        return plain | (_pattern(plain["pattern"]) if "pattern" in plain else {})

    def item(self, body: Schema) -> Schema:
        """Return the schema for an item in a list."""
        core = self.core(body)
        if core == {"type": "string"}:  # relations are the only free-form strings in lists
            return {"type": ["string", "number"], **_special("Condition")}
        if core == {"$ref": "#/$defs/Condition"}:
            if LISTED not in self.joined:
                self.joined[LISTED] = {}
                joined = self.join(_options(body)) | _special("Condition")
                self.joined[LISTED] = joined | {"type": ["string", "number", "object"]}
            return {"$ref": f"#/$defs/{LISTED}"}
        return core

    def member(self, body: Schema) -> Schema:
        """Return the schema for a member that can have any name."""
        core = self.core(body)
        model = core.get("$ref", "").rpartition("/")[2]
        described = self.raw["$defs"].get(model, {}).get("description", "")
        if not described:
            return core
        words = _words(title(model), described)
        first = snippets.lookup("members", model)
        return words | ({} if first is None else _snippet(first, described)) | {"allOf": [core]}

    def join(self, options: list[Schema]) -> Schema:
        """Combine alternatives into one schema, in which each keyword applies to only one type of value."""
        out: Schema = {}
        types: list[str] = []
        models = [o["$ref"].rpartition("/")[2] for o in options if "$ref" in o]
        for option in options:
            core = self.core(option) if "$ref" not in option else {"type": "object"}
            kind = core.pop("type")
            types += [kind] if kind not in types else []
            if "const" in core:
                core = {"pattern": f"^{core['const']}$", "patternErrorMessage": f"expected `{core['const']}`"}
            if "items" in core and "items" in out:  # lists of numbers, or of lists of numbers
                core |= {"items": {"anyOf": [out.pop("items"), core["items"]]}}
            bounds = {"minItems": min, "maxItems": max}
            out |= {k: bounds[k](out[k], v) if k in bounds and k in out else v for k, v in core.items()}
        if models:
            out |= self.join_models(models)
        return {"type": types if len(types) > 1 else types[0], **out}

    def join_models(self, names: list[str]) -> Schema:
        """Combine alternative models into a mapping that accepts the keys of all models."""
        bodies = [self.raw["$defs"][name] for name in names]
        if len(names) == 1:
            whole = self.model(names[0], bodies[0])
            return {k: v for k, v in whole.items() if k not in ("$comment", "type")}
        properties = {}
        for name, body in zip(names, bodies, strict=True):
            alone = len(body["properties"]) == 1
            for key, value in body["properties"].items():
                text = self.text(name, key, value)
                text = f"{body['description']} {text}" if alone else text
                properties[key] = self.key(name, key, value | {"description": text})
        return {"properties": properties, "additionalProperties": False, "minProperties": 1} | _fragments(properties)


def _options(body: Schema) -> list[Schema]:
    """Return the alternatives for a value, including nested ones but without null."""
    for key in ("anyOf", "oneOf"):
        if key in body:
            return [inner for option in body[key] for inner in _options(option)]
    return [] if body == {"type": "null"} else [body]


def _special(union: str) -> Schema:
    """Return the additional schema keywords for a union that cannot be derived from its models."""
    if union == "Condition":
        message = f"expected a predicate such as `OnTop(cup, desk)`; valid: {', '.join(PREDICATES.built_in)}"
        return {"pattern": _predicate_pattern(), "patternErrorMessage": message, "defaultSnippets": predicates()}
    if union in (
        "Shape",
        "PartShape",
    ):  # separate from the keys, because editors stop offering keys if the maximum is one
        return {"allOf": [{"maxProperties": 1}]}
    return {"defaultSnippets": robots()} if union == "RobotModel" else {}


def _pattern(pattern: str) -> Schema:
    return {"pattern": pattern, "patternErrorMessage": PATTERNS[pattern].rule}


def _fragments(properties: Schema) -> Schema:
    """Return keywords that allow the pieces of a free-form text that YAML has split at commas."""
    cores = [core for value in properties.values() for core in (value, *value.get("allOf", ()))]
    free = any("pattern" not in core and core.get("type") == "string" and "const" not in core for core in cores)
    conditions = any(core.get("$ref") == "#/$defs/Condition" for core in cores)
    return {"patternProperties": {FRAGMENT: {"type": "null"}}} if free or conditions else {}


def _words(title: str, text: str) -> Schema:
    """Return a title and a description, with a Markdown version if the description contains Markdown syntax."""
    markdown = {"markdownDescription": text} if re.search(r"[\\`*_{}\[\]#+!]", text) else {}
    return {"title": title, "description": text, **markdown}


def _snippet(body: Body, text: str) -> Schema:
    """Return a suggestion for editors, with a one-line label that has no placeholders."""
    label = without_placeholders(one_line(body))
    return {"defaultSnippets": [{"label": label, "description": text, "body": body}]}


@cache
def _text(kind: str) -> str:
    parts = "#/$defs/"
    for_editors = schema(kind)
    whole = strict_schema(for_editors)
    nested = json.dumps({key: value for key, value in for_editors.items() if not key.startswith(("$schema", "$id"))})
    nested = nested.replace(f'"$ref": "{parts}', f'"$ref": "{parts}{EDITOR}/$defs/')
    whole["$defs"][EDITOR] = json.loads(nested)
    return json.dumps(whole, indent=2, ensure_ascii=False) + "\n"


# Prefix for the names of relaxed parts.
OVERLAY = "Overlay"

REMOVES = {"label": "null", "description": "Removes the value that the extended document specifies.", "body": "null"}
NULL: Schema = {"type": "null", "description": REMOVES["description"], "defaultSnippets": [REMOVES]}


def loose(part: Any) -> Any:
    """Return a schema that has no required keys and allows null for any member. Lists are replaced as a whole."""
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


def _allow_removal(section: Schema) -> None:
    """Let null stand for a member of a section, where it removes a copy or a member of an included scene."""
    (core,) = section.get("allOf") or section.get("anyOf") or [section]
    # Editors do not offer it, because most new members are not removals.
    core["additionalProperties"] = {"anyOf": [core["additionalProperties"], {"type": "null"}]}


def _nullable(item: Schema) -> Schema:
    """Return a schema that also allows null. Descriptions for editors stay on the outer level."""
    kept = ("title", "description", "markdownDescription", "defaultSnippets")
    core = dict(item)
    words = {key: core.pop(key) for key in kept if key in item}
    options = core.get("allOf") or core.get("anyOf") or [core]
    return {**words, "anyOf": [*options, NULL]}
