"""Offer the keys of a mapping: fields of its model, or the names of its members."""

from __future__ import annotations

import re
import typing
from collections.abc import Iterator, Sequence
from typing import Any

from lsprotocol import types
from pydantic import BaseModel

from simfoundry.language_server.completion.context import CompletionContext
from simfoundry.language_server.completion.insertion import Offer, after_colon, lowest, placeholder, shifted
from simfoundry.spec.check.pages import titles
from simfoundry.spec.editor import snippets
from simfoundry.spec.editor.snippets import Body, one_line
from simfoundry.spec.models.base import Model
from simfoundry.spec.models.types import EXPRESSIONS, NAMES, REFERENCES, RIVALS, field_order, flat, kinds_at
from simfoundry.spec.yaml.spelling import key_text
from simfoundry.spec.yaml.text import Path_

_KIND = types.CompletionItemKind

# Sections whose names an asset or another scene defines, although a key of an object or an include contains them.
_OF_OTHERS = ("joints", "parameters")


def key_offers(context: CompletionContext, container: Path_, present: Sequence[str]) -> Iterator[Offer]:
    """Yield what can be a key of the mapping at a path."""
    kinds = kinds_at(context.model, container)
    models = [kind for kind in kinds if isinstance(kind, type) and issubclass(kind, Model)]
    excluded = {*present, *(rival for key in present for rival in RIVALS.get(key, ()))}
    seen = set[str]()
    for model in models:
        for name in field_order(model):
            if name not in excluded and name not in seen:
                seen.add(name)
                yield _field_offer(context, model, name)
    members = [typing.get_args(kind)[1] for kind in kinds if typing.get_origin(kind) is dict]
    if members:
        yield from _member_offers(context, container, members[0], excluded)


def _field_offer(context: CompletionContext, model: type[Model], name: str) -> Offer:
    info = model.model_fields[name]
    required = info.is_required() and not context.is_overlay
    default = _plain_default(info.default)
    detail = "required" if required else f"default: {snippets.literal(default)}" if default is not None else ""
    return Offer(
        label=name,
        kind=_KIND.Property,
        insert=_member(context, name, field_body(context, model, name)),
        detail=detail,
        text=meaning(model, name),
        group=0 if required else 1,
        whole=True,
    )


def meaning(model: type[Model], name: str) -> str:
    """Return the description of a field, or of its value if it has none."""
    said = model.model_fields[name].description or snippets.lookup("descriptions", f"{model.__name__}.{name}")
    if said is None:
        kinds = kinds_at(model, (name,))
        said = next((kind.__doc__ for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)), "")
    return str(said or "")


def _plain_default(default: Any) -> Any:
    """Return the default of a field if it is a number, a word, or a list of numbers."""
    if isinstance(default, tuple) and default:
        return list(default)
    return default if isinstance(default, int | float | str) else None


def field_body(context: CompletionContext, model: type[Model], name: str) -> Body:
    """Return the initial value of a field, with placeholders."""
    info = model.model_fields[name]
    kinds = kinds_at(model, (name,))
    choices = [
        str(value) for kind in kinds if typing.get_origin(kind) is typing.Literal for value in typing.get_args(kind)
    ]
    if choices and all(typing.get_origin(kind) in (typing.Literal, type(None)) or kind is type(None) for kind in kinds):
        first = str(info.default)
        return placeholder(1, sorted(choices, key=lambda choice: choice != first))
    if bool in kinds:
        return placeholder(1, ["false", "true"] if info.default is True else ["true", "false"])
    body: Body | None = snippets.initial_value(model.__name__, name, _plain_default(info.default))
    if body is not None and name in REFERENCES and (found := re.fullmatch(r"\$\{1:\w+\}", one_line(body))):
        names = [known.name for known in context.names.names(*REFERENCES[name], apart=context.own_names)]
        return f"${{1:{names[0]}}}" if names else found.group()
    if body is not None:
        return body
    if name in EXPRESSIONS:
        first = snippets.predicates()[0]["body"]
        return f'"{first}"' if context.cursor.in_flow else first
    if name == "model":
        return f"${{1:{snippets.robots()[0]['label']}}}"
    return _opening(kinds)


def _opening(kinds: list[Any]) -> Body:
    """Return the initial value for a type without one of its own."""
    if any(typing.get_origin(kind) is dict or (isinstance(kind, type) and issubclass(kind, Model)) for kind in kinds):
        return "{$0}"
    return "[$0]" if any(typing.get_origin(kind) is tuple for kind in kinds) else "$0"


def _member(context: CompletionContext, key: str, body: Body) -> str:
    """Return a key with its value, or only the key if a colon follows already."""
    if context.has_colon:
        return key
    return f"{key}:{after_colon(body, context.insertion.indent, context.cursor.in_flow)}{context.separator}"


# -- members with names -----------------------------------------------------------------------------------------------


