"""The analysis of one text of a document: what ``simfoundry check`` would find in it, and its lowered scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from simfoundry.language_server.positions import Lines
from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.spec.files import Loaded
from simfoundry.spec.open_documents import OpenDocuments
from simfoundry.spec.yaml.spans import TextSpan, locate_values
from simfoundry.spec.yaml.text import Document

if TYPE_CHECKING:
    from simfoundry.lint.draft import DraftScene


@dataclass(frozen=True, eq=False)
class Analysis:
    """A text of a document, and everything that is known about it.

    Attributes:
        path: The file, as a normalized absolute path.
        lines: The text.
        version: The editor's version of the text, or None if the file is not open.
        loaded: The document, joined with its bases, and its structural findings.
        findings: All findings, including those of the lints once they have run.
        draft: The lowered scene, or None if the document has errors, has no scene, or has not been lowered yet.
    """

    path: Path
    lines: Lines
    version: int | None
    loaded: Loaded
    findings: tuple[Diagnostic, ...]
    draft: DraftScene | None = None

    @property
    def source(self) -> Document | None:
        """Return the parsed text itself, without its bases, or None if it could not be parsed."""
        return self.loaded.source

    @cached_property
    def spans(self) -> TextSpan:
        """Return the place of every value in the text. It has no members if the text could not be parsed."""
        return locate_values(self.lines.text) if self.source is not None else TextSpan(0, 0)

    @property
    def has_errors(self) -> bool:
        """Return True if the document, or a document that it uses, has errors, so that lints cannot run."""
        return self.loaded.spec is None or bool(self.loaded.errors)


def analyzed(path: Path, lines: Lines, version: int | None, documents: OpenDocuments) -> Analysis:
    """Check the structure of a document: types, names, and files, but not its geometry.

    Args:
        path: The file, as a normalized absolute path.
        lines: The text.
        version: The editor's version of the text, or None if the file is not open.
        documents: The documents of the editor, with the same text.
    """
    loaded = documents.load(path)
    if loaded.source is not None and loaded.source.text != lines.text:  # it was edited on its way to this thread
        lines = Lines(loaded.source.text, lines.encoding)
    return Analysis(path, lines, version, loaded, tuple(loaded.all_findings()))


def linted(analysis: Analysis, checkpoint: Callable[[], None], earlier: DraftScene | None = None) -> Analysis:
    """Return an analysis with its lowered scene and the findings of the lints.

    The documents that it uses are not linted: their findings are shown where they are written.

    Args:
        analysis: The analysis.
        checkpoint: Function that is called before each step. It can raise an exception to stop.
        earlier: An earlier draft of the same document, whose objects are reused if they have not changed.
    """
    if analysis.has_errors:
        return analysis
    from simfoundry.lint.lints import lint_subject, subject_of  # numpy is loaded after the first findings are shown

    subject, errors = subject_of(analysis.loaded, checkpoint, earlier)
    findings = (*analysis.findings, *lint_subject(analysis.loaded, subject, errors))
    return replace(analysis, findings=findings, draft=subject.draft if subject is not None else None)
