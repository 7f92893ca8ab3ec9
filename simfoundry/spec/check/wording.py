"""Convert pydantic's errors to findings.

To keep `check` fast, this module is imported only for documents with errors.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from simfoundry.spec.check.validate import MAX_FINDINGS
from simfoundry.spec.diagnostics import Diagnostic, nearest
from simfoundry.spec.models.base import PATTERNS, VARY_PATH, WIRE_KEY, Model
from simfoundry.spec.models.shapes import SHAPE_KEYS
from simfoundry.spec.models.types import former_keys, models_at
from simfoundry.spec.yaml.spelling import number
from simfoundry.spec.yaml.text import Document, Path_, read

_CODES = {
    "missing": "SF102",
    "extra_forbidden": "SF101",
    **dict.fromkeys(("too_short", "too_long", "string_too_short", "string_too_long"), "SF105"),
    **dict.fromkeys(("greater_than", "greater_than_equal", "less_than", "less_than_equal", "finite_number"), "SF104"),
    **dict.fromkeys(("literal_error", "string_pattern_mismatch"), "SF106"),
}

_TABLES = read(Path(__file__).with_name("wording.yaml")).data

# Keys allowed in a condition mapping, which contains exactly one of them.
_JOINED = {"all", "any", "not"}

# Alternative keys, exactly one of which must be present in a mapping.
_ALTERNATIVES = _JOINED.union(SHAPE_KEYS)

_NUMBER = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
# Number with a unit.
_MEASURED = re.compile(r"([-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)) ?(mm|cm|m|g|kg|deg|°)\Z")


def worded(model: type[Model], document: Document, error: ValidationError) -> list[Diagnostic]:
    """Return the findings for a document that could not be validated."""
    errors = [e for e in error.errors(include_url=False) if e["input"] is not None or e["type"] == "missing"]
    unknown = {e["loc"][:-1] for e in errors if e["type"] == "extra_forbidden"}
    # If a mapping has an unknown key and lacks one of several alternative keys, both errors have the same cause.
    errors = [
        e for e in errors if e["type"] != "missing" or e["loc"][-1] not in _ALTERNATIVES or e["loc"][:-1] not in unknown
    ]
    findings = _new_members_first([_finding(model, document, e) for e in errors[:MAX_FINDINGS]], document)
    if len(errors) > MAX_FINDINGS:
        more = f"{len(errors) - MAX_FINDINGS} more errors are not shown"
        findings.append(replace(findings[-1], message=more, hint="fix these first"))
    return findings


def missing_value(model: type[Model], document: Document, path: Path_) -> Diagnostic:
    """Return the finding for a key or list item without a value."""
    what = f"`{path[-1]}`" if isinstance(path[-1], str) else "a list item"
    hint = _description(model, path) or "add a value, or remove the key"
    return document.finding("SF103", path, f"{what} has no value", hint)


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
            message = (
                f"the extended document has no {kind} `{member[-1]}`, and the new {kind} is incomplete: {d.message}"
            )
            hint = nearest(str(member[-1]), document.added[member])
            out.append(document.finding("SF201", member, message, hint or d.hint, of_key=True))
    return out


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
        path += tuple(error["ctx"]["at"].split("."))
    return document.finding(code, path, message, hint, of_key=of_key)


def _words(model: type[Model], kind: str, loc: tuple[Any, ...], error: Any) -> tuple[str, str]:
    """Return the message and hint for one pydantic error."""
    given, context = error["input"], error.get("ctx", {})
    description, found = _description(model, loc), _shown(given)
    bare = found.removeprefix("the string ")
    if kind.startswith("sf"):
        return error["msg"], ""
    if kind == "extra_forbidden":
        return _unknown_key(model, loc)
    if kind == "missing" and isinstance(loc[-1], int):
        return f"values are missing: the list has only {len(given)}", description
    if kind == "missing" and loc[-1] in SHAPE_KEYS:
        return "a shape is missing", f"specify one of {', '.join(f'`{k}`' for k in SHAPE_KEYS)}"
    if kind == "missing":
        return f"`{loc[-1]}` is missing", description
    if context.get("pattern") == WIRE_KEY:
        return f"{found} is not a key", PATTERNS[WIRE_KEY].rule
    if context.get("pattern") == VARY_PATH:
        return f"{bare} is not a path", PATTERNS[VARY_PATH].rule
    if "[key]" in error["loc"] or kind == "string_pattern_mismatch":
        rule = "a name consists of lower-case letters, digits and `_`, and starts with a letter"
        name = re.sub("[^a-z0-9_]", "_", str(given).strip().lower()).strip("_")
        return f"{bare} is not a name", rule + (f": `{name}`" if name[:1].isalpha() else "")
    if kind == "literal_error":
        choices = [c.strip().strip("'") for c in context["expected"].replace(" or ", ", ").split(",")]
        return f"{bare} is not valid here", nearest(str(given), choices)
    if kind.endswith(("too_long", "too_short")):
        word, bound = ("most", context["max_length"]) if "long" in kind else ("least", context["min_length"])
        values = ("character" if kind.startswith("string") else "value") + "s" * (bound != 1)
        return f"expected at {word} {bound} {values}, found {len(given)}", description
    if kind == "float_type" and isinstance(given, str) and _NUMBER.fullmatch(given):
        description = "remove the quotes"
    elif kind == "float_type" and (measured := _MEASURED.match(str(given))):
        rule, factor = next(
            (rule, units[measured[2]]) for rule, units in _TABLES["units"].items() if measured[2] in units
        )
        description = f"{rule}, without the unit: `{number(float(measured[1]) * factor)}`"
    elif kind == "string_type" and isinstance(given, int | float):
        description = "put it in double quotes"
    elif kind == "model_type" and (key := _only_key(model, loc)):
        description = f"write `{{{key}: {given}}}`"
    elif kind == "dict_type" and isinstance(given, tuple | list):
        description = f"{description} Write `name: ...` for each, without `-`." if description else ""
    return f"expected {_expected(error)}, found {found}", description


def _unknown_key(model: type[Model], loc: tuple[Any, ...]) -> tuple[str, str]:
    """Return the message and hint for a key that is not in the model."""
    owners, last = models_at(model, loc[:-1]), loc[-1]
    names = {name for owner in owners for name in owner.model_fields}
    if loc[-2:-1] and loc[-2] in SHAPE_KEYS and any(owner.model_fields.keys() <= set(SHAPE_KEYS) for owner in owners):
        names = set(SHAPE_KEYS)
    elif names and names <= _JOINED:
        names = _JOINED
    inner = "compound" in loc[:-1]
    if last == "compound" and names == set(SHAPE_KEYS) and (inner or loc[0] == "links"):
        where = "the outer compound" if inner else "the link's `parts`"
        return "a part cannot be a compound", f"list its parts in {where}"
    if last in SHAPE_KEYS and "shape" in names:
        return f"unknown key `{last}`", f"write `shape: {{{last}: ...}}`"
    former = {old: new for owner in owners for old, new in former_keys(owner).items()}
    if last in former:
        return f"the `{last}` key was renamed to `{former[last]}`", "run `simfoundry migrate` on the file"
    return f"unknown key `{last}`", nearest(str(last), names)


def _expected(error: Any) -> str:
    """Describe the value that pydantic expected, in terms that document authors know."""
    words: str = error["msg"].removeprefix("Input should be ")
    if error["type"].startswith(("greater", "less")):
        return f"a number {words}"
    return next((str(name) for kind, name in _TABLES["expected"].items() if error["type"].startswith(kind)), words)


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


def _only_key(model: type[Model], loc: tuple[Any, ...]) -> str:
    """Return the only required key of a mapping, or an empty string if there are several or if alternatives exist."""
    found = models_at(model, loc)
    needed = [n for m in found for n, info in m.model_fields.items() if info.is_required()]
    return needed[0] if len(found) == len(needed) == 1 and needed[0] not in _ALTERNATIVES else ""


def _description(model: type[Model], loc: tuple[Any, ...]) -> str:
    """Return the description of the nearest field at or above ``loc``."""
    for end in range(len(loc), 0, -1):
        for owner in models_at(model, loc[: end - 1]):
            info = owner.model_fields.get(str(loc[end - 1]))
            if info is not None and info.description:
                return f"`{loc[end - 1]}`: {info.description}"
    return ""
