"""Merge conflicts and how they are recorded in a document."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Any

Path_ = tuple[str, ...]

CONFLICTS = "conflicts"
"""Key of the open conflicts of a document."""


class Absent(Enum):
    """Marker for a value that is missing on a side; ``null`` counts as a value."""

    ABSENT = "absent"


ABSENT = Absent.ABSENT

_PART = re.compile(r'"(?:[^"\\]|\\.)*"|[^."]+')
_AGAIN = re.compile(r" #[0-9]+\Z")
_SHOWN = 60
"""Longest value in a message [characters]; both sides and their path fit into 160 columns."""


@dataclass(frozen=True)
class MergeConflict:
    """Conflicting edits of the value at ``path``: plain data, or :data:`ABSENT`.

    If the value is an ordered mapping, the three values may be lists of its keys, and only their order is in conflict.
    If the three values are names and ``path`` is the member named ``base``, both sides renamed it. The ``comment`` that
    theirs has beside its value is kept beside the entry.
    """

    path: Path_
    base: Any
    ours: Any
    theirs: Any
    comment: str = ""

    def record(self) -> dict[str, Any]:
        """Return the entry of ``conflicts``, without absent values."""
        sides = {"base": self.base, "ours": self.ours, "theirs": self.theirs}
        return {name: value for name, value in sides.items() if value is not ABSENT}

    def __str__(self) -> str:
        """Return a summary such as ``objects.cup.mass: ours 0.25, theirs 0.31 (was 0.2)``."""
        was = "new" if self.base is ABSENT else f"was {shown(self.base)}"
        return f"{dotted(self.path)}: ours {shown(self.ours)}, theirs {shown(self.theirs)} ({was})"


def dotted(path: Path_) -> str:
    """Format a path as a key of ``conflicts``; parts with a dot or a quote are put in double quotes."""
    return ".".join(json.dumps(p, ensure_ascii=False) if not p or "." in p or '"' in p else p for p in path)


def parts(text: str) -> Path_:
    """Parse a key of ``conflicts`` into a path."""
    return tuple(_parts(_AGAIN.sub("", text)))


def numbered(path: str, taken: dict[str, Any]) -> str:
    """Return an unused key for an entry at ``path``, because an older conflict may still be open there."""
    count = 2
    key = path
    while key in taken:
        key, count = f"{path} #{count}", count + 1
    return key


def shown(value: Any) -> str:
    """Format a value as one short line."""
    if value is ABSENT:
        return "nothing"
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 1]}…"


def _parts(text: str) -> Iterator[str]:
    for part in _PART.findall(text):
        try:
            yield json.loads(part) if part.startswith('"') else part
        except ValueError:  # quotes edited by hand
            yield part
