"""Rename a symbol in every document that names it, as exact edits of the texts."""

from __future__ import annotations

import os
import re
from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from simfoundry.errors import SimfoundryError
from simfoundry.spec.diagnostics import Diagnostic, Severity, nearest
from simfoundry.spec.load import Known, load
from simfoundry.spec.models.base import NAME, PATTERNS
from simfoundry.spec.models.scene import DEFAULT_VARIANT
from simfoundry.spec.names.linked import ANY_SCENE
from simfoundry.spec.names.project import Occurrence, ProjectNames
from simfoundry.spec.names.symbols import KINDS, Symbol
from simfoundry.spec.project import project_root
from simfoundry.spec.yaml.nodes import YamlError, is_word
from simfoundry.spec.yaml.text import Document, Read, parse

# Maximum length of a name [characters], as in the models.
MAX_NAME = 64

# Maximum number of reasons, or of lines that still contain the old name, which are shown.
MAX_SHOWN = 12

# Maximum length of such a line [characters], which fits beside its place.
MAX_EXCERPT = 120


class RenameError(SimfoundryError):
    """Raised if a symbol cannot be renamed. The message contains every reason, each with its place."""

    def __init__(self, what: str, reasons: list[str]) -> None:
        shown = list(dict.fromkeys(reasons))
        more = [f"and {len(shown) - MAX_SHOWN} more"] if len(shown) > MAX_SHOWN else []
        lines = [f" {shown[0]}"] if len(shown) == 1 else [f"\n  {reason}" for reason in [*shown[:MAX_SHOWN], *more]]
        super().__init__(f"{what}:{''.join(lines)}")
        self.reasons = tuple(shown)


@dataclass(frozen=True)
class TextEdit:
    """The replacement of one name in a text, by character offsets, with the place that is shown to users."""

    start: int
    end: int
    new: str
    line: int
    column: int


@dataclass(frozen=True)
class DocumentEdit:
    """The edits of one document, in the order of its text.

    Attributes:
        file: The resolved path of the document.
        before: Its text.
        edits: The replacements.
    """

    file: Path
    before: str
    edits: tuple[TextEdit, ...]

    @property
    def after(self) -> str:
        """Return the new text."""
        pieces, at = [], 0
        for edit in self.edits:
            pieces += [self.before[at : edit.start], edit.new]
            at = edit.end
        return "".join([*pieces, self.before[at:]])


def find_symbol(names: ProjectNames, file: Path, written: str, kind: str = "") -> Symbol:
    """Return the symbol that a person names for one document.

    Args:
        names: The names of the project.
        file: The document.
        written: The name: ``mug``, a name of a member such as ``cabinet.drawer``, with its section (``materials.oak``),
            or the path of the key that defines it.
        kind: The kind of the symbol, such as ``joint``, if several have the name; otherwise empty.

    Raises:
        RenameError: If nothing or several things have this name.
    """
    what = f"cannot rename `{written}`"
    if kind and kind not in KINDS.values():
        raise RenameError(what, [f"`{kind}` is not a kind of name; {nearest(kind, KINDS.values())}"])
    found = list(dict.fromkeys(_meant(names, file, tuple(written.split(".")), what)))
    chosen = [symbol for symbol in found if not kind or symbol.kind == kind]
    if not chosen:
        if found:
            listed = " and ".join(f"`--kind {each}`" for each in sorted({s.kind for s in found}))
            raise RenameError(what, [f"no {kind} has this name in {file}; there is {listed}"])
        known = {o.name for o in names.occurrences(file) if o.symbol is not None}
        hint = f"; {nearest(written.rpartition('.')[2], known)}" if known else ""
        raise RenameError(what, [f"nothing has this name in {file}{hint}"])
    if len(chosen) > 1:
        reasons = [f"{_place(names, symbol)}: {symbol}" for symbol in chosen]
        how = (
            "add `--kind`"
            if len({s.kind for s in chosen}) == len(chosen)
            else "write the path of the one that is meant"
        )
        raise RenameError(f"{what}, because several things have this name; {how}", reasons)
    return chosen[0]


def _meant(names: ProjectNames, file: Path, parts: tuple[str, ...], what: str) -> Iterator[Symbol]:
    """Yield what a name can mean in a document."""
    here = names.occurrences(file)
    keys = [o.symbol for o in here if o.path == parts and o.symbol is not None and o.name == parts[-1]]
    if len(parts) > 1 and keys:
        yield from keys
        return
    if len(parts) > 1 and parts[0] in KINDS:
        wanted = KINDS[parts[0]]
        inner = _meant(names, file, parts[1:], what)
        yield from (symbol for symbol in inner if symbol.kind == wanted) if len(parts) == 2 else inner
        return
    if len(parts) > 1:
        yield from names.members(file, parts)
        return
    (name,) = parts
    for section in KINDS:
        meaning = names.meaning(file, section, name)
        if meaning is None:
            continue
        first = meaning.segments[0][0]
        if len(meaning.segments) > 1 and first is not None:
            defined = f"{_place(names, meaning.symbol)}"
            reason = f"it is {meaning.symbol} of {defined} in {first}; rename either of them"
            raise RenameError(what, [reason])
        if meaning.symbol.name != name:
            raise RenameError(
                what, [f"it is a copy of {meaning.symbol}, whose copies follow its name; rename that one"]
            )
        yield names.same(meaning.symbol)
    yield from (o.symbol for o in here if o.symbol is not None and o.name == name == o.symbol.name)


