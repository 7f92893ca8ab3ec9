"""Validate data against a model, and convert pydantic's errors to findings with a location and a hint."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any, TypeVar

from pydantic import ValidationError

from simfoundry.spec.diagnostics import Diagnostic, nearest
from simfoundry.spec.models.base import PATTERNS, SHAPE_KEYS, WIRE_KEY, Model
from simfoundry.spec.models.types import former_keys, models_at
from simfoundry.spec.yaml.spelling import number
from simfoundry.spec.yaml.text import Document, Path_

M = TypeVar("M", bound=Model)

# Maximum number of findings per kind of check and document, which limits the output for malicious input.
MAX_FINDINGS = 200

_CODES = {
    "missing": "SF102",
    "extra_forbidden": "SF101",
    **dict.fromkeys(("too_short", "too_long", "string_too_long"), "SF105"),
    **dict.fromkeys(("greater_than", "greater_than_equal", "less_than", "less_than_equal", "finite_number"), "SF104"),
    **dict.fromkeys(("literal_error", "string_pattern_mismatch"), "SF106"),
}

# Prefixes of pydantic error types and the corresponding terms for document values.
_EXPECTED = {
    "model": "a mapping",
    "dict": "a mapping",
    "tuple": "a list",
    "string": "a string",
    "bool": "`true` or `false`",
    "int": "an integer",
    "float": "a number",
}


# Keys of a condition mapping; each condition has exactly one of them.
_JOINED = {"all", "any", "not"}

_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
# Number with a unit.
_MEASURED = re.compile(r"([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)) ?(mm|cm|m|g|kg|deg|°)\Z")

# Hint for each unit and the factor that converts it to the unit used in documents.
_UNITS = {
    "mm": ("lengths are in m", 0.001),
    "cm": ("lengths are in m", 0.01),
    "m": ("lengths are in m", 1.0),
    "g": ("masses are in kg", 0.001),
    "kg": ("masses are in kg", 1.0),
    "deg": ("angles are in degrees", 1.0),
    "°": ("angles are in degrees", 1.0),
}


def validate(model: type[M], document: Document) -> tuple[M | None, list[Diagnostic]]:
    """Return the typed document and the findings; the document is None if there are errors."""
    findings = [*document.duplicates, *_without_value(model, document)]
    try:
        spec = model.model_validate(document.data)
    except ValidationError as error:
        errors = [e for e in error.errors(include_url=False) if e["input"] is not None or e["type"] == "missing"]
        unknown = {e["loc"][:-1] for e in errors if e["type"] == "extra_forbidden"}
        errors = [e for e in errors if not (_is_guess(e) and e["loc"][:-1] in unknown)]
        findings += _new_members_first([_finding(model, document, e) for e in errors[:MAX_FINDINGS]], document)
        if len(errors) > MAX_FINDINGS:
            more = f"{len(errors) - MAX_FINDINGS} more errors are not shown"
            findings.append(replace(findings[-1], message=more, hint="fix these first"))
        return None, findings
    return (None if findings else spec), findings


def _new_members_first(findings: list[Diagnostic], document: Document) -> list[Diagnostic]:
    """Reword findings about members that a document adds to its base.

    Usually, the name of an existing member was misspelled, which is reported as a single finding.
    """
    out, named = list[Diagnostic](), set[Path_]()
    for d in findings:
        parts = tuple(d.path.split("."))
        member = next((parts[:k] for k in (len(parts), len(parts) - 1) if k > 1 and parts[:k] in document.added), None)
        if member is None or not (d.code == "SF102" or d.message.endswith(" is needed")):
            out.append(d)
        elif member not in named:
            named.add(member)
            kind = member[-2].removesuffix("s")
            message = f"the extended document has no {kind} `{member[-1]}`, and the new one is incomplete: {d.message}"
            hint = nearest(str(member[-1]), document.added[member])
            out.append(document.finding("SF201", member, message, hint or d.hint, of_key=True))
    return out


def _without_value(model: type[Model], document: Document) -> list[Diagnostic]:
    """Return a finding for each key or item without a value; null is allowed only to remove a value from the base."""
    found: list[tuple[str | int, ...]] = []
    todo: list[tuple[tuple[str | int, ...], Any]] = [((), document.data)] if isinstance(document.data, dict) else []
    while todo:
        path, data = todo.pop()
        for part, value in data.items() if isinstance(data, dict) else enumerate(data):
            if value is None:
                found.append((*path, part))
            elif isinstance(value, dict | tuple) and part != "conflicts":
                todo.append(((*path, part), value))
    findings = []
    for path in sorted(found, key=str)[:MAX_FINDINGS]:
        what = f"`{path[-1]}`" if isinstance(path[-1], str) else "a list item"
        hint = _description(model, path) or "add a value, or remove the key"
        findings.append(document.finding("SF103", path, f"{what} has no value", hint))
    return findings


def sound_part(model: type[M], document: Document) -> M | None:
    """Return the valid part of a document with errors, so that the remaining checks can run on it.

    Invalid members of a section, such as an object or a relation, are omitted entirely, and other invalid values are
    omitted together with their key. Returns None if the rest is not valid either.
    """
    data = document.data
    if not isinstance(data, dict):
        return None
    try:
        return model.model_validate(data)
    except ValidationError as error:
        faulty = {e["loc"][:2] for e in error.errors(include_url=False)}
    sound: dict[str, Any] = {"name": "unnamed"} if ("name",) in faulty else {}
    for key, value in data.items():
        if (key,) in faulty:
            continue
        if isinstance(value, dict):
            sound[key] = {name: member for name, member in value.items() if (key, name) not in faulty}
        elif isinstance(value, tuple):
            sound[key] = tuple(item for k, item in enumerate(value) if (key, k) not in faulty)
        else:
            sound[key] = value
    try:
        return model.model_validate(sound)
    except ValidationError:
        return None


def _finding(model: type[Model], document: Document, error: Any) -> Diagnostic:
    kind: str = error["type"]
    loc = tuple(part for part in error["loc"] if part != "[key]")
    of_key = "[key]" in error["loc"] or kind in ("extra_forbidden", "missing")
    message, hint = _words(model, kind, loc, error)
    code = kind.upper() if kind.startswith("sf") else _CODES.get(kind, "SF103")
    path = document.known(loc)
    if kind == "missing" and isinstance(loc[-1], int):  # one finding for the list, not one per missing item
        code, of_key = "SF105", False
    elif kind == "missing":
        path += loc[-1:]
    elif kind.startswith("sf") and "at" in error.get("ctx", {}):
        path += (error["ctx"]["at"],)
    return document.finding(code, path, message, hint, of_key=of_key)


def _words(model: type[Model], kind: str, loc: tuple[Any, ...], error: Any) -> tuple[str, str]:
    """Return the message and hint for one pydantic error."""
    last = loc[-1] if loc else ""
    description = _description(model, loc)
    if kind.startswith("sf"):
        return error["msg"], ""
    if kind == "extra_forbidden":
        names = {n for m in models_at(model, loc[:-1]) for n in m.model_fields}
        if _is_shape(model, loc):
            names = set(SHAPE_KEYS)
        elif names and names <= _JOINED:
            names = _JOINED
        if last in SHAPE_KEYS and "shape" in names:
            return f"unknown key `{last}`", f"write `shape: {{{last}: ...}}`"
        former = {old: new for m in models_at(model, loc[:-1]) for old, new in former_keys(m).items()}
        if last in former:
            return f"the key `{last}` was renamed to `{former[last]}`", "run `simfoundry migrate` on the file"
        return f"unknown key `{last}`", nearest(str(last), names)
    if kind == "missing" and isinstance(last, int):
        return f"values are missing: the list has only {len(error['input'])}", description
    if kind == "missing":
        if last in SHAPE_KEYS:
            return "a shape is missing", f"specify one of {', '.join(f'`{k}`' for k in SHAPE_KEYS)}"
        return f"`{last}` is missing", description
    found = _shown(error["input"])
    if "[key]" in error["loc"] or kind == "string_pattern_mismatch":
        pattern = error.get("ctx", {}).get("pattern")
        if pattern == WIRE_KEY:
            return f"{found} is not a key", PATTERNS[pattern].rule
        suggestion = _as_name(str(error["input"]))
        rule = "a name consists of lower-case letters, digits and `_`, and starts with a letter"
        return f"{found.removeprefix('the string ')} is not a name", rule + (f": `{suggestion}`" if suggestion else "")
    if kind == "literal_error":
        choices = [c.strip().strip("'") for c in error["ctx"]["expected"].replace(" or ", ", ").split(",")]
        return f"{found.removeprefix('the string ')} is not valid here", nearest(str(error["input"]), choices)
    if kind in ("too_long", "too_short", "string_too_long"):
        bound = error["ctx"].get("max_length") if "long" in kind else error["ctx"]["min_length"]
        values = "characters" if kind == "string_too_long" else "values"
        most = "at most" if "long" in kind else "at least"
        return f"expected {most} {bound} {values}, found {len(error['input'])}", description
    if kind == "float_type" and isinstance(error["input"], str) and _NUMBER.fullmatch(error["input"]):
        description = "remove the quotes"
    elif kind == "float_type" and (measured := _MEASURED.match(str(error["input"]))):
        rule, factor = _UNITS[measured[2]]
        description = f"{rule}, without the unit: `{number(float(measured[1]) * factor)}`"
    elif kind == "string_type" and isinstance(error["input"], int | float):
        description = "put it in double quotes"
    elif kind == "model_type" and (key := _only_key(model, loc)):
        description = f"write `{{{key}: {error['input']}}}`"
    elif kind == "dict_type" and isinstance(error["input"], tuple | list):
        description = f"{description} Write `name: ...` for each, without `-`." if description else ""
    return f"expected {_expected(error)}, found {found}", description


def _expected(error: Any) -> str:
    """Describe the value that pydantic expected, in the terms of the document."""
    words: str = error["msg"].removeprefix("Input should be ")
    if error["type"].startswith(("greater", "less")):
        return f"a number {words}"
    for kind, name in _EXPECTED.items():
        if error["type"].startswith(kind):
            return name
    return words


def _shown(value: Any) -> str:
    match value:
        case None:
            return "nothing"
        case dict():
            return "a mapping"
        case tuple() | list():
            return f"a list of {len(value)}"
        case bool():
            return f"`{str(value).lower()}`"
        case str():
            return f"the string `{value[:40]}`"
    return f"`{value}`"


def _as_name(text: str) -> str:
    name = "".join(c if c.isascii() and (c.isalnum() or c == "_") else "_" for c in text.strip().lower()).strip("_")
    return name if name[:1].isalpha() else ""


def _is_guess(error: Any) -> bool:
    """Return True for a missing key that is one of several alternatives.

    If the mapping also contains an unknown key, both errors have the same cause.
    """
    return error["type"] == "missing" and (error["loc"][-1] in SHAPE_KEYS or error["loc"][-1] in _JOINED)


def _only_key(model: type[Model], loc: tuple[Any, ...]) -> str:
    """Return the only required key of a mapping, or an empty string if it has several or alternative keys."""
    found = models_at(model, loc)
    needed = [n for m in found for n, info in m.model_fields.items() if info.is_required()]
    return needed[0] if len(found) == len(needed) == 1 and needed[0] not in (*SHAPE_KEYS, *_JOINED) else ""


def _is_shape(model: type[Model], loc: tuple[Any, ...]) -> bool:
    return any(loc[-2:-1] == (key,) for key in SHAPE_KEYS) and any(
        set(m.model_fields) <= set(SHAPE_KEYS) for m in models_at(model, loc[:-1])
    )


def _description(model: type[Model], loc: tuple[Any, ...]) -> str:
    """Return the description of the nearest field at or above ``loc``."""
    for end in range(len(loc), 0, -1):
        for owner in models_at(model, loc[: end - 1]):
            info = owner.model_fields.get(str(loc[end - 1]))
            if info is not None and info.description:
                return f"`{loc[end - 1]}`: {info.description}"
    return ""
