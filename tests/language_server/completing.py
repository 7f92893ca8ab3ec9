"""Completion asked at every token of a document: the token is removed, and what is offered is inserted in its place."""

from __future__ import annotations

import re
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import yaml
from lsprotocol import types

from simfoundry.language_server.analysis import Analysis, analyzed
from simfoundry.language_server.completion.complete import complete
from simfoundry.language_server.completion.insertion import filled
from simfoundry.language_server.completion.key_offers import names_section
from simfoundry.language_server.cursor.scan import Slot
from simfoundry.language_server.positions import Lines
from simfoundry.spec.models.base import Model
from simfoundry.spec.models.kinds import model_of
from simfoundry.spec.models.types import EXPRESSIONS, REFERENCES, file_patterns, kinds_at
from simfoundry.spec.open_documents import OpenDocuments
from tests.language_server.tokens import joined, leaves


@dataclass(frozen=True)
class Token:
    """A key, name, predicate, choice or file of a document that completion should offer."""

    what: str
    start: int
    end: int
    text: str


@cache
def analysis(path: Path) -> Analysis:
    """The analysis of a document as it is on the disk."""
    lines = Lines(path.read_text(encoding="utf-8"))
    return analyzed(path, lines, 1, OpenDocuments())


def tokens(text: str) -> Iterator[Token]:
    """Every token of a document that completion should offer, by the models alone."""
    kind = re.search(r"^simfoundry: (\w+)/1", text, re.MULTILINE)
    assert kind is not None
    model = model_of(f"{kind[1]}/1")
    for slot, path, start, end, style in joined(text, leaves(text)):
        if style in ("*", "|", ">") or "native" in path or "conflicts" in path:
            continue
        plain = yaml.safe_load(text[start:end]) if style else text[start:end]
        if slot is Slot.KEY:
            fields = [k for k in kinds_at(model, path[:-1]) if isinstance(k, type) and issubclass(k, Model)]
            section = names_section(kind[1], path[:-1]) or ""
            if any(path[-1] in k.model_fields for k in fields):
                yield Token("key", start, end, str(plain))
            elif (kind[1] in ("task", "cousins") and section.split(".")[0] in ("objects", "parameters")) or (
                section.endswith((".joints", ".parameters")) and not section.startswith("templates")
            ):
                yield Token("name", start, end, str(plain))
            continue
        kinds = kinds_at(model, path)
        key = next(part for part in reversed(path) if isinstance(part, str))
        if isinstance(plain, str) and "$" in plain:
            for found in re.finditer(r"\$\w+", text[start:end]):
                yield Token("parameter", start + found.start(), start + found.end(), found.group())
        elif key in EXPRESSIONS and isinstance(plain, str):
            yield Token("predicate", start, end, plain.partition("(")[0])
            for found in re.finditer(r"(?<=[(,])\s*([a-z][\w.]*)", text[start:end]):
                yield Token("argument", start + found.start(1), start + found.end(1), found[1])
        elif any(
            len(p) == len(path) and all(a in ("*", b) for a, b in zip(p, path, strict=True))
            for p in file_patterns(model)
        ):
            yield Token("file", start, end, str(plain))
        elif any(typing.get_origin(k) is typing.Literal and plain in typing.get_args(k) for k in kinds) or (
            bool in kinds and plain in ("true", "false")
        ):
            yield Token("choice", start, end, str(plain))
        elif (key in (*REFERENCES, "model", "variant")) and str in kinds and isinstance(plain, str):
            yield Token("name", start, end, plain)


def ask(path: Path, text: str, offset: int, known: Analysis | None) -> list[types.CompletionItem]:
    """What is offered at an offset of a text."""
    lines = Lines(text)
    return list(complete(path, lines, lines.position(offset), known).items)


def inserted(text: str, item: types.CompletionItem) -> str:
    """The text after an offer has been accepted, as an editor inserts it."""
    lines = Lines(text)
    assert isinstance(item.text_edit, types.TextEdit)
    start, end = lines.span(item.text_edit.range)
    new = item.text_edit.new_text
    if item.insert_text_format == types.InsertTextFormat.Snippet:
        new = filled(new)
    line = max(text.rfind(mark, 0, start) for mark in "\r\n") + 1
    before = text[line:start]
    indent = before[: len(before) - len(before.lstrip(" "))]
    if item.insert_text_mode == types.InsertTextMode.AdjustIndentation:
        new = new.replace("\n", f"\n{indent}")
    return text[:start] + new + text[end:]


def names(item: types.CompletionItem) -> set[Any]:
    """What an offer stands for: its label, and what a user types for it."""
    return {item.label, (item.filter_text or "").strip("\"'"), item.label.partition("(")[0]}
