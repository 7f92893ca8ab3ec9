"""Completion and signature help at the cursor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from lsprotocol import types

from simfoundry.errors import SimfoundryError
from simfoundry.language_server.analysis import Analysis
from simfoundry.language_server.completion.context import CompletionContext, kind_of_file
from simfoundry.language_server.completion.insertion import Offer
from simfoundry.language_server.completion.key_offers import key_offers
from simfoundry.language_server.completion.value_offers import argument_kinds, value_offers
from simfoundry.language_server.cursor.cursor import Cursor, cursor_at
from simfoundry.language_server.cursor.scan import Slot
from simfoundry.language_server.positions import Lines
from simfoundry.spec.editor import snippets
from simfoundry.spec.models.kinds import KINDS
from simfoundry.spec.models.predicate import PREDICATES, canonical
from simfoundry.spec.models.types import kinds_at

# Characters after which editors ask by themselves, in addition to letters.
TRIGGERS = (" ", ":", ".", "/", "$", "(", ",", '"', "-", "[", "{")
SIGNATURE_TRIGGERS = ("(", ",")

# Largest number of offers in one answer. If there are more, the editor asks again when more is typed.
MAX_OFFERS = 100


def has_snippets(capabilities: types.ClientCapabilities) -> bool:
    """Return True if an editor supports texts with placeholders."""
    document = capabilities.text_document
    completion = document.completion if document is not None else None
    item = completion.completion_item if completion is not None else None
    return bool(item is not None and item.snippet_support)


def complete(
    path: Path, lines: Lines, position: types.Position, analysis: Analysis | None, snippets_supported: bool = True
) -> types.CompletionList:
    """Return what can be inserted at a position.

    Args:
        path: The file of the document.
        lines: Its current text.
        position: The position.
        analysis: The latest analysis of a text of the document that could be parsed, or None.
        snippets_supported: True if the editor supports texts with placeholders.
    """
    offset = lines.offset(position)
    context = CompletionContext(path, lines, cursor_at(lines.text, offset), analysis)
    found = [*_offers(context)]
    typed = "" if not found else context.cursor.typed.strip("\"' ").lower()
    matching = [offer for offer in found if _is_subsequence(typed, (offer.typed or offer.label).lower())]
    shown, seen = list[types.CompletionItem](), set[str]()
    for number, offer in enumerate(sorted(matching, key=lambda offer: offer.group)):
        if offer.label not in seen and len(shown) < MAX_OFFERS:
            seen.add(offer.label)
            shown.append(context.insertion.item(offer, number, snippets_supported))
    return types.CompletionList(is_incomplete=len(matching) > MAX_OFFERS, items=shown)


def _is_subsequence(typed: str, label: str) -> bool:
    rest = iter(label)
    return all(char in rest for char in typed)


def _offers(context: CompletionContext) -> Iterator[Offer]:
    cursor = context.cursor
    if not context.lines.text[: cursor.start].strip() and not context.lines.text[cursor.end :].strip():
        yield from _starters(context)
    if not context.kind:
        yield from _kinds(context)
        return
    if cursor.slot is Slot.KEY:
        yield from key_offers(context, cursor.container, cursor.keys)
    elif cursor.slot is Slot.VALUE and cursor.style in ("plain", "quoted") and not cursor.has_members:
        if cursor.alone:
            yield from key_offers(context, cursor.path, ())
            yield from _first_item(context)
        yield from value_offers(context)


def _first_item(context: CompletionContext) -> Iterator[Offer]:
    """Yield offers for the first item of a list that has no items yet."""
    cursor = context.cursor
    kinds = kinds_at(context.model, (*cursor.path, 0)) if cursor.path else []
    if kinds:
        item = CompletionContext(context.path, context.lines, _as_item(cursor), context.analysis)
        yield from value_offers(item)


def _as_item(cursor: Cursor) -> Cursor:
    return replace(cursor, path=(*cursor.path, 0), alone=False, lead="- ")


def _starters(context: CompletionContext) -> Iterator[Offer]:
    """Yield whole documents for an empty file, of the kind that its name states."""
    from simfoundry.spec.editor.new import NewError, starter  # only an empty file needs it

    own = kind_of_file(context.path)
    for kind in (kind.partition("/")[0] for kind in KINDS):
        if own and kind != own:
            continue
        try:
            text = starter(kind, context.path)
        except (NewError, SimfoundryError, OSError):
            continue
        word = f"new {kind}"
        said = f"simfoundry: {kind}/1"
        yield Offer(word, types.CompletionItemKind.File, text, said, group=0, whole=True, has_places=False)


def _kinds(context: CompletionContext) -> Iterator[Offer]:
    """Yield the first key of a document whose kind is unknown."""
    if context.cursor.path in ((), ("",)) or context.cursor.path[:1] == ("simfoundry",):
        for kind in KINDS:
            text = kind if context.cursor.path[:1] == ("simfoundry",) else f"simfoundry: {kind}"
            yield Offer(text, types.CompletionItemKind.EnumMember, detail=kind.partition("/")[0], whole=True)


def signature(lines: Lines, position: types.Position) -> types.SignatureHelp | None:
    """Return the signature of the predicate whose arguments contain a position."""
    call = cursor_at(lines.text, lines.offset(position)).call
    kinds = argument_kinds(call.name) if call is not None else ()
    if call is None or not kinds:
        return None
    words = {"thing": "object", "body": "object or robot", "joint": "object.joint"}
    label, parameters = f"{call.name}(", list[types.ParameterInformation]()
    for k, kind in enumerate(kinds):
        label += ", " if k else ""
        word = words.get(kind, kind if kind != "number" else "xyz"[k - 1] if 0 < k < 4 else kind)
        parameters.append(types.ParameterInformation((len(label), len(label) + len(word))))
        label += word
    declared = PREDICATES.load(canonical(call.name, ())[0])
    text = f"{snippets.sentence(declared.meaning)}\n\n{declared.definition}"
    said = types.MarkupContent(types.MarkupKind.Markdown, text)
    information = types.SignatureInformation(f"{label})", said, parameters)
    return types.SignatureHelp([information], 0, min(call.index, len(kinds) - 1))
