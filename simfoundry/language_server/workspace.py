"""The documents that an editor has open, and what is known about each document of the project."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from lsprotocol import types
from pygls import uris

from simfoundry.language_server.analysis import Analysis
from simfoundry.language_server.positions import Lines
from simfoundry.language_server.project_index import ProjectIndex
from simfoundry.spec.check.report import absolute
from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.spec.models.kinds import is_document
from simfoundry.spec.names.project import ProjectNames
from simfoundry.spec.open_documents import OpenDocuments
from simfoundry.spec.project import project_root
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import read_text


@dataclass(frozen=True)
class Buffer:
    """A document that is open in the editor, with the text that the editor shows.

    ``uri`` is spelled as the editor spells it. ``path`` is the file; for a document that has not been saved yet, it is
    a file that does not exist.
    """

    uri: str
    path: Path
    version: int
    lines: Lines


@dataclass
class _Known:
    """The analyses of one document: the latest one, and the latest ones that can still answer requests.

    Attributes:
        latest: The latest analysis.
        parsed: The latest analysis of a text that could be parsed.
        lowered: The latest analysis with a lowered scene.
    """

    latest: Analysis
    parsed: Analysis | None = None
    lowered: Analysis | None = None


@dataclass
class Workspace:
    """Open documents by URI, and analyses by file.

    ``texts`` loads documents with the texts of the open ones in place of their files.
    """

    encoding: str = types.PositionEncodingKind.Utf16
    buffers: dict[str, Buffer] = field(default_factory=dict)
    texts: OpenDocuments = field(default_factory=OpenDocuments)
    _projects: dict[Path, ProjectIndex] = field(default_factory=dict)
    _known: dict[Path, _Known] = field(default_factory=dict)
    _findings: dict[Path, dict[Path, list[Diagnostic]]] = field(default_factory=dict)

    # -- texts ------------------------------------------------------------------------------------------------------

    def open(self, uri: str, text: str, version: int) -> Buffer:
        """Add a document that the editor has opened."""
        return self._show(Buffer(uri, path_of(uri), version, Lines(text, self.encoding)))

    def change(self, uri: str, changes: Iterable[types.TextDocumentContentChangeEvent], version: int) -> Buffer | None:
        """Apply the changes of the editor to an open document, and return it, or None if it is not open."""
        buffer = self.buffers.get(uri)
        if buffer is None:
            return None
        lines = buffer.lines
        for change in changes:
            text = change.text
            if isinstance(change, types.TextDocumentContentChangePartial):
                start, end = lines.span(change.range)
                text = lines.text[:start] + text + lines.text[end:]
            lines = Lines(text, self.encoding)
        return self._show(Buffer(uri, buffer.path, version, lines))

    def close(self, uri: str) -> Buffer | None:
        """Remove a document that the editor has closed, and return it, or None if it was not open."""
        buffer = self.buffers.pop(uri, None)
        if buffer is not None:
            self.texts.edit(buffer.path, None)
        return buffer

    def _show(self, buffer: Buffer) -> Buffer:
        self.buffers[buffer.uri] = buffer
        self.texts.edit(buffer.path, buffer.lines.text)
        return buffer

    def buffer_of(self, path: Path) -> Buffer | None:
        """Return the open document of a file."""
        return next((buffer for buffer in self.buffers.values() if buffer.path == path), None)

    def lines(self, path: Path) -> Lines | None:
        """Return the text of a file, as the editor shows it, or None if it can neither be shown nor read."""
        buffer = self.buffer_of(path)
        if buffer is not None:
            return buffer.lines
        try:
            return Lines(read_text(path), self.encoding)
        except YamlError:
            return None

    def uri(self, path: Path) -> str:
        """Return the URI of a file, spelled as the editor does if the file is open."""
        buffer = self.buffer_of(path)
        return buffer.uri if buffer is not None else path.as_uri()

    # -- analyses ---------------------------------------------------------------------------------------------------

    def store(self, analysis: Analysis) -> None:
        """Keep an analysis as the latest one of its document."""
        known = self._known.setdefault(analysis.path, _Known(analysis))
        known.latest = analysis
        if analysis.source is not None:
            known.parsed = analysis
        if analysis.draft is not None:
            known.lowered = analysis

    def forget(self, path: Path) -> None:
        """Remove the analyses of a document."""
        self._known.pop(path, None)

    def latest(self, path: Path) -> Analysis | None:
        """Return the latest analysis of a document."""
        known = self._known.get(path)
        return known.latest if known is not None else None

    def parsed(self, path: Path) -> Analysis | None:
        """Return the latest analysis of a text of the document that could be parsed. It may be older than the text."""
        known = self._known.get(path)
        return known.parsed if known is not None else None

    def lowered(self, path: Path) -> Analysis | None:
        """Return the latest analysis of the document with a lowered scene. It may be older than the text."""
        known = self._known.get(path)
        return known.lowered if known is not None else None

    def analyzed_files(self) -> set[Path]:
        """Return the documents that have an analysis."""
        return {*self._known}

    # -- names ------------------------------------------------------------------------------------------------------

    def names(self, path: Path) -> ProjectNames:
        """Return the names of the project that contains a document. Called on the thread that looks up names."""
        return self.project(path).names()

    def project(self, path: Path) -> ProjectIndex:
        """Return the project that contains a document."""
        root = project_root(path)
        if root not in self._projects:
            self._projects[root] = ProjectIndex(root, self.texts)
        return self._projects[root]

    def folders(self) -> set[Path]:
        """Return the folders of the projects that contain open documents."""
        return {project_root(buffer.path) for buffer in self.buffers.values()}

    def rescan(self) -> None:
        """Look for new and removed documents on disk when the names of a project are next needed."""
        for project in self._projects.values():
            project.rescan()

    def dependents(self, path: Path) -> frozenset[Path]:
        """Return the documents that use a document, directly or indirectly."""
        return frozenset(map(self.shown, self.project(path).dependents(os.path.realpath(path))))

    def shown(self, file: str) -> Path:
        """Return the path under which the editor knows a file, given its resolved path."""
        same = (buffer.path for buffer in self.buffers.values() if os.path.realpath(buffer.path) == file)
        return next(same, Path(file))

    def location(self, file: str, start: int, end: int) -> types.Location:
        """Return the location of the characters between two offsets of a document, given by its resolved path."""
        path = self.shown(file)
        lines = self.lines(path) or Lines("", self.encoding)
        return types.Location(self.uri(path), lines.range(start, end))

    # -- findings ---------------------------------------------------------------------------------------------------

    def report(self, path: Path, findings: Iterable[Diagnostic]) -> set[Path]:
        """Replace the findings of one document's analysis, and return the files whose findings may have changed."""
        by_file: dict[Path, list[Diagnostic]] = {}
        for finding in findings:
            by_file.setdefault(absolute(finding.document), []).append(finding)
        before = self._findings.pop(path, {})
        if by_file:
            self._findings[path] = by_file
        return {path, *before, *by_file}

    def drop_outdated(self, file: Path) -> None:
        """Remove what documents that use a file found in its earlier text. They find it again when they are checked."""
        for user, found in self._findings.items():
            if user != file:
                found.pop(file, None)

    def findings(self, file: Path) -> Iterator[Diagnostic]:
        """Yield the findings in a file, from all documents that use it."""
        for found in self._findings.values():
            yield from found.get(file, ())


# Maximum length of a path [characters]; Linux allows 4096 bytes, and 255 for one name. Longer ones name no file.
MAX_NAME = 1000

# Maximum length of the name of a document that was never saved [characters]; one takes up to four bytes.
MAX_UNSAVED = 60

# Characters that no file name can contain.
_NO_FILE = re.compile("[\0\ud800-\udfff]")


def path_of(uri: str) -> Path:
    """Return the file of a URI, as a normalized absolute path.

    A URI that does not name a file, as that of a document that was never saved, stands for one in the working folder.
    """
    name = uris.to_fs_path(uri) if uri.startswith("file:") else None
    if not name or len(name) > MAX_NAME:
        name = Path(uri.rpartition("/")[2].rpartition(":")[2][-MAX_UNSAVED:] or "untitled").name
    return absolute(_NO_FILE.sub("\ufffd", name))


def is_ours(buffer: Buffer) -> bool:
    """Return True if an open document is a SimFoundry document, by its file name or by its first key."""
    head = buffer.lines.text[:4096]
    return is_document(buffer.path) or any(line.startswith("simfoundry:") for line in head.splitlines())
