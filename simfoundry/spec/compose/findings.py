"""Findings about members that were written out: their sources, and one finding for many alike copies."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace

from simfoundry.spec.compose.expand import Reuse
from simfoundry.spec.diagnostics import Diagnostic

# A name or a number in a message.
_WORD = re.compile(r"[a-z][a-z0-9_]*|[-+]?[0-9]+(?:\.[0-9]+)?")


def with_sources(findings: Iterable[Diagnostic], reuse: Reuse | None) -> list[Diagnostic]:
    """Return the findings with the names of repeated objects and includes, so that `allow` can refer to these."""
    if reuse is None:
        return list(findings)
    out = []
    for d in findings:
        names = dict.fromkeys((*d.path.split(".")[1:2], *d.about))
        sources = dict.fromkeys(source for name in names if (source := _source(name, reuse)) is not None)
        out.append(replace(d, about=(*d.about, *sources)) if sources else d)
    return out


def collapsed(findings: list[Diagnostic], reuse: Reuse | None) -> list[Diagnostic]:
    """Return one finding for all copies that have the same problem at the same place in the text."""
    if reuse is None:
        return findings
    alike: dict[tuple[object, ...], list[Diagnostic]] = {}
    for d in findings:
        message = _WORD.sub(lambda match: _source(match[0], reuse) or _without_number(match[0]), d.message)
        alike.setdefault((d.code, d.severity, d.file, d.line, d.column, message), []).append(d)
    return [
        same[0] if len(same) == 1 else replace(same[0], message=f"{same[0].message} (and {len(same) - 1} more like it)")
        for same in alike.values()
    ]


def _source(name: str, reuse: Reuse) -> str | None:
    """Return the repeated object or the include that a member comes from, or None."""
    for section in ("objects", "robots", "cameras", "materials", "frames"):
        source = reuse.source(section, name)
        if source is not None:
            return source[1]
    return None


def _without_number(word: str) -> str:
    return word if word[0].isalpha() else "#"
