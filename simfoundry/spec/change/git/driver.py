"""The external diff driver for git, which compares two versions of a document and never fails."""

from __future__ import annotations

import difflib
import os
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from simfoundry.spec.change.compare import DocumentComparison, Side, compare, side
from simfoundry.spec.change.diff.changes import leaves
from simfoundry.spec.change.git.revisions import Read, bases_of, document_references, export
from simfoundry.spec.change.merge.conflict import ABSENT, dotted, shown
from simfoundry.spec.models.kinds import KINDS
from simfoundry.spec.yaml.text import parse

# Argument that git passes in place of a missing file.
NOTHING = "/dev/null"


def driver_lines(arguments: Sequence[str], top: Path) -> list[str]:
    """Return the output for the arguments that git passes to a diff driver.

    A document that extends another document is first merged with its base, provided that the base is known on both
    sides. Otherwise, only the document's own fields are compared. Documents that cannot be compared are shown as a
    plain diff.

    Args:
        arguments: ``path old-file old-hex old-mode new-file new-hex new-mode [new-path info]``
        top: The root of the working tree.
    """
    if len(arguments) == 1:
        return [f"* unmerged: {arguments[0]}"]
    if len(arguments) not in (7, 9):
        return [f"git calls a diff driver with 7 or 9 arguments, not {len(arguments)}"]
    path, old_file, old_id, _, new_file, new_id, _ = arguments[:7]
    new_path = arguments[7] if len(arguments) == 9 else path
    old, new = _blob(path, old_file, old_id, top), _blob(new_path, new_file, new_id, top)
    head = path if new_path == path else f"{path} renamed to {new_path}"
    found = _compared(old, new, top)
    if found is None:
        return _plain(path, old, new_path, new)
    return [head, *(f"  {line}" for line in found)]


def _blob(path: str, file: str, id_: str, top: Path) -> Blob | None:
    """Return one side of the comparison, or None if git reports that the document does not exist on that side."""
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
    """Compare both sides.

    Returns None if a side is invalid or an error occurs, so that `git diff` can continue.
    """
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
    """Compare both sides, merged with the documents that they extend, or return None if a base is ambiguous."""
    sides: list[Side | None] = [None, None]
    for k, blob in enumerate((old, new)):
        if blob is not None:
            read = read_beside(top, blob)
            if read is None:
                return None
            found = export(read, blob.path, folder / str(k))
            sides[k] = side(found, blob.path, folder / str(k)) if found is not None else None
    return compare((new or old or Blob("", b"")).path, sides[0], sides[1], files=False)


# -- documents whose base is unknown --------------------------------------------------------------------------------


def _own_fields(old: Blob | None, new: Blob | None) -> Iterator[str]:
    """Compare only the document's own fields.

    Raises:
        ValueError: If the document neither extends nor includes another document.
    """
    present = [blob for blob in (old, new) if blob is not None]
    bases = [bases_of(blob.path, blob.content) for blob in present]
    before, after = (
        dict(leaves(parse(blob.content.decode("utf-8")).data)) if blob is not None else {} for blob in (old, new)
    )
    if [] in bases or {side.get(("simfoundry",)) for side in (before, after) if side} - set(KINDS):
        raise ValueError
    changed = [path for path in dict.fromkeys((*before, *after)) if before.get(path, ABSENT) != after.get(path, ABSENT)]
    for path in changed:
        yield f"{dotted(path)}: {shown(before.get(path, ABSENT))} → {shown(after.get(path, ABSENT))}"
    if not changed:
        yield "equivalent, written differently"
    names = " or ".join(dict.fromkeys(name for side in bases for name in side))
    yield f"(only this file's own keys are compared, because git does not report the revision of {names};"
    yield f" `simfoundry log {present[-1].path}` shows each commit in full)"


def _plain(path: str, old: Blob | None, new_path: str, new: Blob | None) -> list[str]:
    """Return a unified diff of the two texts."""
    before, after = (
        (b"" if side is None else side.content).decode("utf-8", "replace").splitlines() for side in (old, new)
    )
    names = (NOTHING if old is None else f"a/{path}", NOTHING if new is None else f"b/{new_path}")
    return [f"diff --git a/{path} b/{new_path}", *difflib.unified_diff(before, after, *names, lineterm="")]


# Time limit [s] for one search, because `git log -p` starts a search for every document in every commit.
LOOKUP_S = 2.0

# Maximum number of commits to search, because each commit requires a lookup for every document.
MAX_STATES = 5000

# The hashes of the blobs at a list of paths in one state of the repository.
Row = tuple[str | None, ...]


class _UnknownError(Exception):
    """Raised if the documents that belong to a blob cannot be determined within the time limit."""


