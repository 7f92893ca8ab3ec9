"""Check reports and their output formats: text, JSON, SARIF, and GitHub annotations."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from simfoundry import __version__
from simfoundry.spec import diagnostics
from simfoundry.spec.diagnostics import Diagnostic, Fix, Severity, ordered

if TYPE_CHECKING:
    from simfoundry.spec.check.pages import Page

FORMATS = ("text", "json", "sarif", "github")


@dataclass(frozen=True)
class Checked:
    """The result of checking one document, including the findings for documents that it uses."""

    findings: tuple[Diagnostic, ...]
    uses: tuple[str, ...] = ()


@dataclass(frozen=True)
class CheckReport:
    """A report with the requested documents, the number of documents read, and all findings without duplicates."""

    files: tuple[str, ...]
    documents: int
    findings: tuple[Diagnostic, ...]

    @property
    def errors(self) -> int:
        """Return the number of errors."""
        return sum(d.severity is Severity.ERROR for d in self.findings)

    @property
    def warnings(self) -> int:
        """Return the number of warnings."""
        return len(self.findings) - self.errors


def gather(files: Iterable[str], checked: Iterable[Checked]) -> CheckReport:
    """Combine the results of individual documents. Shared documents and findings are counted only once."""
    files, checked = tuple(files), tuple(checked)
    seen: dict[Path, str] = {}
    for name in (*files, *(use for each in checked for use in each.uses)):
        seen.setdefault(absolute(name), name)
    findings: set[Diagnostic] = set()
    for finding in dict.fromkeys(d for each in checked for d in each.findings):
        name = seen.get(absolute(finding.document), finding.document)
        file = name + finding.file.removeprefix(finding.document)
        findings.add(finding if file == finding.file else replace(finding, file=file))
    return CheckReport(files, len(seen), tuple(ordered(findings)))


def absolute(file: str) -> Path:
    """Return the normalized absolute path.

    Symbolic links are not resolved, because the folder that contains the link matters.
    """
    return Path(os.path.normpath(Path(file).absolute()))


def checkout() -> Path:
    """Return the root for paths in machine-readable output: the CI job's checkout, or otherwise the current folder."""
    return absolute(os.environ.get("GITHUB_WORKSPACE") or ".")


def renderer(form: str) -> Callable[[CheckReport], str]:
    """Return the function that writes a report in one of the ``FORMATS``."""
    return {"text": render_text, "json": render_json, "sarif": render_sarif, "github": render_github}[form]


def findings_text(found: Iterable[Diagnostic], color: bool = False) -> str:
    """Format all findings with their source lines. File names are relative to the current folder."""
    return diagnostics.render((replace(d, file=_relative(d.file)) for d in found), color)


def summary(report: CheckReport) -> str:
    """Return a summary of the report, such as ``3 errors and 1 warning in 2 of 14 documents``."""
    if not report.findings:
        return f"no findings in {_count(report.documents, 'document')}"
    counts = [_count(n, what) for n, what in ((report.errors, "error"), (report.warnings, "warning")) if n]
    faulty = len({d.document for d in report.findings})
    of = f"{faulty} of {report.documents} documents" if report.documents > 1 else "1 document"
    return f"{' and '.join(counts)} in {of}"


def render_text(report: CheckReport) -> str:
    """Return the findings and the summary, without color."""
    return "\n".join(part for part in (findings_text(report.findings), summary(report)) if part)


def _relative(file: str) -> str:
    path, here = Path(file), Path.cwd()
    return str(path.relative_to(here)) if path.is_absolute() and path.is_relative_to(here) else file


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def render_json(report: CheckReport) -> str:
    """Return the report as one JSON object for scripts. The format is stable: keys may be added but are never removed.

    ``files`` lists the requested documents. ``documents`` is the number of documents read, including the ones that
    these documents use. ``errors`` and ``warnings`` are counts. Each entry in ``findings`` contains ``code``,
    ``severity`` (``error`` or ``warning``), ``message``, ``file``, ``line`` and ``column`` (counted from 1 in Unicode
    characters, or 0 for the whole file), ``path`` (keys joined by dots) and ``hint`` (which may be empty). ``word`` is
    the wrong text at this place, or empty if it is not known, and ``fixes`` contains what can be written instead of it:
    each ``text``, and whether it is ``certain`` that nothing else is meant.
    """
    data = {
        "files": list(report.files),
        "documents": report.documents,
        "errors": report.errors,
        "warnings": report.warnings,
        "findings": [d.to_json() for d in report.findings],
    }
    return json.dumps(data, indent=2, ensure_ascii=False)


