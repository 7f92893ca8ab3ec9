"""Offer values: names, predicates and their arguments, choices, files, colors, numbers."""

from __future__ import annotations

import typing
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from importlib import import_module
from importlib.resources import files
from typing import Any

from lsprotocol import types

from simfoundry.language_server.completion.context import CompletionContext
from simfoundry.language_server.completion.file_offers import file_offers, suffixes_of
from simfoundry.language_server.completion.insertion import Offer
from simfoundry.language_server.completion.key_offers import field_body
from simfoundry.language_server.completion.known_names import KnownName
from simfoundry.spec.change.diff.changes import BESIDE
from simfoundry.spec.editor import snippets
from simfoundry.spec.editor.snippets import Body, one_line
from simfoundry.spec.models.base import DocumentSpec, Model
from simfoundry.spec.models.kinds import KINDS
from simfoundry.spec.models.predicate import PREDICATES, canonical
from simfoundry.spec.models.scene import DEFAULT_VARIANT
from simfoundry.spec.models.types import EXPRESSIONS, REFERENCES, file_patterns, kinds_at
from simfoundry.spec.yaml.spelling import Where, string
from simfoundry.spec.yaml.text import Path_, parse

_KIND = types.CompletionItemKind

# The kind of completion item for a name of each section.
_OF_SECTION = {
    "objects": _KIND.Variable,
    "materials": _KIND.Color,
    "robots": _KIND.Module,
    "cameras": _KIND.Interface,
    "frames": _KIND.Reference,
    "templates": _KIND.Class,
    "links": _KIND.Struct,
    "joints": _KIND.Method,
    "parts": _KIND.Struct,
    "sites": _KIND.Event,
    "parameters": _KIND.Constant,
}

# Keys for which a link of an object can be named, with the sections that a name behind a dot can come from.
_PARTS = {
    "on": ("links", "parts"),
    "inside": ("links", "parts"),
    "frame": ("links",),
    "mount": ("links",),
    "look_at": ("links",),
    "no_contact": ("links",),
}
# Sections of the names behind a dot, by the kind of argument of a predicate.
_PARTS_OF_ARGUMENTS = {"thing": ("links", "joints"), "body": ("links", "joints"), "joint": ("joints",)}

# Largest number of names for which the names of their parts are offered as well before a dot is typed.
_MAX_OWNERS = 100


def value_offers(context: CompletionContext) -> Iterator[Offer]:
    """Yield what can be the value at the cursor."""
    cursor = context.cursor
    path = cursor.path
    key = next((part for part in reversed(path) if isinstance(part, str)), "")
    if not path:
        return
    if path == ("simfoundry",):
        yield from (Offer(kind, _KIND.EnumMember, detail=kind.partition("/")[0]) for kind in KINDS)
        return
    kinds = kinds_at(context.model, path)
    if "$" in cursor.text or (float in kinds and cursor.text and not cursor.word.text):
        yield from _parameters(context)
        return
    is_item = isinstance(path[-1], int)
    if cursor.call is not None:
        yield from argument_offers(context)
    elif key in EXPRESSIONS and str in kinds:
        yield from predicate_offers(context)
    elif any(_matches(pattern, path) for pattern in _file_patterns(context.model)):
        for offer in file_offers(context.path, suffixes_of(context.kind, path), cursor.typed):
            yield _spelled(context, offer)
    elif key in BESIDE:
        yield from _variants(context, path)
    elif key == "model":
        for robot in snippets.robots():
            yield Offer(robot["label"], _KIND.Module, text=robot["description"])
    elif key in REFERENCES and str in kinds and not (key == "joints" and not is_item):
        for known in _references(context, key):
            yield _spelled(context, _name_offer(known))
    elif key == "engines":
        yield from (Offer(name, _KIND.EnumMember) for name in import_module("simfoundry.worlds").world_names())
    yield from _choices(kinds)
    if float in kinds or int in kinds:
        yield from _parameters(context)
    yield from _initial(context, path, kinds)
    if context.is_overlay and not is_item and cursor.call is None and len(path) > 1:
        yield Offer("null", _KIND.Keyword, detail="removes the inherited value", group=6)