@dataclass(frozen=True)
class Blob:
    """A document that git passes to the driver.

    Attributes:
        path: The path in the repository.
        content: The content of the file.
        id: The hash of the blob, or an empty string if it is unknown.
        in_worktree: True if the content was read from the working tree.
    """

    path: str
    content: bytes
    id: str = ""
    in_worktree: bool = False


def read_beside(top: Path, blob: Blob) -> Read | None:
    """Return a reader for the documents that belong to a blob, or None if one that it extends or includes is ambiguous.

    ``top`` is the root of the working tree. Other documents that the blob refers to are treated as missing if they are
    ambiguous.
    """
    if blob.in_worktree and not blob.id:
        return _only(blob, lambda name: _in_worktree(top, name))
    if not document_references(blob.path, blob.content):
        return _only(blob, lambda name: None)
    try:
        return _Lookup(top, blob, time.monotonic() + LOOKUP_S, [blob.path]).read()
    except (_UnknownError, OSError):
        return _only(blob, lambda name: None) if not bases_of(blob.path, blob.content) else None


def _only(blob: Blob, others: Read) -> Read:
    return lambda name: blob.content if name == blob.path else others(name)


def _in_worktree(top: Path, name: str) -> bytes | None:
    file = Path(os.path.realpath(top / name))
    return file.read_bytes() if file.is_relative_to(top.resolve()) and file.is_file() else None


@dataclass
class _Lookup:
    """The state of a search for the documents that belong to a blob.

    Attributes:
        top: The root of the working tree.
        blob: The document.
        deadline: The time on the monotonic clock at which the search must end [s].
        chain: The paths of the document and of the documents that it extends or includes.
        others: The paths of all other documents that these documents refer to.
    """

    top: Path
    blob: Blob
    deadline: float
    chain: list[str]
    others: list[str] = field(default_factory=list)

    def read(self) -> Read:
        """Search until no further documents are found, and return a reader for the documents."""
        texts = {self.blob.path: self.blob.content}
        while True:
            ids = self._sure([*self.chain, *self.others])
            for path, found in ids.items():
                if path not in texts and found is not None:
                    texts[path] = self._git("cat-file", "blob", found)
            known = len(self.chain) + len(self.others)
            self._follow(texts)
            if len(self.chain) + len(self.others) == known:
                return lambda name: texts.get(name)

    def _follow(self, texts: dict[str, bytes]) -> None:
        """Add the documents that the documents in ``texts`` extend, include or refer to."""
        for path in list(self.chain):
            for base in bases_of(path, texts.get(path, b"")):
                if base not in self.chain:
                    self.chain.append(base)
                    self.others = [other for other in self.others if other != base]
        for path, text in texts.items():
            self.others += [r for r in document_references(path, text) if r not in self.chain and r not in self.others]

    def _sure(self, paths: list[str]) -> dict[str, str | None]:
        """Return the hash of each path that has the same hash in all repository states that contain the blob.

        Raises:
            _UnknownError: If a document in the chain is ambiguous.
        """
        rows = {row for row in self._rows(paths) if row[0] == self.blob.id}
        if not rows:
            raise _UnknownError
        found = dict[str, str | None]()
        for path, ids in zip(paths, zip(*rows, strict=True), strict=True):
            if len(set(ids)) == 1:
                found[path] = ids[0]
            elif path in self.chain:
                raise _UnknownError
        return found

    def _rows(self, paths: list[str]) -> set[Row]:
        """Return the hashes of the paths in the index, in each commit that changes a path, and optionally on disk."""
        spec = ["--all", "--reflog", "--ignore-missing", "FETCH_HEAD", "MERGE_HEAD"]
        limit = f"--max-count={MAX_STATES + 1}"
        listed = self._git("rev-list", "--full-history", limit, *spec, "--", *paths).decode().split()
        if len(listed) > MAX_STATES or any("\n" in path for path in paths):
            raise _UnknownError
        asked = "".join(f"{state}:{path}\n" for state in (*listed, "") for path in paths)
        answers = self._git("cat-file", "--batch-check=%(objectname)", stdin=asked.encode()).decode().splitlines()
        ids = [None if line.endswith((" missing", " ambiguous")) else line for line in answers]
        width = len(paths)
        rows = {tuple(ids[k : k + width]) for k in range(0, len(ids), width)}
        if self.blob.in_worktree:
            on_disk = [path if (self.top / path).is_file() else None for path in paths]
            rows.add(tuple(self._git("hash-object", "--", path).decode().strip() if path else None for path in on_disk))
        return rows

    def _git(self, *args: str, stdin: bytes = b"") -> bytes:
        command, left = ["git", "--literal-pathspecs", *args], max(self.deadline - time.monotonic(), 0.0)
        try:
            run = subprocess.run(command, cwd=self.top, input=stdin, capture_output=True, check=True, timeout=left)
        except (subprocess.TimeoutExpired, subprocess.CalledProcessError):
            raise _UnknownError from None
        return run.stdout
