"""Apply ``allow``, which silences warnings with a reason for each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from simfoundry.spec.diagnostics import Diagnostic, Severity
from simfoundry.spec.yaml.text import Document

Allow = Mapping[str, str | dict[str, str]]


def sift(findings: Iterable[Diagnostic], allow: Allow) -> tuple[list[Diagnostic], list[Diagnostic]]:
    """Split findings into those that are reported and the warnings that ``allow`` silences."""
    kept, silenced = list[Diagnostic](), list[Diagnostic]()
    for d in findings:
        (silenced if d.severity is Severity.WARNING and _silences(allow.get(d.code), d) else kept).append(d)
    return kept, silenced


def unused(document: Document, allow: Allow, silenced: Iterable[Diagnostic]) -> Iterator[Diagnostic]:
    """Yield a warning for each unused entry of ``allow``; call this after all lints."""
    heard = list(silenced)
    for code, entry in allow.items():
        of_code = [d for d in heard if d.code == code]
        names = list(entry) if isinstance(entry, dict) else [""]
        for name in names:
            if any(not name or _is_about(d, name) for d in of_code):
                continue
            path = ("allow", code, name) if name else ("allow", code)
            message = f"{code} does not occur" + (f" for `{name}`" if name else "")
            yield document.finding("SF403", path, message, "remove the line", Severity.WARNING, of_key=True)


def _silences(entry: str | dict[str, str] | None, d: Diagnostic) -> bool:
    return isinstance(entry, str) or (entry is not None and any(_is_about(d, name) for name in entry))


def _is_about(d: Diagnostic, name: str) -> bool:
    return name == d.path or name in d.path.split(".") or name in d.about
