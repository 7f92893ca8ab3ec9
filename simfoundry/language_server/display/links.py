"""Links from the file references of a document to the files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from lsprotocol import types

from simfoundry.language_server.analysis import Analysis
from simfoundry.spec.files import MAX_PATH, FileError, located, packaged_model
from simfoundry.spec.load import kind_of
from simfoundry.spec.models.kinds import model_of
from simfoundry.spec.models.types import Pattern, file_patterns
from simfoundry.spec.yaml.spans import TextSpan
from simfoundry.spec.yaml.text import Document

# Maximum number of links that a document shows, each of which requires a look at the disk.
MOST_LINKS = 2000


def document_links(analysis: Analysis) -> list[types.DocumentLink]:
    """Return a link for each reference to an existing file."""
    found: list[types.DocumentLink] = []
    targets: dict[str, Path | None] = {}
    for span, reference in file_references(analysis):
        if reference not in targets:
            targets[reference] = existing_file(reference, analysis)
        target = targets[reference]
        if target is not None:
            quoted = analysis.lines.text[span.start : span.start + 1] in ("'", '"')
            where = analysis.lines.range(span.start + quoted, span.end - quoted)
            found.append(types.DocumentLink(where, target=target.as_uri(), tooltip=f"Open {target.name}"))
        if len(found) == MOST_LINKS:
            break
    return found


def file_at(analysis: Analysis, offset: int) -> Path | None:
    """Return the existing file that a reference at an offset names, or None if there is none."""
    named = (name for span, name in file_references(analysis) if span.start <= offset <= span.end)
    return next((file for name in named if (file := existing_file(name, analysis)) is not None), None)


def file_references(analysis: Analysis) -> Iterator[tuple[TextSpan, str]]:
    """Yield the place and the text of each reference to a file."""
    document = analysis.source
    kind = kind_of(document)[0] if document is not None else None
    if document is None or kind is None:
        return
    for pattern in dict.fromkeys(file_patterns(model_of(kind))):
        yield from _matches(document, analysis.spans, document.data, pattern)


def _matches(document: Document, span: TextSpan, data: object, pattern: Pattern) -> Iterator[tuple[TextSpan, str]]:
    if not pattern:
        if isinstance(data, str):
            yield span, data
        return
    for key, child in span.entries():
        if pattern[0] in ("*", key):
            value = data.get(key) if isinstance(data, dict) else _item(data, key)
            yield from _matches(document, child, value, pattern[1:])


def _item(data: object, key: str | int) -> object:
    return data[key] if isinstance(data, Sequence) and isinstance(key, int) and key < len(data) else None


def existing_file(reference: str, analysis: Analysis) -> Path | None:
    """Return the file in the project or in a package that a reference names, or None if there is none."""
    if not reference or len(reference) > MAX_PATH or "\0" in reference or packaged_model(reference) is not None:
        return None
    try:
        target = located(reference, analysis.path)
        inside = reference.startswith("pkg:") or target.is_relative_to(analysis.loaded.root.resolve())
        return target if inside and target.is_file() else None
    except (FileError, OSError, ValueError):
        return None
