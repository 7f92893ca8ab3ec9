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
from simfoundry.spec.diagnostics import Diagnostic, Fix, nearest, similar_fixes
from simfoundry.spec.models.base import DIGEST, PATTERNS, TOKEN_VARIABLE, URL, VARY_PATH, WIRE_KEY, Model
from simfoundry.spec.models.shapes import SHAPE_KEYS
from simfoundry.spec.models.types import former_keys, models_at
from simfoundry.spec.yaml.spelling import number
from simfoundry.spec.yaml.text import Document, Mark, Path_, read

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
# Name, number, file or predicate.
_WHOLE = re.compile(r"[\w./-]+|[A-Za-z]\w*\([\w., ]*\)")
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
            names = document.added[member]
            hint, mark = nearest(str(member[-1]), names), Mark(fixes=similar_fixes(str(member[-1]), names))
            out.append(document.finding("SF201", member, message, hint or d.hint, of_key=True, mark=mark))
    return out


def _finding(model: type[Model], document: Document, error: Any) -> Diagnostic:
    kind: str = error["type"]
    loc = tuple(part for part in error["loc"] if part != "[key]")
    of_key = "[key]" in error["loc"] or kind in ("extra_forbidden", "missing")
    message, hint, mark = _words(model, kind, loc, error, _keys_at(document.data, document.known(loc[:-1])))
    code = kind.upper() if kind.startswith("sf") else _CODES.get(kind, "SF103")
    path = document.known(loc)
    if kind == "missing" and isinstance(loc[-1], int):  # one finding for the list, not one per missing item
        code, of_key = "SF105", False
    elif kind == "missing":
        path += loc[-1:]
    elif kind.startswith("sf") and "at" in error.get("ctx", {}):
        path += tuple(error["ctx"]["at"].split("."))
    return document.finding(code, path, message, hint, of_key=of_key, mark=mark)


def _keys_at(data: Any, path: Path_) -> set[str]:
    """Return the keys of the mapping at an existing path."""
    for part in path:
        data = data[part]
    return {*data} if isinstance(data, dict) else set()


def _words(
    model: type[Model], kind: str, loc: tuple[Any, ...], error: Any, siblings: set[str]
) -> tuple[str, str, Mark]:
    """Return the message and hint for one pydantic error, and the corrections of the key or value.

    ``siblings`` are the keys of the mapping that contains the value.
    """
    given, context = error["input"], error.get("ctx", {})
    description, found = _description(model, loc), _shown(given)
    bare = found.removeprefix("the string ")
    if kind.startswith("sf"):
        return error["msg"], "", Mark()
    if kind == "extra_forbidden":
        return _unknown_key(model, loc, siblings)
    if kind == "missing" and isinstance(loc[-1], int):
        return f"values are missing: the list has only {len(given)}", description, Mark()
    if kind == "missing" and loc[-1] in SHAPE_KEYS:
        return "a shape is missing", f"specify one of {', '.join(f'`{k}`' for k in SHAPE_KEYS)}", Mark()
    if kind == "missing":
        return f"`{loc[-1]}` is missing", description, Mark()
    if context.get("pattern") == WIRE_KEY:
        return f"{found} is not a key", PATTERNS[WIRE_KEY].rule, Mark()
    if context.get("pattern") == VARY_PATH:
        return f"{bare} is not a path", PATTERNS[VARY_PATH].rule, Mark()
    if context.get("pattern") in (DIGEST, URL, TOKEN_VARIABLE):
        return f"{bare} is not valid here", PATTERNS[context["pattern"]].rule, Mark()
    if "[key]" in error["loc"] or kind == "string_pattern_mismatch":
        rule = "a name consists of lower-case letters, digits and `_`, and starts with a letter"
        name = re.sub("[^a-z0-9_]", "_", str(given).strip().lower()).strip("_")
        if not name[:1].isalpha():
            return f"{bare} is not a name", rule, Mark()
        return f"{bare} is not a name", f"{rule}: `{name}`", Mark(fixes=(Fix(name),))
    if kind == "literal_error":
        choices = [c.strip().strip("'") for c in context["expected"].replace(" or ", ", ").split(",")]
        mark = Mark(given, 0, similar_fixes(given, choices)) if isinstance(given, str) else Mark()
        return f"{bare} is not valid here", nearest(str(given), choices), mark
    if kind.endswith(("too_long", "too_short")):
        word, bound = ("most", context["max_length"]) if "long" in kind else ("least", context["min_length"])
        values = ("character" if kind.startswith("string") else "value") + "s" * (bound != 1)
        return f"expected at {word} {bound} {values}, found {len(given)}", description, Mark()
    hint, fixes = _other_type(model, loc, error, description)
    return f"expected {_expected(error)}, found {found}", hint, Mark(fixes=fixes)


