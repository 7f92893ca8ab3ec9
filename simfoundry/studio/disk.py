"""Files of a session on disk: their states, and the merge of their changes with edits that are not saved yet."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simfoundry.errors import SimfoundryError
from simfoundry.spec.change.diff.changes import copied
from simfoundry.spec.change.edit_text import edit_text
from simfoundry.spec.change.merge.conflict import CONFLICTS, MergeConflict, dotted, shown
from simfoundry.spec.change.merge.texts import UnmergeableError, resolve
from simfoundry.spec.change.merge.trees import merge_trees, model_in
from simfoundry.spec.diagnostics import Diagnostic, Severity, SpecError
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import MAX_BYTES, parse
from simfoundry.spec.yaml.tree import KIND, YamlTree, read_tree, with_data

# How bytes that are not UTF-8 are kept: as they are, so that saving does not change them.
_ERRORS = "surrogateescape"


@dataclass(frozen=True)
class DiskFile:
    """The content of a file when it was last read or written here.

    ``stamp`` identifies the state of the file: its inode, size and time of change. It is empty if there is no file.
    """

    path: Path
    data: bytes
    stamp: tuple[int, ...]

    @classmethod
    def read(cls, path: Path) -> DiskFile:
        """Read a file.

        Raises:
            SimfoundryError: If it cannot be read, is not a regular file, or is too large for a document.
        """
        stamp = file_stamp(path)  # before the content, so that a change meanwhile is noticed
        try:
            if not path.is_file():  # a folder, or a pipe, which nobody may ever write to
                raise SimfoundryError(f"{path} is not a file")
            with path.open("rb") as stream:
                data = stream.read(MAX_BYTES + 1)
        except OSError as error:
            raise SimfoundryError(f"{path} could not be read: {error.strerror or error}") from None
        if len(data) > MAX_BYTES:
            raise SimfoundryError(f"{path} is larger than {MAX_BYTES >> 20} MiB, the limit for documents")
        return cls(path, data, stamp)

    @property
    def text(self) -> str:
        """The content as text, from which :func:`encoded` returns the same bytes."""
        return self.data.decode("utf-8", _ERRORS)

    def has_changed(self) -> bool:
        """Return True if the file exists and is in another state than when it was read."""
        stamp = file_stamp(self.path)
        return bool(stamp) and stamp != self.stamp


def encoded(text: str) -> bytes:
    """Return the bytes of a text to be saved."""
    return text.encode("utf-8", _ERRORS)


def file_stamp(path: Path) -> tuple[int, ...]:
    """Return what identifies the state of a file, or an empty tuple if there is no file."""
    try:
        found = path.stat()
    except OSError:
        return ()
    return found.st_ino, found.st_size, found.st_mtime_ns


@dataclass(frozen=True)
class DiskQuestion:
    """A value that was edited differently here and on disk. The document has the value of this session."""

    path: Path
    conflict: MergeConflict

    @property
    def label(self) -> str:
        """Return the path of the value, such as ``objects.mug.mass``."""
        return dotted(self.conflict.path)

    def __str__(self) -> str:
        here, there, was = map(shown, (self.conflict.ours, self.conflict.theirs, self.conflict.base))
        return f"{self.label}: here {here}, on disk {there}, before {was}"


@dataclass(frozen=True)
class DiskChanges:
    """The state of a session after it has taken in the changes of its files.

    Attributes:
        files: What the files contain.
        texts: The texts, merged with the changes.
        held: Findings about files whose changes cannot be taken in.
        questions: The conflicts that a person has to decide.
    """

    files: Mapping[Path, DiskFile]
    texts: Mapping[Path, str]
    held: Mapping[Path, Diagnostic]
    questions: tuple[DiskQuestion, ...]


def taken_in(
    files: Mapping[Path, DiskFile],
    texts: Mapping[Path, str],
    held: Mapping[Path, Diagnostic],
    questions: tuple[DiskQuestion, ...],
) -> DiskChanges:
    """Take in the changes of all files; the arguments are the present state, as in :class:`DiskChanges`."""
    new_files, new_texts, new_held = dict(files), dict(texts), dict(held)
    for path, before in files.items():
        try:
            file = DiskFile.read(path) if before.has_changed() else before
        except SimfoundryError as error:
            new_held[path] = Diagnostic(
                "SF002", Severity.ERROR, f"the change on disk cannot be shown: {error}", str(path)
            )
            continue
        if file.data != before.data:
            try:
                new_texts[path], asked = merged_with_disk(path, before.text, texts[path], file.text)
            except UnmergeableError as error:
                new_held[path] = Diagnostic("SF002", Severity.ERROR, f"the file on disk {error}", str(path))
                continue
            questions = (*(q for q in questions if q.path != path), *asked)
        new_files[path] = file
        new_held.pop(path, None)
    return DiskChanges(new_files, new_texts, new_held, questions)


def merged_with_disk(path: Path, base: str, ours: str, theirs: str) -> tuple[str, tuple[DiskQuestion, ...]]:
    """Merge the edits of a session with those of a file.

    Args:
        path: The document.
        base: The text that both started from.
        ours: The text of the session.
        theirs: The text of the file.

    Returns:
        The file's text with the edits of the session, which keep its layout and comments, and the conflicts. Where
        both edited the same value, the text has that of the session.

    Raises:
        UnmergeableError: If a text with edits is not a document, so that only one of both could be kept.
    """
    if ours in (base, theirs):
        return theirs, ()
    trees = [_tree(text) for text in (base, ours, theirs)]
    if len({str(tree.value[KIND].data) for tree in trees if KIND in tree.value}) > 1:
        raise UnmergeableError("is a document of another kind")
    merged = merge_trees(trees[0], trees[1], trees[2])
    data = copied(merged.data)
    if merged.conflicts:
        known = trees[1].data.get(CONFLICTS)
        data = {key: value for key, value in data.items() if key != CONFLICTS}
        data |= {} if known is None else {CONFLICTS: known}
    text = _line_merge(base, ours, theirs)  # keeps comments at names that changed here
    if merged.conflicts or text is None or not _says(text, data):
        text = edit_text(theirs, data, model_in(trees[1]))
    return text, tuple(DiskQuestion(path, conflict) for conflict in merged.conflicts)


def _line_merge(base: str, ours: str, theirs: str) -> str | None:
    """Return a text with the changed lines of two texts, or None if changes of both touch each other."""
    lines = base.splitlines(keepends=True)

    def changes(text: str) -> list[tuple[int, int, list[str]]]:
        new = text.splitlines(keepends=True)
        found = difflib.SequenceMatcher(None, lines, new, autojunk=False).get_opcodes()
        return [(i, j, new[k:m]) for kind, i, j, k, m in found if kind != "equal"]

    mine, other = changes(ours), changes(theirs)
    if any(i <= n and m <= j for i, j, _ in mine for m, n, _ in other):
        return None
    for i, j, new in sorted([*mine, *other], key=lambda change: change[:2], reverse=True):
        lines[i:j] = new
    return "".join(lines)


def _says(text: str, data: Any) -> bool:
    try:
        return bool(_tree(text).data == data)
    except UnmergeableError:
        return False


def answered(text: str, question: DiskQuestion) -> str:
    """Return a text with the value of the file in place of that of the session.

    Raises:
        SimfoundryError: If what contains the value no longer exists.
    """
    tree = read_tree(parse(text))
    data: dict[str, Any] = copied(tree.data)
    key = dotted(question.conflict.path)
    data[CONFLICTS] = {**(data.get(CONFLICTS) or {}), key: question.conflict.record()}
    resolved, _ = resolve(with_data(tree, data), model_in(tree), "theirs", [key])
    return edit_text(text, resolved.data, model_in(tree))


def _tree(text: str) -> YamlTree:
    try:
        tree = read_tree(parse(text))
    except (YamlError, SpecError) as error:
        first = error.diagnostics[0] if isinstance(error, SpecError) else error
        raise UnmergeableError(f"could not be parsed: line {first.line}: {first.message}") from None
    if not isinstance(tree.value, dict):
        raise UnmergeableError("is not a document")
    return tree
