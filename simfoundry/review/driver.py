"""What git asks of a diff driver: one document, its content before and after, and never a failure."""

from __future__ import annotations

import difflib
import tempfile
from collections.abc import Sequence
from pathlib import Path

from simfoundry.review.compare import Comparison, Side, compare, side
from simfoundry.review.revisions import Read, export

NOTHING = "/dev/null"
"""What git passes for a file that is not there."""


def driver_lines(arguments: Sequence[str], top: Path) -> list[str]:
    """The answer to git's ``path old-file old-hex old-mode new-file new-hex new-mode [new-path info]``.

    ``top`` is the top folder of the working tree, where the other files are that the document refers to. A document
    that cannot be compared is shown as a plain diff of its text.
    """
    if len(arguments) == 1:
        return [f"* unmerged: {arguments[0]}"]
    if len(arguments) not in (7, 9):
        return [f"a diff driver is called with 7 or 9 arguments, not {len(arguments)}"]
    path, old_file, _, _, new_file, _, _ = arguments[:7]
    new_path = arguments[7] if len(arguments) == 9 else path
    old, new = (_content(Path(f)) for f in (old_file, new_file))
    head = path if new_path == path else f"{path} renamed to {new_path}"
    found = _compared(path, old, new_path, new, top)
    if found is None:
        return _plain(path, old, new_path, new)
    return [head, *(f"  {line}" for line in found.lines())]


def _compared(path: str, old: bytes | None, new_path: str, new: bytes | None, top: Path) -> Comparison | None:
    """The comparison; None where a side is unsound, or where anything else goes wrong: `git diff` must go on."""
    try:
        with tempfile.TemporaryDirectory(prefix="simfoundry-") as folder:
            before = _side(path, old, top, Path(folder) / "old")
            after = _side(new_path, new, top, Path(folder) / "new")
            found = compare(new_path, before, after, files=False)
            whole = all(s is None or s.loaded.spec is not None for s in (before, after))
            return found if whole and not found.obstacle else None
    except Exception:
        return None


def _content(file: Path) -> bytes | None:
    """What stands in a file; None where git says that there is none, and a link is what it points to, as git has it."""
    if str(file) == NOTHING:
        return None
    try:
        return str(file.readlink()).encode() if file.is_symlink() else file.read_bytes()
    except OSError:
        return b""


def _side(path: str, content: bytes | None, top: Path, folder: Path) -> Side | None:
    if content is None:
        return None
    found = export(_overlaid(path, content, top), path, folder)
    return side(found, path, folder) if found is not None else None


def _overlaid(path: str, content: bytes, top: Path) -> Read:
    """The working tree, in which one file has another content."""

    def read(name: str) -> bytes | None:
        if name == path:
            return content
        file = (top / name).resolve()
        return file.read_bytes() if file.is_relative_to(top.resolve()) and file.is_file() else None

    return read


def _plain(path: str, old: bytes | None, new_path: str, new: bytes | None) -> list[str]:
    """A unified diff of the texts."""
    before, after = ((side or b"").decode("utf-8", "replace").splitlines() for side in (old, new))
    names = (NOTHING if old is None else f"a/{path}", NOTHING if new is None else f"b/{new_path}")
    return [f"diff --git a/{path} b/{new_path}", *difflib.unified_diff(before, after, *names, lineterm="")]
