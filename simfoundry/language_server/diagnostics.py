"""Findings as diagnostics of the protocol."""

from __future__ import annotations

import re
from collections.abc import Iterable

from lsprotocol import types

from simfoundry.language_server.positions import Lines
from simfoundry.spec.diagnostics import Diagnostic, Severity, ordered, printable

SOURCE = "simfoundry"
"""Name under which editors show the findings."""

_SEVERITIES = {
    Severity.ERROR: types.DiagnosticSeverity.Error,
    Severity.WARNING: types.DiagnosticSeverity.Warning,
}

# The token at the start of a text: a quoted string, a name or number with what belongs to it, or a single character.
_TOKEN = re.compile(r""" "(?:[^"\\\n]|\\.)*" | '(?:[^'\n]|'')*' | [^\s,:\[\]{}#"']+ | \S """, re.VERBOSE)


def published(findings: Iterable[Diagnostic], lines: Lines) -> list[types.Diagnostic]:
    """Return the diagnostics for the findings in a text."""
    return [_diagnostic(finding, lines) for finding in ordered(findings)]


def finding_range(finding: Diagnostic, lines: Lines) -> types.Range:
    """Return the range of a finding: its wrong word, or the first line if it concerns the whole text."""
    if not finding.line:
        return lines.range(*lines.bounds(0))
    start = lines.place(finding.line, finding.column)
    if finding.word and lines.text.startswith(finding.word, start):
        return lines.range(start, start + len(finding.word))
    token = _TOKEN.match(lines.text, start)
    return lines.range(start, token.end() if token is not None else start)


def _diagnostic(finding: Diagnostic, lines: Lines) -> types.Diagnostic:
    message = finding.message if not finding.hint else f"{finding.message}\n{finding.hint}"
    unused = finding.code in ("SF401", "SF403")
    return types.Diagnostic(
        range=finding_range(finding, lines),
        message="\n".join(map(printable, message.split("\n"))),
        severity=_SEVERITIES[finding.severity],
        code=finding.code,
        source=SOURCE,
        tags=[types.DiagnosticTag.Unnecessary] if unused else None,
    )