def rename_edits(names: ProjectNames, symbol: Symbol, new: str) -> tuple[DocumentEdit, ...]:
    """Return the edits that rename a symbol in all documents of a project.

    Afterwards, every name in the project means the same as before.

    Args:
        names: The names of the project.
        symbol: The symbol.
        new: Its new name.

    Raises:
        RenameError: If the new name is not valid or already taken, or if the text of a document cannot be edited.
    """
    what = f"cannot rename {symbol} to `{new}`"
    if reasons := [*_invalid(symbol, new)]:
        raise RenameError(what, reasons)
    occurrences = names.references(names.same(symbol))
    reasons = [*_taken(names, occurrences, new), *_fixed(names, occurrences)]
    if reasons:
        raise RenameError(what, reasons)
    by_file: dict[str, list[TextEdit]] = {}
    for o in occurrences:
        by_file.setdefault(o.file, []).append(TextEdit(o.start, o.end, new, o.line, o.column))
    edits = tuple(
        DocumentEdit(Path(file), names.documents[file].index.text, tuple(changes)) for file, changes in by_file.items()
    )
    if reasons := [*_changed_meanings(names, edits)]:
        raise RenameError(what, reasons)
    return edits


def edited_reader(edits: tuple[DocumentEdit, ...], reader: Read) -> Read:
    """Return a function that reads documents as they are after the edits."""
    after = {str(edit.file): edit.after for edit in edits}

    def read_edited(path: Path) -> Document:
        text = after.get(os.path.realpath(path))
        return reader(path) if text is None else parse(text, str(path))

    return read_edited


def new_findings(
    names: ProjectNames, edits: tuple[DocumentEdit, ...], reader: Read | None = None
) -> dict[Severity, list[str]]:
    """Return the findings that the edited documents, and all documents that use them, would have and do not have now.

    Findings of geometry are not included. Documents are read with ``reader``, by default that of ``names``. Loading a
    document changes its nodes, so the reader must not return documents that are used otherwise.
    """
    reader = reader or names.reader
    affected = {str(edit.file) for edit in edits}
    affected |= {user for file in affected for user in names.dependents(file)}
    before = _findings(affected, reader)
    new: dict[Severity, list[str]] = {severity: [] for severity in Severity}
    for key, d in _findings(affected, edited_reader(edits, reader)).items():
        if key not in before:
            new[d.severity].append(f"{shown_path(d.file)}:{d.line}:{d.column}: {d.message}")
    return new


def _findings(files: set[str], reader: Read) -> dict[tuple[str, int, str, int], Diagnostic]:
    """Return the findings of documents by file, line, code, and count."""
    found: dict[tuple[str, int, str, int], Diagnostic] = {}
    known: dict[Path, Known] = {}
    for file in sorted(files):
        root = project_root(Path(file))
        counts: dict[tuple[str, int, str], int] = {}
        for d in load(Path(file), root, known.setdefault(root, {}), reader=reader).findings:
            key = (d.file, d.line, d.code)
            counts[key] = counts.get(key, 0) + 1
            found.setdefault((*key, counts[key]), d)
    return found


def shown_path(file: str | Path) -> str:
    """Return a path relative to the working folder if it is inside."""
    path = Path(file)
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else str(path)


def _place(names: ProjectNames, symbol: Symbol) -> str:
    found = [*names.definitions(symbol), *names.references(symbol)]
    return _at(found[0]) if found else shown_path(symbol.file)


def _at(o: Occurrence) -> str:
    return f"{shown_path(o.file)}:{o.line}:{o.column}"


def name_problem(new: str) -> str:
    """Return why a text cannot be a new name, or an empty string if it can."""
    if re.search(NAME, new) is None or "\n" in new:
        return PATTERNS[NAME].rule
    if len(new) > MAX_NAME:
        return f"a name has at most {MAX_NAME} characters"
    return f"YAML reads `{new}` as a value, not as a name" if is_word(new) else ""


def _invalid(symbol: Symbol, new: str) -> Iterator[str]:
    """Yield the reasons for which a text is no name for a symbol."""
    if problem := name_problem(new):
        yield problem
    elif new == symbol.name:
        yield "it already has this name"
    elif symbol.kind == "variant" and new == DEFAULT_VARIANT:
        yield f"`{DEFAULT_VARIANT}` is the object without overrides"


