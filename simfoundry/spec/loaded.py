"""A document that was read and checked, with its project."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from simfoundry.spec.diagnostics import Diagnostic, Severity
from simfoundry.spec.files import located, shown
from simfoundry.spec.models.base import DocumentSpec
from simfoundry.spec.yaml.text import Document


@dataclass(frozen=True)
class Loaded:
    """A checked document.

    ``spec`` is its typed content with all that it extends (None where errors forbid one), ``document`` the text behind
    it (None where it cannot be read), ``bases`` the files that it extends, ``uses`` the documents that it refers to, by
    resolved path: assets, and the scene of a task. ``silenced`` are warnings that its ``allow`` took away.
    """

    path: Path
    root: Path
    spec: DocumentSpec | None
    findings: tuple[Diagnostic, ...]
    document: Document | None = None
    bases: tuple[Path, ...] = ()
    uses: dict[str, Loaded] = field(default_factory=dict)
    silenced: tuple[Diagnostic, ...] = ()

    @property
    def errors(self) -> list[Diagnostic]:
        """Errors, with those of the documents in use."""
        return [d for d in self.all_findings() if d.severity is Severity.ERROR]

    def all_findings(self) -> list[Diagnostic]:
        """Return the findings of this document and of those that it uses."""
        return [*self.findings, *(d for used in self.uses.values() for d in used.all_findings())]

    def files(self) -> list[Path]:
        """Return all files that this document was read from: itself, its bases, and those of documents in use."""
        return [self.path, *self.bases, *(file for used in self.uses.values() for file in used.files())]

    def finding(self, code: str, path: tuple[str | int, ...], message: str, hint: str = "") -> Diagnostic:
        """Return an error at a place of this document."""
        if self.document is None:
            return Diagnostic(code, Severity.ERROR, message, str(self.path), 0, 0, ".".join(map(str, path)), hint)
        return self.document.finding(code, path, message, hint)

    def file(self, reference: str) -> Path:
        """Return the file that a path in this document means."""
        return located(reference, self.path)

    def used(self, reference: str) -> Loaded | None:
        """Return the document that a path in this document means, if it was read."""
        return self.uses.get(str(self.file(reference)))

    def shown(self, reference: str) -> Path:
        """Return the file as a person would write it, relative if the path of this document is."""
        return shown(reference, self.path)
