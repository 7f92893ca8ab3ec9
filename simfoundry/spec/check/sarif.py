"""SARIF 2.1.0 output for code scanning; the help of each rule is the page of its code.

https://docs.oasis-open.org/sarif/sarif/v2.1.0/sarif-v2.1.0.html
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from urllib.parse import quote

from simfoundry import __version__
from simfoundry.spec.check.pages import Page, pages
from simfoundry.spec.check.report import CheckReport, absolute, checkout
from simfoundry.spec.diagnostics import Diagnostic

SCHEMA = "https://docs.oasis-open.org/sarif/sarif/v2.1.0/errata01/os/schemas/sarif-schema-2.1.0.json"
_ROOT = "%SRCROOT%"


def render_sarif(report: CheckReport) -> str:
    """Return one run with one result per finding; files are relative to the checkout, columns in characters."""
    folder = checkout()
    explained = pages()
    rules = [page.code for page in explained]
    run = {
        "tool": {
            "driver": {
                "name": "SimFoundry",
                "semanticVersion": __version__,
                "rules": [_rule(page) for page in explained],
            }
        },
        "columnKind": "unicodeCodePoints",
        "originalUriBaseIds": {_ROOT: {"description": {"text": "The checkout, or else the folder of the command."}}},
        "results": [_result(d, rules, folder) for d in report.findings],
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
        place["region"] = {"startLine": d.line, "startColumn": max(1, d.column)}
    location: dict[str, Any] = {"physicalLocation": place}
    if d.path:
        location["logicalLocations"] = [{"fullyQualifiedName": d.path}]
    return {
        "ruleId": d.code,
        "ruleIndex": rules.index(d.code),
        "level": str(d.severity),
        "message": {"text": _plain(f"{d.message}\n{d.hint}" if d.hint else d.message)},
        "locations": [location],
    }


def _artifact(file: str, folder: Path) -> dict[str, str]:
    """Return the location of a file as a relative URI, or as an absolute URI if it is outside the checkout."""
    path = absolute(file)
    if not path.is_relative_to(folder):
        return {"uri": path.as_uri()}
    return {"uri": quote(path.relative_to(folder).as_posix()), "uriBaseId": _ROOT}


def _plain(text: str) -> str:
    """Escape a text so that it contains no links, which plain SARIF messages write as ``[text](target)``."""
    return text.replace("](", "] (")