def _member_offers(context: CompletionContext, container: Path_, kind: Any, present: set[str]) -> Iterator[Offer]:
    if container[0] == "allow":
        yield from _allowances(context, container, present)
        return
    if container[0] in ("native", "conflicts") or "native" in container:
        return
    if context.kind == "scene" and len(container) == 3 and (container[0], container[2]) == ("robots", "joints"):
        for name, position in context.names.robot(context.names.section("robots").get(str(container[1])))[1].items():
            if name not in present:
                insert = _member(context, name, f"${{1:{snippets.literal(round(position, 4))}}}")
                yield Offer(name, _KIND.Field, insert, "joint", whole=True)
        return
    section = names_section(context.kind, container)
    body = member_body(kind)
    if section is not None and _is_reference(context.kind, section):
        for known in context.keys_for(section, container):
            if known.name not in present:
                yield Offer(known.name, _KIND.Field, _member(context, known.name, body), known.describe, whole=True)
        return
    if len(container) == 1:
        for known in context.names.names(str(container[0])):  # members of bases, which the document may override
            if known.name not in present and context.is_overlay:
                detail = f"{known.describe()} (inherited)"
                inherited = "${1:null}" if section == "parameters" else "{$0}"
                insert = _member(context, known.name, inherited)
                yield Offer(known.name, _KIND.Field, insert, detail, group=2, whole=True)
    yield from _new_members(context, container, kind, present)


def _new_members(context: CompletionContext, container: Path_, kind: Any, present: set[str]) -> Iterator[Offer]:
    """Yield snippets of new members."""
    model = next((k for _, k in flat(kind) if isinstance(k, type) and issubclass(k, Model)), None)
    name = _example_name(context, container, present)
    listed: dict[str, Body] = snippets.lookup("starters", model.__name__) or {} if model is not None else {}
    if not listed:
        word = snippets.title(model.__name__) if model is not None else str(container[-1]).removesuffix("s")
        listed = {f"new {word}": member_body(kind)}
    for label, body in listed.items():
        moved = shifted(body) if lowest(body) == 1 else body
        text = f"${{1:{name}}}:" + after_colon(moved, context.insertion.indent, context.cursor.in_flow)
        said = (model.__doc__ or "").partition("\n")[0] if model is not None else ""
        yield Offer(
            label,
            _KIND.Snippet,
            text + context.separator,
            snippets.without_placeholders(one_line(body))[:80],
            said,
            whole=True,
        )


def _example_name(context: CompletionContext, container: Path_, present: set[str]) -> str:
    """Return a name for a new member that is not in use."""
    owner = kinds_at(context.model, container[:-1])
    models = [kind.__name__ for kind in owner if isinstance(kind, type) and issubclass(kind, Model)]
    example: Body | None = snippets.lookup("first", *(f"{each}.{container[-1]}" for each in models), str(container[-1]))
    found = re.match(r"\{?\$\{1:(\w+)\}", str(next(iter(example)) if isinstance(example, dict) else example))
    stem = found[1] if found is not None else "name"
    return next(name for name in (stem, *(f"{stem}_{k}" for k in range(2, len(present) + 3))) if name not in present)


def member_body(kind: Any) -> Body:
    """Return the initial value of a member of a mapping with names."""
    kinds = [each for _, each in flat(kind)]
    models = [each.__name__ for each in kinds if isinstance(each, type) and issubclass(each, Model)]
    body: Body | None = snippets.lookup("members", *models)
    if body is not None:
        return body
    if float in kinds:
        return "${1:0}"
    for each in kinds:
        if typing.get_origin(each) is typing.Literal:
            return placeholder(1, map(str, typing.get_args(each)))
        if typing.get_origin(each) is tuple:
            inner = member_body(typing.get_args(each)[0])
            return f"[{one_line(inner)}]" if inner != "$0" else "[$0]"
    return _opening(kinds)


def names_section(kind: str, container: Path_) -> str | None:
    """Return the section of the names that are the keys of a mapping; see ``names`` in ``keys.yaml``."""
    for pattern, section in NAMES.get(kind, {}).items():
        parts = pattern.split(".")
        if len(parts) == len(container) and all(
            part in ("*", "@", name) for part, name in zip(parts, container, strict=True)
        ):
            return section
    return None


def _is_reference(kind: str, section: str) -> bool:
    """Return True if the keys of a mapping name something that is defined elsewhere."""
    of, dot, own = section.partition(".")
    return own in _OF_OTHERS if dot else kind not in ("scene", "asset") and of not in ("subtasks", "frames")


def _allowances(context: CompletionContext, container: Path_, present: set[str]) -> Iterator[Offer]:
    """Yield the codes of warnings, those of the document first, or the names of what they are about."""
    found = context.analysis.findings if context.analysis is not None else ()
    own = list(dict.fromkeys(finding.code for finding in found if finding.code.startswith("SF4")))
    if len(container) == 1:
        codes = [code for code in titles() if code.startswith("SF4")]
        for code in (*own, *(code for code in codes if code not in own)):
            if code not in present:
                insert = _member(context, code, "${1:why}")
                yield Offer(
                    code, _KIND.EnumMember, insert, titles().get(code, ""), group=int(code not in own), whole=True
                )
        return
    paths = [finding.path for finding in found if finding.code == container[1]]
    for section in ("objects", "materials", "robots", "cameras", "lights", "links", "joints", "parameters"):
        for known in context.names.names(section, apart=present):
            group = int(not any(known.name in path.split(".") for path in paths))
            insert = _member(context, key_text(known.name), "${1:why}")
            yield Offer(known.name, _KIND.Field, insert, known.describe, group=group, whole=True)
