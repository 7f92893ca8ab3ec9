"""Generate ``docs/reference.md`` from the models. The page lists all keys, with an example for each document kind."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.resources import files
from typing import Any

from simfoundry.spec.editor.schema import Schema
from simfoundry.spec.editor.snippets import literal, title
from simfoundry.spec.models.base import PATTERNS
from simfoundry.spec.models.kinds import KINDS, model_of

INTRODUCTION = """\
# Reference

<!-- Written by `make schemas` from simfoundry/spec; edit the models, not this page. -->

A document is a YAML 1.2 file whose first key names its kind. Lengths are in meters, masses in kilograms, and
times in seconds; keys for angles include the unit. A *name* consists of lowercase letters, digits and `_`, starts with
a letter, and is at most 64 characters long. Unknown and duplicate keys are errors. In the tables, `[number] × 3` means
a list of three numbers, and *name → number* means a mapping from names to numbers. Frames, the order of components and
the meaning of friction are defined in [conventions.md](conventions.md).
"""


def example(kind: str) -> str:
    """Return the example for a document kind, such as ``scene/1``."""
    return (files(__package__) / "examples" / f"{kind.partition('/')[0]}.yaml").read_text(encoding="utf-8")


def reference() -> str:
    """Return the text of the reference page."""
    schemas = {kind: model_of(kind).model_json_schema() for kind in KINDS}
    uses = [set(schema["$defs"]) for schema in schemas.values()]
    shared = {name for name in set().union(*uses) if sum(name in names for names in uses) > 1}
    # Shapes share a table, although only scenes have compounds.
    shared |= {name for name in set().union(*uses) if name.endswith("Shape")}
    lines = [INTRODUCTION]
    parts: dict[str, Schema] = {}
    for kind, schema in schemas.items():
        lines += [f"## {kind}\n", f"{schema['description']}\n", "```yaml", example(kind).rstrip(), "```\n"]
        lines += _table(schema)
        lines += _sections({n: d for n, d in schema["$defs"].items() if n not in shared})
        parts |= {n: d for n, d in schema["$defs"].items() if n in shared}
    lines += ["## Shared by all kinds\n", *_sections(parts)]
    return "\n".join(lines).rstrip() + "\n"


def _sections(parts: dict[str, Schema]) -> Iterator[str]:
    """Yield a heading and a table for each part, sorted by title.

    Shapes share a table because each shape has only one key.
    """
    by_title: dict[str, list[Schema]] = {}
    for name, part in parts.items():
        by_title.setdefault(_title(name), []).append(part)
    for heading, alike in sorted(by_title.items()):
        yield f"### {heading}\n"
        yield f"{alike[0]['description'] if len(alike) == 1 else 'A mapping with exactly one of these keys.'}\n"
        merged = {n: {"description": p["description"], **f} for p in alike for n, f in p["properties"].items()}
        yield from _table(alike[0] if len(alike) == 1 else {"properties": merged})


def _table(model: Schema) -> Iterator[str]:
    yield "| key | type | meaning | default |"
    yield "|---|---|---|---|"
    required = model.get("required", ())
    for key, field in model["properties"].items():
        default = "**required**" if key in required else default_text(field.get("default"))
        meaning = field.get("description", "").replace("|", "\\|")
        yield f"| `{key}` | {type_text(field)} | {meaning} | {default} |"
    yield ""


def _title(name: str) -> str:
    """Return the heading of a model's table: ``Camera`` for ``CameraSpec``, and ``Shape`` for all shapes."""
    return "Shape" if name.endswith("Shape") else title(name).capitalize()


def type_text(field: Schema) -> str:
    """Describe the type of a value, with a link to the table if the value is a mapping."""
    match field:
        case {"anyOf": options} | {"oneOf": options}:
            return " or ".join(dict.fromkeys(type_text(o) for o in options if o.get("type") != "null"))
        case {"$ref": target}:
            name = _title(target.rpartition("/")[2]).lower()
            return f"[{name}](#{name.replace(' ', '-')})"
        case {"const": value}:
            return f"`{value}`"
        case {"enum": values}:
            return ", ".join(f"`{v}`" for v in values)
        case {"prefixItems": items}:
            kinds = [type_text(i) for i in items]
            return f"[{kinds[0]}] × {len(kinds)}" if len(set(kinds)) == 1 else f"[{', '.join(kinds)}]"
        case {"items": item}:
            return f"list of {type_text(item)}{_length(field)}"
        case {"patternProperties": patterns}:
            pattern, value = next(iter(patterns.items()))
            return f"{PATTERNS[pattern].title} → {type_text(value)}"
        case {"pattern": pattern}:
            return PATTERNS[pattern].title
        case {"type": "object", "additionalProperties": dict(value)}:
            return f"text → {type_text(value)}"
        case {"type": "string"}:
            return "text"
        case {"type": "boolean"}:
            return "`true`, `false`"
        case {"type": kind}:
            return f"{kind}{_range(field)}"
        case {"title": _}:
            return "anything"
    raise ValueError(f"cannot describe the type of {field}")


def _length(field: Schema) -> str:
    low, high = field.get("minItems"), field.get("maxItems")
    bounds = [f"at least {low}"] * (low is not None) + [f"at most {high}"] * (high is not None)
    return f" ({', '.join(bounds)})" if bounds else ""


def _range(field: Schema) -> str:
    """Return the bounds of a number, such as `` > 0`` or `` 0 to 1``, or an empty string if it is unbounded."""
    match field:
        case {"minimum": low, "maximum": high}:
            return f" {low} to {high}"
        case {"exclusiveMinimum": low}:
            return f" > {low}"
        case {"minimum": low}:
            return f" ≥ {low}"
    return ""


def default_text(value: Any) -> str:
    """Format a default value, or a dash if there is none."""
    match value:
        case None:
            return "–"
        case dict() | list() if not value:
            return "empty"
        case dict() if any(isinstance(v, dict) and v for v in value.values()):
            return "–"  # sections of their own, which state their defaults
        case dict():
            return ", ".join(f"`{k}: {literal(v)}`" for k, v in value.items() if v is not None)
    return f"`{literal(value)}`"
