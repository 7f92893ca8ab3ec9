"""Plan a rename for a whole project: which documents to read, what to write, and what to tell the user."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from types import MappingProxyType

from simfoundry.spec.diagnostics import Severity, SpecError
from simfoundry.spec.models.kinds import is_document
from simfoundry.spec.names.linked import ANY_SCENE
from simfoundry.spec.names.mentions import VARIED_SECTIONS
from simfoundry.spec.names.project import ProjectNames
from simfoundry.spec.names.rename import (
    MAX_SHOWN,
    DocumentEdit,
    RenameError,
    find_symbol,
    new_findings,
    remaining_lines,
    rename_edits,
    shown_path,
)
from simfoundry.spec.names.symbols import Symbol
from simfoundry.spec.project import DocumentFiles, document_files, find_project, is_shared, project_root
from simfoundry.spec.yaml.text import Document, parse, read

# Maximum number of documents in a project that is searched; a batch of cousins has 10,000.
MAX_DOCUMENTS = 50_000

# Name of a document in a text, as far as it contains neither spaces nor characters with a meaning in YAML.
_FILE_NAME = re.compile(rb"[^\s/\"':,\[\]{}]+\.yaml\b")


@dataclass(frozen=True)
class RenamePlan:
    """A rename that is possible.

    Attributes:
        symbol: What is renamed.
        new: Its new name.
        edits: The edits of each document.
        notes: Whole sentences about what the rename does not change.
    """

    symbol: Symbol
    new: str
    edits: tuple[DocumentEdit, ...]
    notes: tuple[str, ...]


def plan_rename(
    file: Path, written: str, new: str, kind: str = "", texts: Mapping[str, str] = MappingProxyType({})
) -> RenamePlan:
    """Plan the rename of a symbol in all documents of the project of a document.

    These are the documents below the project's folder that commands on folders read, and those that they use. Nothing
    is written.

    Args:
        file: A document in which the symbol has the name.
        written: The name; see :func:`simfoundry.spec.names.rename.find_symbol`.
        new: The new name.
        kind: The kind of the symbol if several have the name; otherwise empty.
        texts: Texts of documents that are open in an editor, by resolved path, which replace the files.

    Raises:
        RenameError: If the symbol is not found, or if the rename is not possible; nothing would be written.
        SpecError: If the document cannot be read.
    """
    project = _Project(project_root(file).resolve(), written.rpartition(".")[2], texts)
    names = project.names({os.path.realpath(file)})
    if (error := names.unreadable.get(os.path.realpath(file))) is not None:
        raise SpecError([error.diagnostic(str(file))])
    files = {os.path.realpath(file), *(path for path, data in project.contents.items() if project.word in data)}
    while True:  # a document that uses an edited one may give a name another meaning
        names = project.names(files)
        symbol = find_symbol(names, file, written, kind)
        project.ensure_readable(names, f"cannot rename {symbol} to `{new}`")
        edits = rename_edits(names, symbol, new)
        users = project.users(str(edit.file) for edit in edits)
        if users <= files:
            break
        files |= users
    findings = new_findings(names, edits)
    if errors := findings[Severity.ERROR]:
        raise RenameError(f"cannot rename {symbol} to `{new}`, because `check` would find new errors", errors)
    notes = [*_notes(project, names, symbol, new, edits)]
    if warnings := findings[Severity.WARNING]:
        notes.append(f"`check` will have new warnings:{_list(warnings)}")
    return RenamePlan(symbol, new, edits, tuple(notes))


@dataclass
class _Project:
    """The documents of a project. Each is read only once."""

    root: Path
    old: str
    texts: Mapping[str, str]
    parsed: dict[Path, Document] = field(default_factory=dict)

    def __post_init__(self) -> None:
        # Without a project, the files beside the document may be those of a home folder, with everything below it.
        alone = find_project(self.root) is None and is_shared(self.root)
        found = (
            DocumentFiles([*filter(is_document, sorted(self.root.iterdir()))], [])
            if alone
            else document_files(self.root)
        )
        if len(found.included) > MAX_DOCUMENTS:
            reason = f"the project {self.root} has more than {MAX_DOCUMENTS} documents"
            raise RenameError(f"cannot rename `{self.old}`", [reason])
        self.word = self.old.encode()
        self.contents = _contents(found.included) | {file: text.encode() for file, text in self.texts.items()}
        self.foreign = [path for path in found.included if not Path(os.path.realpath(path)).is_relative_to(self.root)]
        self.excluded = _contents(found.excluded)

    def read(self, path: Path) -> Document:
        """Read a document that has not been joined with others, because joining changes its nodes."""
        if path not in self.parsed:
            text = self.texts.get(os.path.realpath(path))
            self.parsed[path] = read(path) if text is None else parse(text, str(path))
        return self.parsed[path]

    def names(self, files: set[str]) -> ProjectNames:
        """Return the names in some documents, and in those that they use."""
        return ProjectNames(self.root, [Path(file) for file in sorted(files)], self.read)

    def ensure_readable(self, names: ProjectNames, what: str) -> None:
        """Raise an error if a document that contains the old name cannot be parsed or edited."""
        broken = [
            (file, error) for file, error in names.unreadable.items() if self.word in self.contents.get(file, b"")
        ]
        reasons = [
            f"{shown_path(file)}:{error.line}:{error.column}: this document contains `{self.old}`, but it cannot be "
            f"parsed ({error.message}); correct it first"
            for file, error in broken
        ]
        reasons += [
            f"{shown_path(path)}: this document contains `{self.old}`, but it is a link out of the project; "
            "replace it with a copy, or exclude it in `simfoundry.yaml`"
            for path in self.foreign
            if self.word in self.contents.get(os.path.realpath(path), b"")
        ]
        if reasons:
            raise RenameError(what, reasons)

    def users(self, files: Iterable[str]) -> set[str]:
        """Return the documents that may use some documents, directly or by others, by the file names in their texts."""
        named = {path: {*_FILE_NAME.findall(data)} for path, data in self.contents.items()}
        found = set(files)
        while True:
            keys = {key for file in found for key in _FILE_NAME.findall(os.fsencode(Path(file).name))[-1:]}
            more = {path for path, mentioned in named.items() if path not in found and mentioned & keys}
            if not more:
                return {file for file in found if file in self.contents}
            found |= more


def _contents(files: Iterable[Path]) -> dict[str, bytes]:
    """Return the bytes of files by resolved path, omitting those that cannot be read, which `check` reports."""
    found: dict[str, bytes] = {}
    for file in files:
        try:
            found[os.path.realpath(file)] = file.read_bytes()
        except OSError:
            continue
    return found


def _notes(
    project: _Project, names: ProjectNames, symbol: Symbol, new: str, edits: tuple[DocumentEdit, ...]
) -> Iterable[str]:
    """Yield what a rename does not change, although a user may expect it, and what else it changes."""
    if symbol.kind == "object" and _is_category(names, symbol):
        yield (
            f"the category of the object was its name, and is now `{new}`; "
            f"to keep the old one, add `category: {symbol.name}`"
        )
    edited = {str(edit.file) for edit in edits}
    others = [
        f"{shown_path(o.file)}:{o.line}:{o.column}"
        for names_of in names.documents.values()
        if names_of.kind in ANY_SCENE and symbol.kind == "camera"
        for o in names.occurrences(names_of.file)
        if o.symbol is None and o.name == symbol.name
    ]
    if others:
        yield f"these documents name a camera that several scenes have, and stay as they are:{_list(others)}"
    if patterns := [*_changed_patterns(names, symbol, new, edits)]:
        yield f"these patterns match only one of the two names, and stay as they are:{_list(patterns)}"
    if lines := remaining_lines(names, edits, symbol.name):
        yield f"these lines still contain the word `{symbol.name}`:{_list(lines)}"
    word = re.compile(rb"(?<![A-Za-z0-9_])" + re.escape(symbol.name.encode()) + rb"(?![A-Za-z0-9_])")
    skipped = [shown_path(file) for file, data in project.excluded.items() if file not in edited and word.search(data)]
    if skipped:
        yield f"these documents contain the word but are excluded from the project's commands:{_list(skipped)}"


def _changed_patterns(names: ProjectNames, symbol: Symbol, new: str, edits: tuple[DocumentEdit, ...]) -> Iterable[str]:
    """Yield the patterns of recipes, such as `camera.left_*.pose`, that stand for other values after a rename."""
    for file in sorted({user for edit in edits for user in names.dependents(edit.file)}):
        document = names.documents[file]
        for key in document.section("vary") if document.kind == "cousins" else ():
            head, *rest = key.split(".")
            section, word = (VARIED_SECTIONS[head], rest[0]) if head in VARIED_SECTIONS and rest else ("objects", head)
            is_changed = fnmatchcase(symbol.name, word) != fnmatchcase(new, word)
            if "*" in word and symbol.section == (section,) and is_changed:
                yield f"{shown_path(file)}: {key}"


def _list(lines: list[str]) -> str:
    more = [f"and {len(lines) - MAX_SHOWN} more"] if len(lines) > MAX_SHOWN else []
    return "".join(f"\n  {line}" for line in [*lines[:MAX_SHOWN], *more])


def _is_category(names: ProjectNames, symbol: Symbol) -> bool:
    """Return True if an object has no category of its own, so that its name is the category."""
    members = (names.documents[o.file].member(o.path) for o in names.references(symbol) if o.is_key)
    stated = {key for member in members if isinstance(member, dict) for key in member}
    return "shape" in stated and not stated & {"category", "asset", "like"}
