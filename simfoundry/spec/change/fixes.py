"""Apply the corrections of findings to the text of a document.

A correction replaces the wrong word of a finding, or it changes the data of the document, such as the removal of an
unused material; the latter is applied by :mod:`simfoundry.spec.change.edit_text`. Everything else keeps its bytes.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simfoundry.errors import SimfoundryError
from simfoundry.spec.change.edit_text import edit_text
from simfoundry.spec.change.format import migrated
from simfoundry.spec.diagnostics import Diagnostic, Fix, Severity, SpecError
from simfoundry.spec.editor.snippets import lookup
from simfoundry.spec.files import Loaded
from simfoundry.spec.load import kind_of
from simfoundry.spec.models.base import Model
from simfoundry.spec.models.kinds import model_of
from simfoundry.spec.models.types import models_at
from simfoundry.spec.names.positions import TextIndex
from simfoundry.spec.open_documents import OpenDocuments
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import Document, Path_, parse

# Reason that a person replaces by a real one; it is long enough to be valid.
REASON = "say why this is intended"


@dataclass(frozen=True)
class Correction:
    """A text of a document in which a finding is resolved.

    Attributes:
        title: What the correction does, in the imperative.
        text: The corrected text.
        is_certain: True if nothing else is likely to be meant.
        blank: A word in the text that a person has to replace, or an empty string.
    """

    title: str
    text: str
    is_certain: bool = False
    blank: str = ""


def word_range(index: TextIndex, finding: Diagnostic) -> tuple[int, int] | None:
    """Return the range of a finding's wrong word in a text, or None if the text has changed since."""
    if not finding.word or not finding.line:
        return None
    start = index.offset(finding.line, finding.column)
    return (start, start + len(finding.word)) if index.text.startswith(finding.word, start) else None


def certain_fix(finding: Diagnostic) -> Fix | None:
    """Return the correction of a finding that may be applied unasked, or None if there is none, or several."""
    return finding.fixes[0] if len(finding.fixes) == 1 and finding.fixes[0].certain else None


def apply_certain_fixes(text: str, findings: Iterable[Diagnostic]) -> tuple[str, list[Diagnostic]]:
    """Apply the certain corrections of the findings in a text, and return the new text and what was corrected.

    If two findings are about overlapping words, only the first one is corrected.
    """
    index = TextIndex(text)
    chosen: list[tuple[int, int, str, Diagnostic]] = []
    for finding in findings:
        fix, place = certain_fix(finding), word_range(index, finding)
        if fix is not None and place is not None:
            chosen.append((*place, fix.text, finding))
    done: list[Diagnostic] = []
    end = 0
    parts: list[str] = []
    for start, stop, new, finding in sorted(chosen, key=lambda each: each[:2]):
        if start < end:
            continue
        parts += [text[end:start], new]
        end = stop
        done.append(finding)
    return "".join([*parts, text[end:]]), done


def corrections(text: str, document: Document | None, finding: Diagnostic) -> Iterator[Correction]:
    """Yield the corrections of a finding in a text, the most likely one first.

    Args:
        text: The text.
        document: The parsed text, without its bases, or None if it could not be parsed.
        finding: A finding in this text.
    """
    place = word_range(TextIndex(text), finding)
    for fix in finding.fixes if place is not None else ():
        assert place is not None
        title = f"replace `{finding.word}` by `{fix.text}`"
        yield Correction(title, text[: place[0]] + fix.text + text[place[1] :], fix.certain)
    if document is None or not isinstance(document.data, dict):
        return
    kind, _ = kind_of(document)
    if kind is None or document.duplicates:
        return
    try:
        if finding.code == "SF101" and "was renamed to" in finding.message:
            yield Correction("rename all former keys", migrated(text, finding.file))
        for title, data, blank in _edits(document, finding, model_of(kind)):
            yield Correction(title, edit_text(text, data, model_of(kind)), blank=blank)
    except (SpecError, SimfoundryError, YamlError):
        return


# Findings about entries that have no effect and can be removed.
_WITHOUT_EFFECT = ("SF401", "SF403")


def _edits(document: Document, finding: Diagnostic, model: type[Model]) -> Iterator[tuple[str, Any, str]]:
    """Yield the corrections that change the data: their titles, the new data, and the words to replace."""
    data = document.data
    path = path_in(data, finding.path)
    last = str(path[-1]) if path else ""
    exists = path is not None and ".".join(map(str, path)) == finding.path
    removable = finding.code in _WITHOUT_EFFECT or finding.hint.startswith(("remove it", "set it in that document"))
    if exists and path and removable:
        yield f"remove `{last}`", without(data, path), ""
    if finding.code == "SF102" and (key := finding.path.rpartition(".")[2]):
        value = first_value(model, (*path, key) if path is not None else (key,))
        if path is not None and value is not None and isinstance(at(data, path), dict):
            yield f"add `{key}`", with_value(data, (*path, key), value), ""
    if finding.code == "SF108" and exists and path:
        yield f"give `{last}` a density", with_value(data, (*path, "density"), 1000), "1000"
    if finding.severity is Severity.WARNING and finding.code != "SF403":
        name = next((part for part in finding.path.split(".")[1:2] if part.isidentifier()), "")
        entry: Any = {name: REASON} if name else REASON
        allowed = data.get("allow", {}).get(finding.code) if isinstance(data.get("allow", {}), dict) else ""
        if allowed is None or (name and isinstance(allowed, dict)):
            new = {**(allowed or {}), **entry} if name else entry
            about = f" for `{name}`" if name else ""
            yield f"allow {finding.code}{about}", with_value(data, ("allow", finding.code), new), REASON


