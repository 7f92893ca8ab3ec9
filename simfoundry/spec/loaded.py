"""A document that was read and checked, and the project that it belongs to."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

from simfoundry.spec.base import Model
from simfoundry.spec.diagnostics import Diagnostic, Severity
from simfoundry.spec.text import YamlError, read


@dataclass(frozen=True)
class Loaded:
    """A checked document: its typed ``spec`` (None where errors forbid one), findings, and the assets it uses."""

    path: Path
    root: Path
    spec: Model | None
    findings: tuple[Diagnostic, ...]
    assets: dict[str, Loaded] = field(default_factory=dict)

    @property
    def errors(self) -> list[Diagnostic]:
        """Findings that forbid any further work, assets' included."""
        return [d for d in self.all_findings() if d.severity is Severity.ERROR]

    def all_findings(self) -> list[Diagnostic]:
        """Findings of this document and of the assets it uses."""
        return [*self.findings, *(d for a in self.assets.values() for d in a.all_findings())]

    def finding(self, code: str, path: tuple[str | int, ...], message: str, hint: str = "") -> Diagnostic:
        """An error at a place of this document, whose text is read again to find it."""
        try:
            line, column = read(self.path).place(path)
        except YamlError:
            line, column = 0, 0
        dotted = ".".join(str(p) for p in path)
        return Diagnostic(code, Severity.ERROR, message, str(self.path), line, column, dotted, hint)

    def file(self, reference: str) -> Path:
        """The file that a path in this document means."""
        return (self.path.parent / reference).resolve()

    def shown(self, reference: str) -> Path:
        """The same file by the path that a person would write, relative where this document's own is."""
        plain = Path(os.path.normpath(self.path.parent / reference))
        return plain if plain.resolve() == self.file(reference) else self.file(reference)


def project_root(path: Path) -> Path:
    """The folder below which a document's files must lie: the nearest with a ``.git`` or ``simfoundry.yaml``."""
    folder = path.resolve().parent
    for candidate in (folder, *folder.parents):
        if (candidate / ".git").exists() or (candidate / "simfoundry.yaml").exists():
            return candidate
    return folder
