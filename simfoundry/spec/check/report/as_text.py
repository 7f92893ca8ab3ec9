"""For people: findings as a compiler prints them, and one line that sums up."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from simfoundry.spec import diagnostics
from simfoundry.spec.check.report.model import CheckReport
from simfoundry.spec.diagnostics import Diagnostic


def findings(found: Iterable[Diagnostic], colour: bool = False) -> str:
    """Every finding with its line, its file relative to the current folder; empty where there is none."""
    return diagnostics.render((replace(d, file=_relative(d.file)) for d in found), colour)


def summary(report: CheckReport) -> str:
    """``3 errors and 1 warning in 2 of 14 documents``."""
    if not report.findings:
        return f"no findings in {_count(report.documents, 'document')}"
    counts = [_count(n, what) for n, what in ((report.errors, "error"), (report.warnings, "warning")) if n]
    faulty = len({d.document for d in report.findings})
    of = f"{faulty} of {report.documents} documents" if report.documents > 1 else "1 document"
    return f"{' and '.join(counts)} in {of}"


def render(report: CheckReport) -> str:
    """The findings and the summary, without colour."""
    return "\n".join(part for part in (findings(report.findings), summary(report)) if part)


def _relative(file: str) -> str:
    path, here = Path(file), Path.cwd()
    return str(path.relative_to(here)) if path.is_absolute() and path.is_relative_to(here) else file


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
