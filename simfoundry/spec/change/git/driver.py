"""External diff driver for git: compares two versions of one document and never fails."""

from __future__ import annotations

import difflib
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from simfoundry.spec.change.compare import DocumentComparison, Side, compare, side
from simfoundry.spec.change.git.lookup import Blob, read_beside
from simfoundry.spec.change.git.revisions import export, extended
from simfoundry.spec.change.merge.conflict import ABSENT, dotted, shown
from simfoundry.spec.models.kinds import KINDS
from simfoundry.spec.yaml.text import parse

NOTHING = "/dev/null"
"""Argument that git passes for a missing file."""


def driver_lines(arguments: Sequence[str], top: Path) -> list[str]:
    """Return the output for the arguments ``path old-file old-hex old-mode new-file new-hex new-mode [new-path info]``.

    ``top`` is the top folder of the working tree. A document that extends another is compared as a whole if its base is
    known on both sides, and otherwise by its own fields. Documents that cannot be compared are shown as a plain diff.
    """
    if len(arguments) == 1:
        return [f"* unmerged: {arguments[0]}"]
    if len(arguments) not in (7, 9):
        return [f"a diff driver is called with 7 or 9 arguments, not {len(arguments)}"]
    path, old_file, old_id, _, new_file, new_id, _ = arguments[:7]
    new_path = arguments[7] if len(arguments) == 9 else path
    old, new = _blob(path, old_file, old_id, top), _blob(new_path, new_file, new_id, top)
    head = path if new_path == path else f"{path} renamed to {new_path}"
    found = _compared(old, new, top)
    if found is None:
        return _plain(path, old, new_path, new)
    return [head, *(f"  {line}" for line in found)]


def _blob(path: str, file: str, id_: str, top: Path) -> Blob | None:
    """Return one side; None if git reports that it does not exist."""
    if file == NOTHING:
        return None
    known = id_ if id_.strip("0.") else ""
    return Blob(path, _content(Path(file)), known, not known or (top / file).absolute() == (top / path).absolute())


def _content(file: Path) -> bytes:
    """Return the content of a file, or the target of a symbolic link, as git stores it."""
    try:
        return str(file.readlink()).encode() if file.is_symlink() else file.read_bytes()
    except OSError:
        return b""


def _compared(old: Blob | None, new: Blob | None, top: Path) -> list[str] | None:
    """Compare both sides; None if one is invalid or anything else fails, because `git diff` must continue."""
    try:
        with tempfile.TemporaryDirectory(prefix="simfoundry-") as folder:
            whole = _compared_whole(old, new, top, Path(folder))
        if whole is None:
            return list(_own_fields(old, new))
        sound = all(s is None or s.loaded.spec is not None for s in (whole.old, whole.new))
        return whole.lines() if sound and not whole.obstacle else None
    except Exception:
        return None


def _compared_whole(old: Blob | None, new: Blob | None, top: Path, folder: Path) -> DocumentComparison | None:
    """Compare both sides joined with the documents that they extend; None if those are unknown."""
    sides = dict[str, Side | None]()
    for name, blob in (("old", old), ("new", new)):
        read = read_beside(top, blob) if blob is not None else None
        if blob is not None and read is None:
            return None
        found = export(read, blob.path, folder / name) if blob is not None and read is not None else None
        sides[name] = side(found, blob.path, folder / name) if blob is not None and found is not None else None
    return compare((new or old or Blob("", b"")).path, sides["old"], sides["new"], files=False)


# -- documents whose base is unknown --------------------------------------------------------------------------------


def _own_fields(old: Blob | None, new: Blob | None) -> Iterator[str]:
    """Compare only a document's own fields; raises :class:`ValueError` if that is not meaningful."""
    present = [blob for blob in (old, new) if blob is not None]
    bases = [extended(blob.path, blob.content) for blob in present]
    data = [parse(blob.content.decode("utf-8")).data for blob in present]
    if None in bases or {d.get("simfoundry") for d in data} - set(KINDS):
        raise ValueError
    before, after = ({} if blob is None else dict(_leaves(data[present.index(blob)], ())) for blob in (old, new))
    changed = [path for path in dict.fromkeys((*before, *after)) if before.get(path, ABSENT) != after.get(path, ABSENT)]
    for path in changed:
        yield f"{dotted(path)}: {shown(before.get(path, ABSENT))} → {shown(after.get(path, ABSENT))}"
    if not changed:
        yield "equivalent, written differently"
    names = " or ".join(dict.fromkeys(map(str, bases)))
    yield f"(only the keys of this file: git does not pass the revision of {names} it extends here;"
    yield f" `simfoundry log {present[-1].path}` shows each commit in full)"


def _leaves(data: Any, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield every value that is not a non-empty mapping, with its path."""
    if isinstance(data, dict) and data:
        for key, item in data.items():
            yield from _leaves(item, (*path, key))
    else:
        yield path, data


def _plain(path: str, old: Blob | None, new_path: str, new: Blob | None) -> list[str]:
    """Return a unified diff of the texts."""
    before, after = (
        (b"" if side is None else side.content).decode("utf-8", "replace").splitlines() for side in (old, new)
    )
    names = (NOTHING if old is None else f"a/{path}", NOTHING if new is None else f"b/{new_path}")
    return [f"diff --git a/{path} b/{new_path}", *difflib.unified_diff(before, after, *names, lineterm="")]