def _taken(names: ProjectNames, occurrences: tuple[Occurrence, ...], new: str) -> Iterator[str]:
    """Yield the places where the new name already has a meaning."""
    for o in occurrences:
        parent = names.documents[o.file].member(o.path[:-1])
        written = str(o.path[-1])
        if isinstance(parent, dict) and o.path[-1:] != () and o.symbol is not None and written in parent and o.is_key:
            key = written.replace(o.name, new, 1) if written != o.name else new
            if key in parent:
                yield f"{_at(o)}: `{key}` already exists beside it"
        section = o.symbol.section if o.symbol is not None else ()
        if len(section) == 1:
            meaning = names.meaning(Path(o.file), str(section[0]), new)
            if meaning is not None:
                yield f"{_place(names, names.same(meaning.symbol))}: `{new}` already means {meaning.symbol}"


def _fixed(names: ProjectNames, occurrences: tuple[Occurrence, ...]) -> Iterator[str]:
    """Yield the places that cannot be edited."""
    others: dict[tuple[str, int], str] = {}  # what else an alias of a text names
    symbols = {o.symbol for o in occurrences}
    for file in {o.file for o in occurrences}:
        for o in names.occurrences(file):
            if o.symbol not in symbols:
                others[file, o.start] = str(o.symbol) if o.symbol is not None else "something else"
    root = names.root.resolve()
    for o in occurrences:
        if names.documents[o.file].index.text[o.start : o.end] != o.name:
            yield f"{_at(o)}: the name is written with escapes; write it as `{o.name}` first"
        elif not Path(o.file).is_relative_to(root):
            yield f"{_at(o)}: this file is outside the project {root}"
        elif (o.file, o.start) in others:
            yield f"{_at(o)}: an alias of this text names {others[o.file, o.start]} as well; write it out first"


def _changed_meanings(names: ProjectNames, edits: tuple[DocumentEdit, ...]) -> Iterator[str]:
    """Yield the places where a name would mean something else after the edits."""
    edited = {str(edit.file): edit for edit in edits}
    try:
        after = ProjectNames(names.root, [Path(file) for file in names.documents], edited_reader(edits, names.reader))
    except YamlError as error:  # not reached, because names are replaced by names
        yield str(error)
        return
    there: dict[Symbol | None, Symbol | None] = {None: None}
    back: dict[Symbol | None, Symbol | None] = {None: None}
    for file in names.documents:
        old, now = names.occurrences(file), after.occurrences(file)
        shift = _shift(edited.get(file))
        if [shift(o.start) for o in old] != [o.start for o in now]:
            where = next(
                (o for o, p in zip(old, now, strict=False) if shift(o.start) != p.start), old[-1] if old else None
            )
            yield f"{_at(where) if where is not None else shown_path(file)}: the text would have another structure"
            continue
        is_of_any_scene = names.documents[file].kind in ANY_SCENE
        for o, p in zip(old, now, strict=True):
            if is_of_any_scene and None in (o.symbol, p.symbol):  # it can be used with several scenes
                continue
            if there.setdefault(o.symbol, p.symbol) != p.symbol or back.setdefault(p.symbol, o.symbol) != o.symbol:
                meaning = f"{o.symbol}" if o.symbol is not None else "nothing"
                other = f"{p.symbol}" if p.symbol is not None else "nothing"
                then = f"{other} too, so that it could not be distinguished from others" if other == meaning else other
                yield f"{_at(o)}: `{o.name}` means {meaning}, and would then mean {then}"


def _shift(edit: DocumentEdit | None) -> Callable[[int], int]:
    """Return the function from an offset before the edits to the offset after them."""
    if edit is None:
        return lambda offset: offset
    grown, total = [], 0
    for each in edit.edits:
        grown.append((each.start, total))
        total += len(each.new) - (each.end - each.start)
    ends = [each.end for each in edit.edits]

    def shifted(offset: int) -> int:
        passed = bisect_right(ends, offset)
        return offset + (grown[passed][1] if passed < len(grown) else total)

    return shifted


def remaining_lines(names: ProjectNames, edits: tuple[DocumentEdit, ...], old: str) -> list[str]:
    """Return the lines that contain the old name as a word after the edits, such as comments and instructions.

    Lines in which the word is the name of something else are omitted. The documents are the edited ones and those that
    use them.
    """
    word = re.compile(rf"(?<![A-Za-z0-9_]){re.escape(old)}(?![A-Za-z0-9_])")
    after = {str(edit.file): edit.after for edit in edits}
    affected = after.keys() | {user for file in after for user in names.dependents(file)}
    found: list[str] = []
    for file in sorted(affected & names.documents.keys()):
        text = names.documents[file].index.text
        named = {o.start for o in names.occurrences(file)}
        lines = (text.count("\n", 0, m.start()) for m in word.finditer(text) if m.start() not in named)
        rows = after.get(file, text).split("\n")  # a rename does not change the number of lines
        found += [f"{shown_path(file)}:{line + 1}: {_excerpt(rows[line])}" for line in dict.fromkeys(lines)]
    return found


def _excerpt(row: str) -> str:
    """Return a line for display, without indentation and a byte order mark."""
    return row.lstrip("\ufeff").strip()[:MAX_EXCERPT]
