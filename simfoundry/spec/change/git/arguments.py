"""Interpret the arguments of ``diff`` and ``log``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from simfoundry.errors import SimfoundryError
from simfoundry.spec.change.compare import DocumentComparison, Side, compare, side
from simfoundry.spec.change.git.history import HistoryEntry, history, side_at, uncommitted
from simfoundry.spec.change.git.revisions import GitError, commit, differing, git, repository


class ArgumentError(SimfoundryError):
    """Raised if the arguments do not specify two states to compare."""


@dataclass(frozen=True)
class DocumentState:
    """A state of a document.

    The state is a file on disk or, if ``commit`` is set, a file in that commit of the repository at ``root``.
    """

    path: str
    label: str
    root: Path | None = None
    commit: str = ""


@dataclass(frozen=True)
class Pair:
    """Two states of a document to compare. A state is None if the document does not exist in it.

    ``was`` is the former path of a renamed document, or an empty string.
    """

    name: str
    old: DocumentState | None
    new: DocumentState | None
    was: str = ""


@dataclass(frozen=True)
class _Span:
    """A range of revisions as entered by the user. If ``new`` is empty, the range extends to the working tree.

    ``commits`` contains the hashes of both ends. The second hash is empty for the working tree.
    """

    old: str
    new: str
    commits: tuple[str, str]


def pairs(arguments: Sequence[str]) -> list[Pair]:
    """Return the pairs of states to compare.

    Raises:
        ArgumentError: If the arguments are invalid.
        GitError: If a git command fails.
    """
    if len(arguments) == 2 and all(_is_state(a) for a in arguments):
        old, new = (_state(a) for a in arguments)
        return [Pair(new.label, old, new)]
    files = [a for a in arguments if _is_file(a)]
    revisions = [a for a in arguments if not _is_file(a)]
    if len(revisions) > 2 or any(_is_file(a) for a in arguments[: len(revisions)]):
        raise ArgumentError("give two files, or one or two revisions followed by files")
    if not files:
        root = repository(Path.cwd())
        return list(_below(_span(root, revisions or ["HEAD"]), root, root))
    return [pair for f in files for pair in _of_file(Path(f), revisions or ["HEAD"])]


def document_history(arguments: Sequence[str], verbose: bool = False) -> Iterator[HistoryEntry]:
    """Yield the commits that changed a document, after the uncommitted changes, if there are any.

    The arguments are ``FILE``, ``REVISION FILE`` or ``A..B FILE``. With a revision, only commits are listed.
    """
    *revisions, file = arguments or [""]
    if not file or len(revisions) > 1:
        raise ArgumentError("give one document, optionally after a revision or a range: main..feature a.scene.yaml")
    if Path(file).is_dir():
        raise ArgumentError(f"{file} is a folder; give one document")
    root, inside = _inside(Path(file))
    if not revisions:
        return _latest(root, inside, verbose)
    if ".." not in revisions[0]:
        return history(root, [commit(root, revisions[0])], [inside], verbose)
    old, new = _span(root, revisions).commits
    return history(root, [f"^{old}", new], [inside], verbose)


def _latest(root: Path, inside: str, verbose: bool) -> Iterator[HistoryEntry]:
    """Yield the uncommitted changes to a document and the commits of the current branch that changed it."""
    try:
        head = commit(root, "HEAD")
    except GitError:  # the branch has no commits yet
        head = ""
    names, entry = uncommitted(root, head, inside, verbose)
    if entry is not None:
        yield entry
    if head:
        yield from history(root, [head], names, verbose)


def open_pair(pair: Pair, folder: Path, verbose: bool = False) -> DocumentComparison:
    """Read and compare both states. Documents from revisions are written to ``folder``, which must be empty."""
    old, new = (_open(source, folder / k) for source, k in ((pair.old, "old"), (pair.new, "new")))
    if old is None and new is None:
        label = (pair.new or pair.old or DocumentState("", pair.name)).label
        raise ArgumentError(f"there is no document {label}")
    return replace(compare(pair.name, old, new, verbose), was=pair.was)


def _open(source: DocumentState | None, folder: Path) -> Side | None:
    if source is None:
        return None
    if source.root is None:
        path = Path(source.path)
        return side(path, source.label) if path.exists() else None
    return side_at(source.root, source.commit, [source.path], folder, source.label)


def _is_state(argument: str) -> bool:
    """Return True if an argument alone specifies one state of one document."""
    return Path(argument).is_file() or _is_rev_path(argument)


def _is_rev_path(argument: str) -> bool:
    revision, colon, path = argument.partition(":")
    return bool(revision and colon and path) and not Path(argument).exists()


def _is_file(argument: str) -> bool:
    """Return True if an argument is an existing path, or if it looks like the name of a deleted document."""
    return Path(argument).exists() or (argument.endswith(".yaml") and ":" not in argument)


def _state(argument: str) -> DocumentState:
    if not _is_rev_path(argument):
        return DocumentState(argument, argument)
    revision, _, path = argument.partition(":")
    root = repository(Path.cwd())
    if path.startswith(("./", "../")):  # git treats only these paths as relative to the working folder
        _, path = _inside(Path(path))
    return DocumentState(path, argument, root, commit(root, revision))


def _span(root: Path, revisions: Sequence[str]) -> _Span:
    """Resolve ``A``, ``A B``, ``A..B`` (an empty end is HEAD) or ``A...B`` (from the merge base to B)."""
    dots = "..." if "..." in revisions[0] else ".."
    old, separator, new = revisions[0].partition(dots) if len(revisions) == 1 else (revisions[0], "", revisions[1])
    old, new = old or "HEAD", new or ("HEAD" if separator else "")
    commits = (commit(root, old), commit(root, new) if new else "")
    if separator == "...":
        base = git(root, "merge-base", *commits).decode().strip()
        return _Span(base[:10], new, (base, commits[1]))
    return _Span(old, new, commits)


def _of_file(path: Path, revisions: Sequence[str]) -> Iterator[Pair]:
    """Yield the two states of a document, or of each document in a folder that differs between them."""
    root, inside = _inside(path)
    span = _span(root, revisions)
    if path.is_dir():
        yield from _below(span, root, path.resolve())
    else:
        yield _pair(span, root, inside, inside, str(path))


def _inside(path: Path) -> tuple[Path, str]:
    """Return the repository that contains a file or folder, and the path within that repository."""
    folder = path if path.is_dir() else path.parent
    while not folder.is_dir():  # the folder may have been deleted in a later revision
        folder = folder.parent
    root = repository(folder)
    try:
        return root, (path.parent.resolve() / path.name).relative_to(root).as_posix()
    except ValueError:
        raise ArgumentError(f"{path} is not in the repository {root}") from None


def _below(span: _Span, root: Path, folder: Path) -> Iterator[Pair]:
    """Yield the two states of each document that is below a folder and differs between the two states."""
    below = "" if folder == root else folder.relative_to(root).as_posix()
    for found in differing(root, span.commits[0], span.commits[1] or None, below):
        pair = _pair(span, root, found.old, found.new, found.new or found.old or "")
        yield replace(pair, was=found.old if found.old and found.new and found.old != found.new else "")


def _pair(span: _Span, root: Path, old: str | None, new: str | None, name: str) -> Pair:
    before = DocumentState(old, f"{span.old}:{old}", root, span.commits[0]) if old is not None else None
    if new is None:
        return Pair(name, before, None)
    if span.new:
        return Pair(name, before, DocumentState(new, f"{span.new}:{new}", root, span.commits[1]))
    file, here = root / new, Path.cwd()
    label = file.relative_to(here) if file.is_relative_to(here) else file
    return Pair(name, before, DocumentState(str(file), str(label)))
