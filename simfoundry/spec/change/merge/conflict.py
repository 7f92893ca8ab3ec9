"""Merge conflicts, and their representation in documents."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Any

Path_ = tuple[str, ...]

# Key that contains the unresolved conflicts of a document.
CONFLICTS = "conflicts"


class Absent(Enum):
    """The type of :data:`ABSENT`, which represents a missing value, as opposed to the value ``null``."""

    ABSENT = "absent"


ABSENT = Absent.ABSENT

_PART = re.compile(r'"(?:[^"\\]|\\.)*"|[^."]+')
_AGAIN = re.compile(r" #[0-9]+\Z")
# Maximum length of a value in a message [characters], so that both sides and the path fit into 160 columns.
_SHOWN = 60


@dataclass(frozen=True)
class MergeConflict:
    """Conflicting edits to the value at ``path``.

    The three values are plain data, or :data:`ABSENT`. If they are lists of the keys of an ordered mapping, only the
    order of the keys conflicts. If they are names, and ``path`` refers to the member named ``base``, both sides renamed
    that member.

    Attributes:
        path: The location of the value.
        base: The original value.
        ours: Our value.
        theirs: Their value.
        comment: The comment beside their value, which is written beside the recorded conflict.
    """

    path: Path_
    base: Any
    ours: Any
    theirs: Any
    comment: str = ""

    def record(self) -> dict[str, Any]:
        """Return the entry for ``conflicts``, omitting absent values."""
        sides = {"base": self.base, "ours": self.ours, "theirs": self.theirs}
        return {name: value for name, value in sides.items() if value is not ABSENT}

    def __str__(self) -> str:
        """Return a summary such as ``objects.cup.mass: ours 0.25, theirs 0.31 (was 0.2)``."""
        was = "new" if self.base is ABSENT else f"was {shown(self.base)}"
        return f"{dotted(self.path)}: ours {shown(self.ours)}, theirs {shown(self.theirs)} ({was})"


def dotted(path: Path_) -> str:
    """Format a path as a key for ``conflicts``. Parts that contain a dot or a quote are enclosed in double quotes."""
    return ".".join(json.dumps(p, ensure_ascii=False) if not p or "." in p or '"' in p else p for p in path)


def parts(text: str) -> Path_:
    """Parse a key from ``conflicts`` as a path."""
    return tuple(_parts(_AGAIN.sub("", text)))


def numbered(path: str, taken: dict[str, Any]) -> str:
    """Return ``path`` as a unique key.

    If that key is already taken, for example by an earlier conflict, the result is ``path #2``, ``path #3`` and so on.
    """
    keys = (path, *(f"{path} #{count}" for count in range(2, len(taken) + 2)))
    return next(key for key in keys if key not in taken)


def shown(value: Any) -> str:
    """Format a value as a single short line."""
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
