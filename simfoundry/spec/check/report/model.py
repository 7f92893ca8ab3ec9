"""The outcome of checking documents, from which every format is written."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from simfoundry.spec.diagnostics import Diagnostic, Severity, ordered

FORMATS = ("text", "json", "sarif", "github")


@dataclass(frozen=True)
class Checked:
    """What checking one document gave: its findings, those of the documents that it uses, and which those are."""

    findings: tuple[Diagnostic, ...]
    uses: tuple[str, ...] = ()


@dataclass(frozen=True)
class CheckReport:
    """The documents asked for, how many were read with those that they use, and every finding once, in order."""

    files: tuple[str, ...]
    documents: int
    findings: tuple[Diagnostic, ...]

    @property
    def errors(self) -> int:
        """How many findings are errors."""
        return sum(d.severity is Severity.ERROR for d in self.findings)

    @property
    def warnings(self) -> int:
        """How many findings are warnings."""
        return len(self.findings) - self.errors


def gather(files: Iterable[str], checked: Iterable[Checked]) -> CheckReport:
    """The report of documents that were checked one by one; what several of them use counts, and is reported, once."""
    files, checked = tuple(files), tuple(checked)
    seen: dict[Path, str] = {}
    for name in (*files, *(use for each in checked for use in each.uses)):
        seen.setdefault(absolute(name), name)
    findings: set[Diagnostic] = set()
    for finding in dict.fromkeys(d for each in checked for d in each.findings):
        name = seen.setdefault(absolute(finding.document), finding.document)
        file = name + finding.file.removeprefix(finding.document)
        findings.add(finding if file == finding.file else replace(finding, file=file))
    return CheckReport(files, len(seen), tuple(ordered(findings)))


def absolute(file: str) -> Path:
    """The same for every spelling of a path; a link is a file of its own: its folder decides what it refers to."""
    return Path(os.path.normpath(Path(file).absolute()))


def checkout() -> Path:
    """The folder from which other programs count the paths of files: that of a CI job, or else the current one."""
    return absolute(os.environ.get("GITHUB_WORKSPACE") or ".")


def renderer(form: str) -> Callable[[CheckReport], str]:
    """What writes a report in one of the ``FORMATS``; only that one is imported."""
    render: Callable[[CheckReport], str] = importlib.import_module(f"simfoundry.spec.check.report.as_{form}").render
    return render