def path_in(data: Any, dotted: str) -> Path_ | None:
    """Return the longest part of a finding's path that exists in plain data, as keys and indices."""
    found: list[str | int] = []
    for part in dotted.split(".") if dotted else ():
        if isinstance(data, dict) and part in data:
            found.append(part)
            data = data[part]
        elif isinstance(data, tuple | list) and part.isdigit() and int(part) < len(data):
            found.append(int(part))
            data = data[int(part)]
        else:
            break
    return tuple(found)


def at(data: Any, path: Path_) -> Any:
    """Return the value at an existing path of plain data."""
    for part in path:
        data = data[part]
    return data


def with_value(data: Any, path: Path_, value: Any) -> Any:
    """Return plain data with another value at a path. Mappings on the way are created."""
    if not path:
        return value
    head, *rest = path
    if isinstance(data, tuple | list):
        return tuple(with_value(item, tuple(rest), value) if k == head else item for k, item in enumerate(data))
    known: Mapping[Any, Any] = data if isinstance(data, dict) else {}
    return {**known, head: with_value(known.get(head), tuple(rest), value)}


def without(data: Any, path: Path_) -> Any:
    """Return plain data without the value at a path, and without the mapping around it if that becomes empty."""
    head, *rest = path
    if isinstance(data, tuple | list):
        return tuple(
            without(item, tuple(rest)) if k == head else item for k, item in enumerate(data) if rest or k != head
        )
    inner = without(data[head], tuple(rest)) if rest else None
    if inner == {} or not rest:
        return {key: value for key, value in data.items() if key != head}
    return {**data, head: inner}


def first_value(model: type[Model], path: Path_) -> Any:
    """Return the initial value that editors offer for a key, or None if there is none."""
    key = str(path[-1])
    owners = [owner.__name__ for owner in models_at(model, path[:-1]) if key in owner.model_fields]
    body = lookup("first", *(f"{owner}.{key}" for owner in owners), key) if owners else None
    if not isinstance(body, str):
        return None
    try:
        return parse(re.sub(r"\$\{\d+[:|]([^{},|]*)[^{}]*\}", r"\1", body)).data
    except YamlError:
        return None


# Number of rounds; a correction can make other findings appear, such as those in a text that can be parsed again.
MAX_ROUNDS = 8


@dataclass(frozen=True)
class FixedDocuments:
    """Documents in which the certain corrections have been applied.

    Attributes:
        texts: The text of each changed document before and after.
        done: The corrected findings, in the order in which they were corrected.
    """

    texts: Mapping[Path, tuple[str, str]]
    done: tuple[Diagnostic, ...]


def fix_documents(files: Collection[Path]) -> FixedDocuments:
    """Apply the certain corrections of structural findings to documents, without writing them.

    Corrections after which the findings remain are dropped, and all those of a document if it can no longer be parsed.
    Other documents that these documents use are left as they are.
    """
    documents = OpenDocuments()
    places = {os.path.realpath(file): file for file in files}
    before: dict[Path, str] = {}
    after: dict[Path, str] = {}
    done: list[Diagnostic] = []
    rejected: set[Diagnostic] = set()
    for _ in range(MAX_ROUNDS):
        own: dict[Path, list[Diagnostic]] = {}
        for finding in dict.fromkeys(d for file in files for d in documents.load(file).all_findings()):
            place = places.get(os.path.realpath(finding.document))
            if place is not None and finding not in rejected and certain_fix(finding) is not None:
                own.setdefault(place, []).append(finding)
        for file, mine in own.items():
            text = after[file] if file in after else _text(file)
            new, corrected = apply_certain_fixes(text, mine)
            documents.edit(file, new)
            left = _unresolved(documents.load(file), corrected)
            if corrected and not left:
                before.setdefault(file, text)
                after[file] = new
                done += corrected
            else:
                documents.edit(file, after.get(file))
                rejected.update(left or mine)
        if not own:
            break
    return FixedDocuments({file: (before[file], new) for file, new in after.items()}, tuple(done))


def _text(file: Path) -> str:
    return file.read_bytes().decode("utf-8", errors="replace")


def _unresolved(loaded: Loaded, corrected: Collection[Diagnostic]) -> set[Diagnostic]:
    """Return the corrected findings that are left, which are all if the document is no longer a valid mapping."""
    broken = loaded.document is None or any(d.code == "SF003" for d in loaded.findings)
    if broken and all(d.code != "SF002" for d in corrected):
        made = Counter((d.path.rpartition(".")[0], d.fixes[0].text) for d in corrected)  # such as two keys `mass`
        return {d for d in corrected if made[d.path.rpartition(".")[0], d.fixes[0].text] > 1} or {*corrected}
    # A base can contain the same slip, and so can another line, which may have to be corrected by a person.
    left = {(d.code, d.message, d.line, os.path.realpath(d.document)) for d in loaded.findings}
    # A line without a colon is no key if it is unknown or has no value, but the rest of a text or comment.
    no_key = {d.line for d in loaded.findings if d.code in ("SF101", "SF103")}
    return {
        d
        for d in corrected
        if (d.code, d.message, d.line, os.path.realpath(d.document)) in left or (d.code == "SF002" and d.line in no_key)
    }
