"""History of a document: commits that changed it or a file that it extends or refers to."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from simfoundry.spec.change.compare import DocumentComparison, Side, compare, side
from simfoundry.spec.change.git.revisions import Read, export, files_of, git, references, renamed_from

_FORMAT = "%H%x00%P%x00%aI%x00%an%x00%s"
"""Format of a commit for `git log`: hash, parents, date, author, and subject."""


@dataclass(frozen=True)
class Commit:
    """Commit with its full hash; ``date`` is in ISO 8601. It is compared with its first parent."""

    id: str
    parents: tuple[str, ...]
    date: str
    author: str
    subject: str


@dataclass(frozen=True)
class HistoryEntry:
    """Changes that one commit made to a document."""

    commit: Commit
    comparison: DocumentComparison


def history(root: Path, revisions: Sequence[str], path: str, verbose: bool = False) -> Iterator[HistoryEntry]:
    """Yield the commits that changed the document ``path`` of the repository at ``root``, latest first.

    ``revisions`` are arguments of `git rev-list`: commits to start from, and commits with ``^`` at which to stop. Each
    commit is compared with its first parent, each joined with the documents that it extended at that time. A merge
    commit counts only if it differs from all of its parents. The history follows renames of the document.
    """
    names, commits = _trace(root, revisions, path)
    for commit in commits:
        with tempfile.TemporaryDirectory(prefix="simfoundry-") as folder:
            new = _side(root, commit.id, names, Path(folder) / "new")
            olds = [_side(root, parent, names, Path(folder) / str(k)) for k, parent in enumerate(commit.parents)]
            found = [compare(path, old, new, verbose) for old in olds or [None] if old is not None or new is not None]
        if found and all(comparison.differs for comparison in found):
            yield HistoryEntry(commit, found[0])


def _side(root: Path, revision: str, names: Sequence[str], folder: Path) -> Side | None:
    """Read the document under the first of its names that exists in a commit."""
    with files_of(root, revision) as read:
        for name in names:
            found = export(read, name, folder)
            if found is not None:
                return side(found, f"{revision[:10]}:{name}", folder)
    return None


def _trace(root: Path, revisions: Sequence[str], path: str) -> tuple[list[str], list[Commit]]:
    """Return all names of a document, and every commit that changed it or a file that it refers to."""
    names, paths, read_already = [path], {path}, set[str]()
    while True:
        commits = list(_listed(root, revisions, sorted(paths)))
        known = len(paths)
        for commit in commits:
            if commit.id in read_already:
                continue
            read_already.add(commit.id)
            with files_of(root, commit.id) as read:
                present = next((name for name in names if read(name) is not None), None)
                paths |= _closure(read, present) if present is not None else set()
            former = _former_name(root, commit, present) if present is not None else None
            if former is not None and former not in names:
                names.append(former)
                paths.add(former)
        if len(paths) == known:
            return names, commits


def _listed(root: Path, revisions: Sequence[str], paths: Sequence[str]) -> Iterator[Commit]:
    """Yield the commits that change one of the paths, latest first."""
    options = ["--full-history", "--date-order", f"--format={_FORMAT}"]
    found = git(root, "--literal-pathspecs", "rev-list", *options, *revisions, "--", *paths)
    for line in found.decode(errors="replace").splitlines():
        if "\0" in line:  # other lines are headers
            id_, parents, date, author, subject = line.split("\0", 4)
            yield Commit(id_, tuple(parents.split()), date, author, subject)


def _closure(read: Read, path: str) -> set[str]:
    """Return the document and all files that it refers to, directly or through other documents."""
    todo, seen = [path], {path}
    while todo:
        name = todo.pop()
        data = read(name) if name.endswith(".yaml") else None
        new = [reference for reference in references(name, data) if reference not in seen] if data is not None else []
        seen.update(new)
        todo += new
    return seen


def _former_name(root: Path, commit: Commit, path: str) -> str | None:
    """Return the name of a document before the commit that renamed it to ``path``."""
    for parent in commit.parents[:1]:
        with files_of(root, parent) as read:
            if read(path) is None:
                return renamed_from(root, parent, commit.id, path)
    return None
