"""Findings about members that were written out: their sources, their causes, and one finding for many alike copies."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from typing import Any

from simfoundry.spec.compose.expand import Reuse
from simfoundry.spec.diagnostics import Diagnostic

# A name or a number in a message.
_WORD = re.compile(r"[a-z][a-z0-9_]*|[-+]?[0-9]+(?:\.[0-9]+)?")

# Codes of findings that follow from a member which could not be written out: something is missing, a name is unknown,
# or names are equal that stand for different copies.
_CONSEQUENCES = ("SF102", "SF107", "SF108", "SF201", "SF202", "SF212")

# A name in a message, without the parts below it.
_NAME = re.compile(r"`([a-z][a-z0-9_]*)")


class Causes:
    """Findings about members that could not be written out, and the names of these members.

    Args:
        findings: The findings of the composition. Those that follow from others are dropped.
        data: The data with everything written out that could be.
        reuse: What was written out.
    """

    def __init__(self, findings: Collection[Diagnostic], data: Any, reuse: Reuse) -> None:
        self.places = {*((d.file, d.line, d.column) for d in findings), *reuse.unresolved}
        paths = {tuple(d.path.split(".")[:2]) for d in findings}
        faulty = {path for path in paths if path[0] in ("objects", "templates") and len(path) == 2}
        objects = data.get("objects") if isinstance(data, dict) else None
        items: Mapping[str, Any] = objects if isinstance(objects, dict) else {}
        users = ((name, item.get("like")) for name, item in items.items() if isinstance(item, dict))
        copies = {key for key, found in reuse.generated.items() if found.source in faulty}
        self.members = faulty | copies | {("objects", name) for name, like in users if like is not None}
        repeated = [name for name, item in items.items() if isinstance(item, dict) and "repeat" in item]
        included = [path[1] for path in paths if path[0] == "include" and len(path) == 2]
        absent = [*(f"{name}(?:_[0-9]+)*" for name in repeated), *(f"{name}_.*" for name in included)]
        self.absent = re.compile("|".join(absent)) if absent else None
        self.findings = [d for d in findings if not self._removes_absent(d)]

    def unrelated(self, findings: Iterable[Diagnostic]) -> list[Diagnostic]:
        """Return the findings that do not follow from members which could not be written out."""
        return [d for d in findings if (d.file, d.line, d.column) not in self.places and not self.explain(d)]

    def explain(self, finding: Diagnostic) -> bool:
        """Return True if a finding follows from a member that could not be written out."""
        if finding.code not in _CONSEQUENCES:
            return self._removes_absent(finding)
        section, _, rest = finding.path.partition(".")
        name = rest.partition(".")[0]
        if (section, name) in self.members:
            return True
        if self.absent is None or section == "include":
            return False
        own = section == "objects" and self.absent.fullmatch(name) is not None and ".repeat" not in finding.path
        return own or any(self.absent.fullmatch(word) for word in _NAME.findall(finding.message))

    def _removes_absent(self, finding: Diagnostic) -> bool:
        """Return True if a finding is about an entry that removes a copy of an object which could not be repeated."""
        section, _, name = finding.path.partition(".")
        removes = finding.message.endswith("has no value") or " cannot be removed" in finding.message
        return removes and section == "objects" and self.absent is not None and bool(self.absent.fullmatch(name))


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