@cache
def _file_patterns(model: type[DocumentSpec]) -> tuple[tuple[str, ...], ...]:
    return tuple(file_patterns(model))


def _matches(pattern: tuple[str, ...], path: Path_) -> bool:
    return len(pattern) == len(path) and all(a in ("*", b) for a, b in zip(pattern, path, strict=True))


def _spelled(context: CompletionContext, offer: Offer) -> Offer:
    """Return an offer of a text, with quotes if YAML readers need them and the token has none."""
    where: Where = "item" if context.cursor.in_flow else "block"
    text = offer.label if context.cursor.style == "quoted" else string(offer.label, where)
    if text == offer.label and "$" not in text:
        return offer
    return replace(offer, insert=text, has_places=False)


# -- choices ----------------------------------------------------------------------------------------------------------


def _choices(kinds: list[Any]) -> Iterator[Offer]:
    """Yield the options of an enumeration."""
    values = [value for kind in kinds if typing.get_origin(kind) is typing.Literal for value in typing.get_args(kind)]
    values += [False, True] if bool in kinds else []
    listed = [snippets.literal(value) for value in values]
    try:
        said = snippets.meanings(listed) if listed else []
    except StopIteration:
        said = [""] * len(listed)
    for value, text in zip(listed, said, strict=True):
        yield Offer(value, _KIND.EnumMember, text=text)


def _initial(context: CompletionContext, path: Path_, kinds: list[Any]) -> Iterator[Offer]:
    """Yield the initial value of a key, and the common values of colors and materials."""
    key = path[-1]
    if not isinstance(key, str) or context.cursor.call is not None:
        return
    models = [k for k in kinds_at(context.model, path[:-1]) if isinstance(k, type) and issubclass(k, Model)]
    owner = next((model for model in models if key in model.model_fields), None)
    if key == "color" and any(typing.get_origin(kind) is tuple for kind in kinds):
        yield from _colors()
    elif path[0] == "materials" and len(path) == 3 and key in ("density", "friction", "restitution"):
        yield from _material_values(key)
    if owner is None or str in kinds or bool in kinds or any(typing.get_origin(k) is typing.Literal for k in kinds):
        return
    body: Body = field_body(context, owner, key)
    text = one_line(body)
    label = snippets.without_placeholders(text)
    if label not in ("$0", "{$0}", "[$0]", ""):
        yield Offer(label, _KIND.Value, text, "initial value", group=5, whole=True)


@cache
def _typical(table: str) -> dict[str, Any]:
    """Return a table of the values that object variants have: ``colors`` or ``materials``."""
    text = (files("simfoundry.cousins.objects") / "priors.yaml").read_text(encoding="utf-8")
    found: dict[str, Any] = parse(text).data[table]
    return found


def _colors() -> Iterator[Offer]:
    for name, color in _typical("colors").items():
        digits = "".join(f"{round(value * 255):02x}" for value in color)
        text = f"[{', '.join(map(snippets.literal, color))}]"
        yield Offer(f'"#{digits}"', _KIND.Color, detail=name, text=f"#{digits}", typed=name, whole=True)
        yield Offer(text, _KIND.Color, detail=name, group=2, whole=True)


def _material_values(key: str) -> Iterator[Offer]:
    for name, material in _typical("materials").items():
        value = material.get(key)
        if isinstance(value, tuple):
            value = round(sum(value) / len(value), -1)
        if value is not None:
            yield Offer(snippets.literal(value), _KIND.Value, detail=f"typical of {name}", group=3)


def _parameters(context: CompletionContext) -> Iterator[Offer]:
    if context.kind != "scene":
        return
    own = context.cursor.path[1:2] if context.cursor.path[:1] == ("parameters",) else ()
    for known in context.names.names("parameters", apart=[str(part) for part in own]):
        yield Offer(f"${known.name}", _KIND.Constant, detail=known.describe, group=2)


