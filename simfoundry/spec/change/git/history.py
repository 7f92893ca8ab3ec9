"""The history of a document: what each commit changed in it, and in the documents that it extends or refers to."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from simfoundry.spec.change.compare import DocumentComparison, Side, compare, contents, side
from simfoundry.spec.change.git.revisions import (
    GitError,
    export,
    files_of,
    git,
    referenced_files,
    renames_between,
    shallow_commits,
)
from simfoundry.spec.diagnostics import Diagnostic

# Output format for commits: hash, parents, date, author, and subject.
_FORMAT = "%H%x00%P%x00%aI%x00%an%x00%s"


@dataclass(frozen=True)
class Commit:
    """A commit, with its full hash as ``id`` and an ISO 8601 ``date``."""

    id: str
    parents: tuple[str, ...]
    date: str
    author: str
    subject: str


@dataclass(frozen=True)
class HistoryEntry:
    """The changes that one commit made to a document.

    Attributes:
        commit: The commit, or None for changes that are not committed yet.
        comparison: The document before and after the commit, each complete with the documents that it extends.
        note: What a reader must know about the comparison, such as that it skips revisions that are invalid, or an
            empty string.
    """

    commit: Commit | None
    comparison: DocumentComparison
    note: str = ""

    def lines(self) -> list[str]:
        """Return the note and one line for each change, followed by a summary line."""
        if self.note and self.comparison.old is None:
            return [self.note, f"it contains {contents(self.comparison.new)}"]
        reasons = [f"  {d.file}:{d.line}:{d.column}: {d.message}" for d in _reasons(self.comparison)]
        return [*([self.note] if self.note else []), *self.comparison.lines(), *reasons]


def _reasons(comparison: DocumentComparison) -> Iterator[Diagnostic]:
    """Yield the first error in each version that is invalid."""
    for each in (comparison.old, comparison.new):
        if each is not None and each.spec is None and each.findings:
            yield each.findings[0]


def history(
    root: Path, revisions: Sequence[str], names: Sequence[str], verbose: bool = False
) -> Iterator[HistoryEntry]:
    """Yield the commits that changed a document, newest first.

    Each commit is compared with its first parent, and both versions are merged with the documents that they extended at
    that time. Merge commits are included only if they differ from all of their parents. The history follows renames of
    the document.

    Args:
        root: The root of the repository.
        revisions: The arguments for `git rev-list`: the commits to start from, and commits prefixed with ``^`` at which
            to stop.
        names: The paths of the document, relative to the repository root; former names come last.
        verbose: Also include commits that only changed how the document is written.
    """
    path = names[0]
    names, commits = _trace(root, revisions, names)
    grafted = shallow_commits(root)
    for k, each in enumerate(commits):
        with tempfile.TemporaryDirectory(prefix="simfoundry-") as folder:
            new = side_at(root, each.id, names, Path(folder) / "new")
            olds = [side_at(root, parent, names, Path(folder) / str(j)) for j, parent in enumerate(each.parents)]
            found = [compare(path, old, new, verbose) for old in olds or [None] if old is not None or new is not None]
            if not found or not all(_is_told(comparison, verbose) for comparison in found):
                continue
            if each.id in grafted:
                yield HistoryEntry(each, found[0], _SHALLOW)
            elif new is not None and new.spec is not None and olds and _is_invalid(olds[0]):
                yield _since_valid(root, each, new, names, commits[k + 1 :], Path(folder), verbose)
            else:
                yield HistoryEntry(each, found[0])


_SHALLOW = "what this commit changed is unknown, because the clone is shallow (`git fetch --unshallow` completes it)"

# Maximum number of commits to search for a valid version. Documents that are invalid are usually fixed at once.
MAX_INVALID = 50


def _is_told(comparison: DocumentComparison, verbose: bool) -> bool:
    """Return True if a comparison belongs to the history."""
    old, new = comparison.old, comparison.new
    rewritten = verbose and old is not None and new is not None and old.text != new.text
    return comparison.differs or rewritten


def _is_invalid(version: Side | None) -> bool:
    return version is not None and version.spec is None


def _since_valid(
    root: Path, fixing: Commit, new: Side, names: Sequence[str], earlier: Sequence[Commit], folder: Path, verbose: bool
) -> HistoryEntry:
    """Compare a version that is valid again with the last version that was valid."""
    for k, each in enumerate(earlier[:MAX_INVALID]):
        try:
            git(root, "merge-base", "--is-ancestor", each.id, fixing.id)
        except GitError:  # on another branch
            continue
        old = side_at(root, each.id, names, folder / f"valid{k}")
        if old is not None and old.spec is not None:
            note = f"valid again; the last valid version is that of {each.id[:10]}:"
            return HistoryEntry(fixing, compare(names[0], old, new, verbose), note)
    return HistoryEntry(fixing, compare(names[0], None, new, verbose), "valid for the first time")


def uncommitted(root: Path, head: str, path: str, verbose: bool = False) -> tuple[list[str], HistoryEntry | None]:
    """Compare the document in the working tree with the last commit, if there is one.

    Returns:
        The names of the document, and the entry, or None if nothing changed.
    """
    file, here = root / path, Path.cwd()
    label = str(file.relative_to(here) if file.is_relative_to(here) else file)
    with tempfile.TemporaryDirectory(prefix="simfoundry-") as folder:
        names = [path]
        if head:
            former = (pair.old for pair in renames_between(root, head) if pair.new == path != pair.old and pair.old)
            names += former
        old = side_at(root, head, names, Path(folder)) if head else None
        new = side(file, label) if file.is_file() else None
        if old is None and new is None:
            return names, None
        comparison = compare(path, old, new, verbose)
        told = _is_told(comparison, verbose)
        if old is not None and new is not None and _is_invalid(old) and _is_invalid(new):
            told = old.text != new.text
        return names, HistoryEntry(None, comparison) if told else None


def side_at(root: Path, revision: str, names: Sequence[str], folder: Path, label: str = "") -> Side | None:
    """Read the document from a commit, using the first of its names that exists there."""
    with files_of(root, revision) as read:
        found = ((name, export(read, name, folder)) for name in names)
        sides = (side(path, label or f"{revision[:10]}:{name}", folder) for name, path in found if path is not None)
        return next(sides, None)


def _trace(root: Path, revisions: Sequence[str], known: Sequence[str]) -> tuple[list[str], list[Commit]]:
    """Return all names that a document has had, and every commit that changed it or a file that it refers to."""
    names, paths, read_already = list(known), set(known), set[str]()
    while True:
        commits = list(_listed(root, revisions, sorted(paths)))
        count = len(paths)
        for each in commits:
            if each.id in read_already:
                continue
            read_already.add(each.id)
            with files_of(root, each.id) as read:
                present = next((name for name in names if read(name) is not None), None)
                paths |= (
                    {name for name, _ in referenced_files(read, present, ".yaml")} if present is not None else set()
                )
            former = _former_name(root, each, present) if present is not None else None
            if former is not None and former not in names:
                names.append(former)
                paths.add(former)
        if len(paths) == count:
            return names, commits


def _listed(root: Path, revisions: Sequence[str], paths: Sequence[str]) -> Iterator[Commit]:
    """Yield the commits that change one of the paths, newest first."""
    options = ["--full-history", "--date-order", f"--format={_FORMAT}"]
    found = git(root, "--literal-pathspecs", "rev-list", *options, *revisions, "--", *paths)
    for line in found.decode(errors="replace").splitlines():
        if "\0" in line:  # other lines are headers
            id_, parents, date, author, subject = line.split("\0", 4)
            yield Commit(id_, tuple(parents.split()), date, author, subject)


def _former_name(root: Path, renaming: Commit, path: str) -> str | None:
    """Return the name of a document before the commit that renamed it to ``path``."""
    if not renaming.parents:
        return None
    parent = renaming.parents[0]
    with files_of(root, parent) as read:
        if read(path) is not None:
            return None
    return next((pair.old for pair in renames_between(root, parent, renaming.id) if pair.new == path), None)
