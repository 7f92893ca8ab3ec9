"""A document that was read and checked, and the project that it belongs to."""

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
        """Findings that forbid any further work, those of the documents in use included."""
        return [d for d in self.all_findings() if d.severity is Severity.ERROR]

    def all_findings(self) -> list[Diagnostic]:
        """Findings of this document and of those that it uses."""
        return [*self.findings, *(d for used in self.uses.values() for d in used.all_findings())]

    def files(self) -> list[Path]:
        """The documents that this one was read from: itself, its bases, and those that it uses with theirs."""
        return [self.path, *self.bases, *(file for used in self.uses.values() for file in used.files())]

    def finding(self, code: str, path: tuple[str | int, ...], message: str, hint: str = "") -> Diagnostic:
        """An error at a place of this document."""
        if self.document is None:
            return Diagnostic(code, Severity.ERROR, message, str(self.path), 0, 0, ".".join(map(str, path)), hint)
        return self.document.finding(code, path, message, hint)

    def file(self, reference: str) -> Path:
        """The file that a path in this document means."""
        return located(reference, self.path)

    def used(self, reference: str) -> Loaded | None:
        """The document that a path in this document means, if it was read."""
        return self.uses.get(str(self.file(reference)))

    def shown(self, reference: str) -> Path:
        """The same file by the path that a person would write, relative where this document's own is."""
        return shown(reference, self.path)