# -- names ------------------------------------------------------------------------------------------------------------


def _name_offer(known: KnownName) -> Offer:
    kind = _OF_SECTION.get(known.section, _KIND.Variable)
    return Offer(known.name, kind, detail=known.describe, group=1 + ("." in known.name))


def _variants(context: CompletionContext, path: Path_) -> Iterator[Offer]:
    variants = context.member(*path[:-1], BESIDE[str(path[-1])])
    for name in (DEFAULT_VARIANT, *(variants if isinstance(variants, dict) else ())):
        yield Offer(name, _KIND.EnumMember)


def _references(context: CompletionContext, key: str) -> Iterator[KnownName]:
    """Yield the names that the value of a key can be."""
    names, path = context.names, context.cursor.path
    if key == "repeat":
        yield from (KnownName(name, "objects", "repeated object") for name in names.repeated if name not in path[1:2])
        return
    sections = REFERENCES[key]
    if context.kind == "asset":
        sections = tuple(section for section in sections if section != "objects")
    elif key == "no_contact":
        sections = ("objects",)
    own = (path[0], path[1]) if len(path) > 1 else ()  # nothing can be on itself, and no joint can follow itself
    known = [each for each in names.names(*sections) if (each.section, each.name) != own]
    yield from _with_parts(context, known, _PARTS.get(key, ()))


def _with_parts(context: CompletionContext, known: list[KnownName], sections: tuple[str, ...]) -> Iterator[KnownName]:
    """Yield names and, if a dot is typed or there are few names, those of their parts."""
    owner = context.cursor.owner
    if owner:
        for part in context.names.parts(owner, *sections):
            yield KnownName(f"{owner}.{part.name}", part.section, part.note)
        return
    yield from known
    for each in known if len(known) <= _MAX_OWNERS and sections else ():
        if each.section in ("objects", "robots"):
            for part in context.names.parts(each.name, *sections):
                yield KnownName(f"{each.name}.{part.name}", part.section, part.note)


# -- predicates -------------------------------------------------------------------------------------------------------


def predicate_offers(context: CompletionContext) -> Iterator[Offer]:
    """Yield the predicates, with placeholders for their arguments."""
    cursor = context.cursor
    has_arguments = "(" in cursor.text
    quoted = cursor.in_flow and cursor.style != "quoted" and not has_arguments
    for known in snippets.predicates():
        name = known["label"].partition("(")[0]
        insert = name if has_arguments else f'"{known["body"]}"' if quoted else known["body"]
        yield Offer(known["label"], _KIND.Function, insert, "", known["description"], typed=name)


def argument_kinds(name: str) -> tuple[str, ...]:
    """Return the kinds of the arguments of a predicate in the order in which they are written, also for an alias."""
    name, order = canonical(name, ("0", "1"))
    if name not in PREDICATES:
        return ()
    parameters = PREDICATES.load(name).parameters
    return parameters[::-1] if order == ("1", "0") and len(parameters) == 2 else parameters


def argument_offers(context: CompletionContext) -> Iterator[Offer]:
    """Yield the names that can be the argument of a predicate at the cursor."""
    call = context.cursor.call
    assert call is not None
    kinds = argument_kinds(call.name)
    kind = kinds[call.index] if call.index < len(kinds) else "body" if not kinds else ""
    if kind == "number":
        yield Offer("0", _KIND.Value)
        return
    if not kind:
        return
    names = context.names
    apart = [text for k, text in enumerate(call.arguments) if k != call.index and "." not in text]
    if kind == "joint":
        known = [each for each in names.names("objects") if any(names.moving_joints(each.name))]
    else:
        sections = {"thing": ("objects",), "body": ("objects", "robots"), "robot": ("robots",)}[kind]
        known = [*names.names(*sections, apart=apart)]
    for each in _with_parts(context, known, _PARTS_OF_ARGUMENTS.get(kind, ())):
        yield _name_offer(each)
