"""Documents that were read and checked, with their project."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from simfoundry.spec.diagnostics import Diagnostic, Severity
from simfoundry.spec.files import located, shown
from simfoundry.spec.models.base import DocumentSpec
from simfoundry.spec.yaml.text import Document


@dataclass(frozen=True)
class Loaded:
    """Checked document.

    ``spec`` is its typed content, including everything that it extends (None if there are errors); ``document`` is the
    underlying text (None if it cannot be read). ``bases`` are the files that it extends. ``uses`` contains the
    documents that it refers to by resolved path: assets, and the scene of a task. ``silenced`` are warnings that its
    ``allow`` suppressed.
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
        """Return the errors, including those of the documents that it uses."""
        return [d for d in self.all_findings() if d.severity is Severity.ERROR]

    def all_findings(self) -> list[Diagnostic]:
        """Return the findings of this document and of those that it uses."""
        return [*self.findings, *(d for used in self.uses.values() for d in used.all_findings())]

    def files(self) -> list[Path]:
        """Return all files that this document was read from: itself, its bases, and those of documents that it uses."""
        return [self.path, *self.bases, *(file for used in self.uses.values() for file in used.files())]

    def finding(self, code: str, path: tuple[str | int, ...], message: str, hint: str = "") -> Diagnostic:
        """Return an error at a location in this document."""
        if self.document is None:
            return Diagnostic(code, Severity.ERROR, message, str(self.path), 0, 0, ".".join(map(str, path)), hint)
        return self.document.finding(code, path, message, hint)

    def file(self, reference: str) -> Path:
        """Return the file that a path in this document refers to."""
        return located(reference, self.path)

    def used(self, reference: str) -> Loaded | None:
        """Return the document that a path in this document refers to, if it was read."""
        return self.uses.get(str(self.file(reference)))

    def shown(self, reference: str) -> Path:
        """Return the path of a file for display, relative if the path of this document is."""
        return shown(reference, self.path)
