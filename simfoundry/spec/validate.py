"""Data to typed model, and pydantic's findings to ours: with a place, what was expected and what to do."""

from __future__ import annotations

import types
import typing
from collections.abc import Iterator
from typing import Any, TypeVar

from pydantic import BaseModel, Tag, ValidationError

from simfoundry.spec.base import SHAPE_KEYS, Model
from simfoundry.spec.diagnostics import Diagnostic, Severity, nearest
from simfoundry.spec.text import Document

M = TypeVar("M", bound=Model)

_CODES = {
    "missing": "SF102",
    "extra_forbidden": "SF101",
    "too_short": "SF105",
    "too_long": "SF105",
    "string_too_long": "SF105",
    "greater_than": "SF104",
    "greater_than_equal": "SF104",
    "less_than": "SF104",
    "less_than_equal": "SF104",
    "finite_number": "SF104",
    "literal_error": "SF106",
    "string_pattern_mismatch": "SF106",
}


def validate(model: type[M], document: Document) -> tuple[M | None, list[Diagnostic]]:
    """The typed document, or every finding of its text."""
    findings = list(document.duplicates)
    try:
        spec = model.model_validate(document.data)
    except ValidationError as error:
        findings += [_finding(model, document, e) for e in error.errors(include_url=False)]
        return None, findings
    return (None if findings else spec), findings


def _finding(model: type[Model], document: Document, error: Any) -> Diagnostic:
    kind: str = error["type"]
    loc = tuple(part for part in error["loc"] if part != "[key]")
    of_key = "[key]" in error["loc"] or kind == "extra_forbidden"
    message, hint = _words(model, kind, loc, error)
    code = kind.upper() if kind.startswith("sf") else _CODES.get(kind, "SF103")
    if kind == "missing" and loc and isinstance(loc[-1], int):
        code = "SF105"
    elif kind == "missing":
        of_key = True
    line, column = document.place(loc, of_key=of_key)
    return Diagnostic(code, Severity.ERROR, message, document.file, line, column, _dotted(loc), hint)


def _words(model: type[Model], kind: str, loc: tuple[Any, ...], error: Any) -> tuple[str, str]:
    """Message and hint of one pydantic error."""
    last = loc[-1] if loc else ""
    description = _description(model, loc)
    if kind.startswith("sf"):
        return error["msg"], ""
    if kind == "extra_forbidden":
        names = {n for m in _models(model, loc[:-1]) for n in m.model_fields}
        if _is_shape(model, loc):
            names = set(SHAPE_KEYS)
        return f"unknown key `{last}`", nearest(str(last), names)
    if kind == "missing" and isinstance(last, int):
        return f"a value is missing: {len(error['input'])} given", description
    if kind == "missing":
        if last in SHAPE_KEYS:
            return "a shape is missing", f"give one of {', '.join(f'`{k}`' for k in SHAPE_KEYS)}"
        return f"`{last}` is missing", description
    found = _shown(error["input"])
    if "[key]" in error["loc"] or kind == "string_pattern_mismatch":
        suggestion = _as_name(str(error["input"] if kind != "missing" else last))
        rule = "a name is lower-case letters, digits and `_`, and starts with a letter"
        return f"{found} is not a name", rule + (f": `{suggestion}`" if suggestion else "")
    if kind == "literal_error":
        choices = [c.strip().strip("'") for c in error["ctx"]["expected"].replace(" or ", ", ").split(",")]
        return f"{found} is not valid here", nearest(str(error["input"]), choices)
    wording = error["msg"].replace("Input should be", "expected").replace("a valid tuple", "a list")
    wording = wording.replace("a valid dictionary", "a mapping").replace("Tuple", "the list").replace("a valid ", "a ")
    if "instance of" in wording:
        wording = "expected a mapping"
    return f"{wording}, found {found}", description


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
            return f"the text `{value[:40]}`"
    return f"`{value}`"


def _as_name(text: str) -> str:
    name = "".join(c if c.isascii() and (c.isalnum() or c == "_") else "_" for c in text.strip().lower()).strip("_")
    return name if name[:1].isalpha() else ""


def _dotted(loc: tuple[Any, ...]) -> str:
    return ".".join(str(p) for p in loc)


def _is_shape(model: type[Model], loc: tuple[Any, ...]) -> bool:
    return any(loc[-2:-1] == (key,) for key in SHAPE_KEYS) and any(
        set(m.model_fields) <= set(SHAPE_KEYS) for m in _models(model, loc[:-1])
    )


def _description(model: type[Model], loc: tuple[Any, ...]) -> str:
    """What the documentation says of the nearest field at or above ``loc``."""
    for end in range(len(loc), 0, -1):
        for owner in _models(model, loc[: end - 1]):
            info = owner.model_fields.get(str(loc[end - 1]))
            if info is not None and info.description:
                return f"`{loc[end - 1]}`: {info.description}"
    return ""


def _models(root: Any, loc: tuple[Any, ...]) -> list[type[BaseModel]]:
    """The model classes that may stand at ``loc`` below the type ``root``."""
    current = list(_flat(root))
    for part in loc:
        following: list[Any] = []
        for tag, kind in current:
            if tag is not None and tag == part:
                following += [(None, kind)]
            following += [t for inner in _inside(kind, part) for t in _flat(inner)]
        current = following
    return [kind for _, kind in current if isinstance(kind, type) and issubclass(kind, BaseModel)]


def _inside(kind: Any, part: Any) -> Iterator[Any]:
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        if part in kind.model_fields:
            info = kind.model_fields[part]
            yield typing.Annotated[info.annotation, *info.metadata] if info.metadata else info.annotation
    elif typing.get_origin(kind) is dict:
        yield typing.get_args(kind)[1]
    elif typing.get_origin(kind) is tuple and isinstance(part, int):
        yield typing.get_args(kind)[0]


def _flat(kind: Any, tag: str | None = None) -> Iterator[tuple[str | None, Any]]:
    """The plain types of a type, each with its union tag."""
    origin = typing.get_origin(kind)
    if origin is typing.Annotated:
        inner, *metadata = typing.get_args(kind)
        tags = [m.tag for m in metadata if isinstance(m, Tag)]
        yield from _flat(inner, tags[0] if tags else tag)
    elif origin in (typing.Union, types.UnionType):
        for member in typing.get_args(kind):
            yield from _flat(member, tag)
    else:
        yield tag, kind
