"""For GitHub Actions: workflow commands that put each finding at its line of a pull request.

https://docs.github.com/actions/reference/workflow-commands-for-github-actions
"""

from __future__ import annotations

from pathlib import Path

from simfoundry.spec.check.report.model import CheckReport, absolute, checkout
from simfoundry.spec.diagnostics import Diagnostic


def render(report: CheckReport) -> str:
    """One line for each finding; files are relative to the checkout."""
    folder = checkout()
    return "\n".join(_command(d, folder) for d in report.findings)


def _command(d: Diagnostic, folder: Path) -> str:
    path = absolute(d.document)
    file = (path.relative_to(folder) if path.is_relative_to(folder) else path).as_posix()
    place = {"line": str(d.line), "col": str(d.column)} if d.line else {}
    properties = ",".join(f"{k}={_property(v)}" for k, v in {"file": file, **place, "title": d.code}.items())
    message = f"{d.message}\n{d.hint}" if d.hint else d.message
    return f"::{d.severity} {properties}::{_data(message)}"


def _data(text: str) -> str:
    """What may follow the second ``::``."""
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    """What may stand between the commas."""
    return _data(text).replace(":", "%3A").replace(",", "%2C")
