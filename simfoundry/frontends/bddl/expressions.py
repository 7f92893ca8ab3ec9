"""Bracketed expressions with the line of each, as PDDL and BDDL are written."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from simfoundry.frontends.errors import ImportRefusedError

MAX_BYTES = 4 * 2**20
"""The largest problem of BEHAVIOR-1K has 20 kB."""

MAX_DEPTH = 64
"""Brackets within brackets: problems nest a tenth of it."""

_TOKEN = re.compile(r"[()]|[^\s();]+|;[^\n]*|\n")


@dataclass(frozen=True)
class BddlWord:
    """A word and its line; BDDL does not tell upper from lower case in what it defines itself."""

    text: str
    line: int

    @property
    def plain(self) -> str:
        """In lower case, without the mark of a variable."""
        return self.text.lower().removeprefix("?")


@dataclass(frozen=True)
class BddlGroup:
    """A bracketed expression."""

    items: tuple[BddlWord | BddlGroup, ...]
    line: int

    @property
    def head(self) -> str:
        """Its first word in lower case; empty where it begins with a bracket or is empty."""
        return self.items[0].plain if self.items and isinstance(self.items[0], BddlWord) else ""

    @property
    def rest(self) -> tuple[BddlWord | BddlGroup, ...]:
        """All but the first."""
        return self.items[1:]

    @property
    def groups(self) -> tuple[BddlGroup, ...]:
        """The groups in it."""
        return tuple(item for item in self.items if isinstance(item, BddlGroup))

    @property
    def words(self) -> tuple[BddlWord, ...]:
        """The words in it, the first left out."""
        return tuple(item for item in self.rest if isinstance(item, BddlWord))


def read_group(path: Path) -> BddlGroup:
    """Return the one expression of a file; raises :class:`ImportRefusedError`."""
    if path.stat().st_size > MAX_BYTES:
        raise ImportRefusedError(path, f"it is larger than {MAX_BYTES >> 20} MiB, which no task is")
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise ImportRefusedError(path, "it is not UTF-8 text") from None
    open_groups: list[tuple[list[BddlWord | BddlGroup], int]] = []
    whole: BddlGroup | None = None
    for token, line in _tokens(text):
        if token == "(":
            open_groups.append(([], line))
            if len(open_groups) > MAX_DEPTH:
                raise ImportRefusedError(path, f"brackets are nested deeper than {MAX_DEPTH}", line)
        elif not open_groups and token == ")":
            raise ImportRefusedError(path, "this bracket closes nothing", line)
        elif whole is not None or not open_groups:
            raise ImportRefusedError(path, f"`{token[:40]}` stands outside the problem", line)
        elif token != ")":
            open_groups[-1][0].append(BddlWord(token, line))
        else:
            items, start = open_groups.pop()
            group = BddlGroup(tuple(items), start)
            if open_groups:
                open_groups[-1][0].append(group)
            else:
                whole = group
    if open_groups:
        raise ImportRefusedError(path, "this bracket is never closed", open_groups[-1][1])
    if whole is None:
        raise ImportRefusedError(path, "it is empty", hint="a problem begins with `(define (problem NAME)`")
    return whole


def _tokens(text: str) -> Iterator[tuple[str, int]]:
    line = 1
    for match in _TOKEN.finditer(text):
        token = match[0]
        if token == "\n":
            line += 1
        elif token[0] != ";":
            yield token, line
