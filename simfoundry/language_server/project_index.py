"""The names of all documents of a project, kept up to date with the texts that the editor shows."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from simfoundry.runtime.file_changes import Stamp
from simfoundry.spec.diagnostics import Severity, SpecError
from simfoundry.spec.names.mentions import DocumentNames
from simfoundry.spec.names.project import ProjectNames
from simfoundry.spec.names.rename import DocumentEdit, RenameError, new_findings, rename_edits, shown_path
from simfoundry.spec.open_documents import OpenDocuments
from simfoundry.spec.project import document_files
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import Document


class ProjectIndex:
    """The documents of one project folder.

    A document that cannot be parsed at the moment keeps the names that it had before; ``broken`` lists such documents.
    """

    def __init__(self, root: Path, documents: OpenDocuments) -> None:
        self.root, self._documents = root, documents
        self.broken: dict[str, YamlError] = {}
        self._files: Sequence[Path] | None = None
        self._parsed: dict[str, tuple[Stamp, Document]] = {}
        self._cache: dict[str, tuple[Document, DocumentNames]] = {}
        self._names: tuple[dict[str, Stamp], ProjectNames] | None = None

    def rescan(self) -> None:
        """Look for documents on disk again when the names are next needed."""
        self._files = None

    def names(self) -> ProjectNames:
        """Return the names of the project, from the texts at this moment."""
        return self._current("") or self._read_all()

    def dependents(self, file: str) -> frozenset[str]:
        """Return the documents that use a document, given and returned by their resolved paths."""
        return (self._current(file) or self._read_all()).dependents(file)

    def rename(self, file: Path, offset: int, new: str) -> tuple[DocumentEdit, ...]:
        """Return the edits that rename what is named at an offset of a document, in all documents of the project.

        Raises:
            RenameError: If nothing with a name of its own is there, if the new name is not possible, or if a document
                cannot be parsed.
        """
        names = self.names()
        found = names.at(file, offset)
        if found is None or found.symbol is None:
            raise RenameError("cannot rename", ["nothing that documents define is named here"])
        what = f"cannot rename {found.symbol} to `{new}`"
        if self.broken:
            raise RenameError(what, [f"{shown_path(path)}: {error}" for path, error in sorted(self.broken.items())])
        edits = rename_edits(names, found.symbol, new)
        if errors := new_findings(names, edits, self._documents.read)[Severity.ERROR]:
            raise RenameError(f"{what}, because `check` would find new errors", errors)
        return edits

    def _current(self, edited: str) -> ProjectNames | None:
        """Return the names that were read last, if no document has changed since, except perhaps the given one."""
        if self._files is None or self._names is None:
            return None
        stamps, names = self._names
        if not self._opened() <= stamps.keys():
            return None
        changed = (file for file, stamp in stamps.items() if self._documents.stamp(Path(file)) != stamp)
        return names if all(file == edited for file in changed) else None

    def _read_all(self) -> ProjectNames:
        if self._files is None:
            try:
                self._files = document_files(self.root).included
            except SpecError:  # the marker file of the project is broken
                self._files = []
        self.broken = {}
        files = {*map(os.path.realpath, self._files), *self._opened()}
        names = ProjectNames(self.root, sorted(map(Path, files)), self._read, self._cache)
        read = {*files, *names.documents, *names.unreadable}
        self._names = {file: self._documents.stamp(Path(file)) for file in read}, names
        for cache in (self._cache, self._parsed):
            for file in cache.keys() - read:
                del cache[file]
        return names

    def _opened(self) -> set[str]:
        """Return the open documents of the project, which may not have been saved yet."""
        root = self.root.resolve()
        return {file for file in self._documents.files if Path(file).is_relative_to(root)}

    def _read(self, path: Path) -> Document:
        file, stamp = os.path.realpath(path), self._documents.stamp(path)
        known = self._parsed.get(file)
        if known is not None and known[0] == stamp:
            return known[1]
        try:
            document = self._documents.read(path)
        except YamlError as error:
            self.broken[file] = error
            if known is None:
                raise
            return known[1]
        self._parsed[file] = stamp, document
        return document
