"""For scripts: the shape is stable, keys are only ever added.

``files``: the documents asked for. ``documents``: how many were read, with those that they use. ``errors`` and
``warnings``: how many there are. ``findings``: each with ``code``, ``severity`` (``error`` or ``warning``),
``message``, ``file``, ``line`` and ``column`` (from 1, in Unicode characters; 0 where the whole file is meant),
``path`` (the keys that lead there, joined by dots) and ``hint`` (may be empty).
"""

from __future__ import annotations

import json

from simfoundry.spec.check.report.model import CheckReport


def render(report: CheckReport) -> str:
    """The report as one JSON object."""
    data = {
        "files": list(report.files),
        "documents": report.documents,
        "errors": report.errors,
        "warnings": report.warnings,
        "findings": [d.to_json() for d in report.findings],
    }
    return json.dumps(data, indent=2, ensure_ascii=False)
