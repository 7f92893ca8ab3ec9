"""Objects that people have locked or hidden, which the next studio of the same document locks and hides as well."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from simfoundry.runtime.files import write_atomically
from simfoundry.studio.journal import document_folder

# Name of the file in the folder of a document's state, and its largest size [bytes]: ten thousand names are smaller.
FILE, MAX_BYTES = "marks.json", 2**20


@dataclass(frozen=True)
class ObjectMarks:
    """Names of objects of a document.

    Attributes:
        locked: Objects that no act may change.
        hidden: Objects that are not shown.
    """

    locked: frozenset[str] = frozenset()
    hidden: frozenset[str] = frozenset()


def read_marks(document: Path) -> ObjectMarks:
    """Return the marks of a document; none if there are none, or if they cannot be read."""
    path = document_folder(document) / FILE
    try:
        if path.stat().st_size > MAX_BYTES:
            return ObjectMarks()
        data = json.loads(path.read_text(encoding="utf-8"))
        return ObjectMarks(frozenset(map(str, data["locked"])), frozenset(map(str, data["hidden"])))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return ObjectMarks()


def write_marks(document: Path, marks: ObjectMarks) -> None:
    """Keep the marks of a document.

    Raises:
        OSError: If they cannot be written.
    """
    path = document_folder(document) / FILE
    if marks == ObjectMarks():
        path.unlink(missing_ok=True)
        return
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    data = {"locked": sorted(marks.locked), "hidden": sorted(marks.hidden)}
    write_atomically(path, (json.dumps(data, ensure_ascii=False) + "\n").encode())
