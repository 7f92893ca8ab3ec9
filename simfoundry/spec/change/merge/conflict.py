"""Merge conflicts, and their record in a document."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Any

Path_ = tuple[str, ...]


class Absent(Enum):
    """Marker of a value that a side does not have; ``null`` is a value."""

    ABSENT = "absent"


ABSENT = Absent.ABSENT

_PART = re.compile(r'"(?:[^"\\]|\\.)*"|[^."]+')
_AGAIN = re.compile(r" #[0-9]+\Z")
_SHOWN = 60
"""Characters of a value in a message: both sides fit into 160 columns with their path."""


@dataclass(frozen=True)
class MergeConflict:
    """Conflicting edits of the value at ``path``: plain data, or :data:`ABSENT`.

    Where the value is a mapping whose order means something, the three may be lists of its keys: only their order is in
    doubt. Where the three are names, and ``path`` was a member of ``base``'s name, both sides renamed it. The
    ``comment`` that theirs has beside its value waits beside the entry.
    """

    path: Path_
    base: Any
    ours: Any
    theirs: Any
    comment: str = ""

    def record(self) -> dict[str, Any]:
        """Return the entry for ``conflicts``, without absent values."""
        sides = {"base": self.base, "ours": self.ours, "theirs": self.theirs}
        return {name: value for name, value in sides.items() if value is not ABSENT}

    def __str__(self) -> str:
        """``objects.cup.mass: ours 0.25, theirs 0.31 (was 0.2)``."""
        was = "new" if self.base is ABSENT else f"was {shown(self.base)}"
        return f"{dotted(self.path)}: ours {shown(self.ours)}, theirs {shown(self.theirs)} ({was})"


def dotted(path: Path_) -> str:
    """Spell a path as a key of ``conflicts``; a part with a dot or a quote is in double quotes."""
    return ".".join(json.dumps(p, ensure_ascii=False) if not p or "." in p or '"' in p else p for p in path)


def parts(text: str) -> Path_:
    """Return the path that a key of ``conflicts`` spells."""
    return tuple(_parts(_AGAIN.sub("", text)))


def numbered(path: str, taken: dict[str, Any]) -> str:
    """Return a free key for an entry at ``path``, as an older conflict may still be open there."""
    count = 2
    key = path
    while key in taken:
        key, count = f"{path} #{count}", count + 1
    return key


def shown(value: Any) -> str:
    """Return a value on one short line."""
    if value is ABSENT:
        return "nothing"
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 1]}…"


def _parts(text: str) -> Iterator[str]:
    for part in _PART.findall(text):
        try:
            yield json.loads(part) if part.startswith('"') else part
        except ValueError:  # quotes that a person wrote
            yield part