# Truth values of YAML 1.1, which YAML 1.2 reads as strings.
_TRUTH = {**dict.fromkeys(("yes", "on"), "true"), **dict.fromkeys(("no", "off"), "false")}


def _other_type(model: type[Model], loc: tuple[Any, ...], error: Any, description: str) -> tuple[str, tuple[Fix, ...]]:
    """Return the hint for a value of a wrong type, and the values that can be written instead."""
    kind, given = error["type"], error["input"]
    if kind in ("float_type", "int_type") and isinstance(given, str) and _NUMBER.fullmatch(given):
        return "remove the quotes", (Fix(given, certain=True),)
    if kind == "float_type" and (measured := _MEASURED.match(str(given))):
        rule, factor = next(
            (rule, units[measured[2]]) for rule, units in _TABLES["units"].items() if measured[2] in units
        )
        value = number(float(measured[1]) * factor)
        return f"{rule}, without the unit: `{value}`", (Fix(value, certain=_has_unit(description, rule)),)
    if kind == "bool_type" and isinstance(given, str) and given.lower() in _TRUTH:
        return description, (Fix(_TRUTH[given.lower()], certain=True),)
    if kind == "string_type" and isinstance(given, int | float):
        return "put it in double quotes", (Fix(f'"{given}"'),) if not isinstance(given, bool) else ()
    if kind == "model_type" and (key := _only_key(model, loc)):
        is_whole = _WHOLE.fullmatch(str(given)) is not None  # and not the rest of a line with another slip
        return f"write `{{{key}: {given}}}`", (Fix(f"{{{key}: {given}}}", certain=True),) if is_whole else ()
    if kind == "dict_type" and isinstance(given, tuple | list) and description:
        return f"{description} Write `name: ...` for each, without `-`.", ()
    return description, ()


def _has_unit(description: str, rule: str) -> bool:
    """Return True if the description of a field contains the unit that a rule states, such as `lengths are in m`."""
    unit = rule.rpartition(" ")[2]
    return f"[{'deg' if unit == 'degrees' else unit}" in description


def _unknown_key(model: type[Model], loc: tuple[Any, ...], siblings: set[str]) -> tuple[str, str, Mark]:
    """Return the message and hint for a key that is not in the model, and the keys that may be meant.

    Keys that are present already cannot be written once more.
    """
    owners, last = models_at(model, loc[:-1]), loc[-1]
    names = {name for owner in owners for name in owner.model_fields}
    if loc[-2:-1] and loc[-2] in SHAPE_KEYS and any(owner.model_fields.keys() <= set(SHAPE_KEYS) for owner in owners):
        names = set(SHAPE_KEYS)
    elif names and names <= _JOINED:
        names = _JOINED
    inner = "compound" in loc[:-1]
    if last == "compound" and names == set(SHAPE_KEYS) and (inner or loc[0] == "links"):
        where = "the outer compound" if inner else "the link's `parts`"
        return "a part cannot be a compound", f"list its parts in {where}", Mark()
    if last in SHAPE_KEYS and "shape" in names:
        return f"unknown key `{last}`", f"write `shape: {{{last}: ...}}`", Mark()
    former = {old: new for owner in owners for old, new in former_keys(owner).items()}
    if last in former and former[last] not in siblings:
        message, fixes = f"the `{last}` key was renamed to `{former[last]}`", (Fix(former[last], certain=True),)
        return message, "run `simfoundry migrate` on the file", Mark(fixes=fixes)
    meant = similar_fixes(str(last), names)
    if meant and meant[0].text in siblings:
        hint = f"did you mean `{meant[0].text}`, which is there already?"
        return f"unknown key `{last}`", hint, Mark()
    return f"unknown key `{last}`", nearest(str(last), names), Mark(fixes=meant)


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
