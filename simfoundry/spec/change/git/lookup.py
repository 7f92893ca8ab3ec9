"""Find the documents that a blob refers to, although git does not pass the revision to a diff driver.

A diff driver gets two blobs. Each may belong to any commit that contains it at its path, to the index, or to the
working tree. The base of a document counts as known only if it is the same in all of them.
"""

from __future__ import annotations

import os
import subprocess
import time
from dataclasses import dataclass, field
from pathlib import Path

from simfoundry.spec.change.git.revisions import Read, document_references, extended

LOOKUP_S = 2.0
"""Time limit [s] for the search for one blob: `git log -p` starts one for every document of every commit."""

MAX_STATES = 5000
"""Largest number of commits to search; each needs a look-up for every document."""

Row = tuple[str | None, ...]
"""Blobs of some paths in one state of the repository."""


class _UnknownError(Exception):
    """Error if the documents beside a blob cannot be determined, or not within the time limit."""


@dataclass(frozen=True)
class Blob:
    """Document as git passes it: ``path`` in the repository, content, and blob hash (empty if there is none).

    ``in_worktree`` is True if the content was read from the working tree.
    """

    path: str
    content: bytes
    id: str = ""
    in_worktree: bool = False


def read_beside(top: Path, blob: Blob) -> Read | None:
    """Return a reader of the documents beside a blob in the repository at ``top``; None if its base is ambiguous.

    Other documents that it refers to can be read only if they are unambiguous; the reader reports the rest as missing.
    """
    if blob.in_worktree and not blob.id:
        return _only(blob, lambda name: _in_worktree(top, name))
    if not document_references(blob.path, blob.content):
        return _only(blob, lambda name: None)
    try:
        return _Lookup(top, blob, time.monotonic() + LOOKUP_S).read()
    except (_UnknownError, OSError):
        return _only(blob, lambda name: None) if extended(blob.path, blob.content) is None else None


def _only(blob: Blob, others: Read) -> Read:
    return lambda name: blob.content if name == blob.path else others(name)


def _in_worktree(top: Path, name: str) -> bytes | None:
    file = Path(os.path.realpath(top / name))
    return file.read_bytes() if file.is_relative_to(top.resolve()) and file.is_file() else None


@dataclass
class _Lookup:
    """State of one search; ``deadline`` is in seconds of the monotonic clock."""

    top: Path
    blob: Blob
    deadline: float
    chain: list[str] = field(init=False)
    others: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.chain = [self.blob.path]

    def read(self) -> Read:
        """Return a reader of the documents after searching until no further ones are found."""
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
        """Add the documents that those in ``texts`` extend or refer to."""
        for path in list(self.chain):
            base = extended(path, texts.get(path, b""))
            if base is not None and base not in self.chain:
                self.chain.append(base)
                self.others = [other for other in self.others if other != base]
        for path, text in texts.items():
            self.others += [r for r in document_references(path, text) if r not in self.chain and r not in self.others]

    def _sure(self, paths: list[str]) -> dict[str, str | None]:
        """Return the blob of each path that is the same in all states with ours; raises if the base is ambiguous."""
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
        """Return the blobs of the paths in every commit that changes one, in the index, and possibly on disk."""
        spec = ["--all", "--reflog", "--ignore-missing", "FETCH_HEAD", "MERGE_HEAD"]
        limit = f"--max-count={MAX_STATES + 1}"
        listed = self._git("rev-list", "--full-history", limit, *spec, "--", *paths).decode().split()
        if len(listed) > MAX_STATES:
            raise _UnknownError
        if any("\n" in path for path in paths):
            raise _UnknownError
        asked = "".join(f"{state}:{path}\n" for state in (*listed, "") for path in paths)
        answers = self._git("cat-file", "--batch-check=%(objectname)", stdin=asked.encode()).decode().splitlines()
        ids = [None if line.endswith((" missing", " ambiguous")) else line for line in answers]
        width = len(paths)
        rows = {tuple(ids[k : k + width]) for k in range(0, len(ids), width)}
        if self.blob.in_worktree:
            rows.add(tuple(self._on_disk(path) for path in paths))
        return rows

    def _on_disk(self, path: str) -> str | None:
        if not (self.top / path).is_file():
            return None
        return self._git("hash-object", "--", path).decode().strip()

    def _git(self, *args: str, stdin: bytes = b"") -> bytes:
        left = self.deadline - time.monotonic()
        if left <= 0:
            raise _UnknownError
        try:
            done = subprocess.run(
                ["git", "--literal-pathspecs", *args],
                cwd=self.top,
                input=stdin,
                capture_output=True,
                check=False,
                timeout=left,
            )
        except subprocess.TimeoutExpired:
            raise _UnknownError from None
        if done.returncode:
            raise _UnknownError
        return done.stdout