def render_github(report: CheckReport) -> str:
    """Return workflow commands for GitHub Actions, which show each finding at its line in a pull request.

    https://docs.github.com/actions/reference/workflow-commands-for-github-actions
    """
    return "\n".join(_command(d, checkout()) for d in report.findings)


# Escape sequences for the message of a workflow command, and for its properties, which are separated by commas.
_DATA = str.maketrans({"%": "%25", "\r": "%0D", "\n": "%0A"})
_PROPERTY = _DATA | str.maketrans({":": "%3A", ",": "%2C"})


def _command(d: Diagnostic, folder: Path) -> str:
    path = absolute(d.document)
    file = (path.relative_to(folder) if path.is_relative_to(folder) else path).as_posix()
    place = {"line": str(d.line), "col": str(d.column)} if d.line else {}
    place |= {"endColumn": str(d.end_column)} if d.word else {}
    fields = {"file": file, **place, "title": d.code}
    properties = ",".join(f"{key}={value.translate(_PROPERTY)}" for key, value in fields.items())
    return f"::{d.severity} {properties}::{_with_hint(d).translate(_DATA)}"


def _with_hint(d: Diagnostic) -> str:
    return f"{d.message}\n{d.hint}" if d.hint else d.message


SCHEMA = "https://docs.oasis-open.org/sarif/sarif/v2.1.0/errata01/os/schemas/sarif-schema-2.1.0.json"
_ROOT = "%SRCROOT%"


def render_sarif(report: CheckReport) -> str:
    """Return a SARIF run with one result per finding.

    File paths are relative to the checkout, and columns count characters.
    """
    from simfoundry.spec.check.pages import pages

    rules = [page.code for page in pages()]
    driver = {"name": "SimFoundry", "semanticVersion": __version__, "rules": [_rule(page) for page in pages()]}
    run = {
        "tool": {"driver": driver},
        "columnKind": "unicodeCodePoints",
        "originalUriBaseIds": {_ROOT: {"description": {"text": "The CI checkout, or the current folder outside CI."}}},
        "results": [_result(d, rules, checkout()) for d in report.findings],
    }
    return json.dumps({"$schema": SCHEMA, "version": "2.1.0", "runs": [run]}, indent=2, ensure_ascii=False)


def _rule(page: Page) -> dict[str, Any]:
    return {
        "id": page.code,
        "shortDescription": {"text": page.title},
        "fullDescription": {"text": _plain(page.body.partition("\n\n")[0].replace("\n", " "))},
        "help": {"text": _plain(page.body), "markdown": page.body},
        "defaultConfiguration": {"level": "warning" if page.code.startswith("SF4") else "error"},
    }


def _result(d: Diagnostic, rules: list[str], folder: Path) -> dict[str, Any]:
    place: dict[str, Any] = {"artifactLocation": _artifact(d.document, folder)}
    if d.line:
        place["region"] = _region(d)
    location: dict[str, Any] = {"physicalLocation": place}
    if d.path:
        location["logicalLocations"] = [{"fullyQualifiedName": d.path}]
    return {
        "ruleId": d.code,
        **({"ruleIndex": rules.index(d.code)} if d.code in rules else {}),  # plug-ins define other codes
        "level": str(d.severity),
        "message": {"text": _plain(_with_hint(d))},
        "locations": [location],
        **({"fixes": [_fix(d, fix, folder) for fix in d.fixes]} if d.word and d.fixes else {}),
    }


def _region(d: Diagnostic) -> dict[str, int]:
    end = {"endColumn": d.end_column} if d.word else {}
    return {"startLine": d.line, "startColumn": max(1, d.column), **end}


def _fix(d: Diagnostic, fix: Fix, folder: Path) -> dict[str, Any]:
    """Return a SARIF fix, which replaces the wrong word."""
    replacement = {"deletedRegion": _region(d), "insertedContent": {"text": fix.text}}
    change = {"artifactLocation": _artifact(d.document, folder), "replacements": [replacement]}
    return {"description": {"text": _plain(f"replace `{d.word}` by `{fix.text}`")}, "artifactChanges": [change]}


def _artifact(file: str, folder: Path) -> dict[str, str]:
    """Return the location of a file as a relative URI, or as an absolute URI if it is outside the checkout."""
    path = absolute(file)
    if not path.is_relative_to(folder):
        return {"uri": path.as_uri()}
    return {"uri": quote(path.relative_to(folder).as_posix()), "uriBaseId": _ROOT}


def _plain(text: str) -> str:
    """Escape a text so that it contains no links, which have the form ``[text](target)`` in SARIF messages."""
    return text.replace("](", "] (")
