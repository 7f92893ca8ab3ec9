"""Strict YAML 1.2 reader that records the position of every value.

Specs are plain data: mappings with string keys, sequences, strings, numbers, booleans, and null. Tags, merge keys,
duplicate keys, and multiple documents are errors. Depth, size, and the expansion of aliases are bounded.
"""

from __future__ import annotations

import errno
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import yaml

from simfoundry.spec.diagnostics import Diagnostic, Fix, Severity
from simfoundry.spec.yaml.nodes import EVENTS, Composer, Node, YamlError
from simfoundry.spec.yaml.tokens import token_at, word_in

# Maximum size of a text [bytes]; a scene with 1,000 objects requires 0.14 MiB.
MAX_BYTES = 4 * 2**20

# Characters that must be escaped in a YAML text.
UNPRINTABLE = re.compile("[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
Path_ = tuple[str | int, ...]


@dataclass(frozen=True)
class Mark:
    """The wrong word in a key or value, and what can be written instead.

    Attributes:
        word: The word, or an empty string for the whole key or value, including its quotes.
        index: The index of the word in the value, without quotes.
        fixes: The corrections of the word.
    """

    word: str = ""
    index: int = 0
    fixes: tuple[Fix, ...] = ()


@dataclass(frozen=True)
class Document:
    """A parsed text, which consists of plain ``data`` (mappings, tuples, scalars) and the tree of positions."""

    file: str
    text: str
    data: Any
    root: Node
    duplicates: tuple[Diagnostic, ...]
    added: dict[Path_, tuple[str, ...]] = field(default_factory=dict)
    """Members that this document adds to its base, as a mapping from their paths to the names of the base's members."""
    texts: Mapping[str, str] = field(default_factory=dict)
    """Texts of the other files whose values this document contains, such as those of its bases."""

    def section(self, name: str) -> dict[str, Any]:
        """Return the data of a section by name. The result is empty if the section is missing or is not a mapping."""
        members = self.data.get(name) if isinstance(self.data, dict) else None
        return members if isinstance(members, dict) else {}

    def place(self, path: Sequence[str | int], of_key: bool = False) -> tuple[int, int]:
        """Return the line and column of the value at ``path`` (or of its key), or of the nearest existing ancestor.

        For a mapping, this is the position of its key, because the mapping's text starts with its first member's key.
        Parts of ``path`` that do not exist in the data, such as the tags of a union, are skipped.
        """
        key = leaf = self.root.place
        for _, key, node in self._walk(path):
            leaf = key if isinstance(node.children, dict) else node.place
        return key if of_key else leaf

    def source(self, path: Sequence[str | int]) -> str:
        """Return the file that :meth:`place` refers to."""
        files = [self.root.file, *(node.file for _, _, node in self._walk(path))]
        return files[-1] or self.file

    def finding(
        self,
        code: str,
        path: Sequence[str | int],
        message: str,
        hint: str = "",
        severity: Severity = Severity.ERROR,
        of_key: bool = False,
        mark: Mark | None = None,
    ) -> Diagnostic:
        """Return a finding at ``path``, or at the word that ``mark`` describes in the key or value there."""
        line, column = self.place(path, of_key)
        dotted, file = ".".join(map(str, path)), self.source(path)
        plain = "" if of_key else next((node.plain for *_, node in reversed([*self._walk(path)])), "")
        found = Diagnostic(code, severity, message, file, line, column, dotted, hint)
        mark = mark or Mark()
        if of_key and mark.fixes and not mark.word:  # they replace the key, and not a part of it
            mark = replace(mark, word=next((str(part) for part in reversed(self.known(path))), ""))
        return self.marked(found, mark, plain)

    def marked(self, finding: Diagnostic, mark: Mark, plain: str = "") -> Diagnostic:
        """Return a finding with the wrong word at its place and the fixes of a mark, if they apply to the text.

        A value that was rewritten, such as a name in an included scene, is marked as a whole and without fixes.
        ``plain`` is the text of the value if it has no quotes.
        """
        lines = self._lines(finding.file)
        line = lines[finding.line - 1] if 0 < finding.line <= len(lines) else ""
        token = token_at(line, finding.column, plain)
        if not mark.word:
            return replace(finding, word=token, fixes=mark.fixes if token else ())
        start = word_in(token, mark.word, mark.index)
        if start < 0:
            return replace(finding, word=token)
        return replace(finding, column=finding.column + start, word=mark.word, fixes=mark.fixes)

    def completed(self, finding: Diagnostic) -> Diagnostic:
        """Return a finding that was created without the text, with the wrong word at its place."""
        if not finding.line or not self._lines(finding.file):
            return finding
        return self.marked(finding, Mark(finding.word, 0, finding.fixes))

    def _lines(self, file: str) -> list[str]:
        """Return the lines of a file whose values this document contains."""
        if file not in self._split:
            text = self.text if file == self.file else self.texts.get(file, "")
            self._split[file] = text.removeprefix("\ufeff").splitlines()
        return self._split[file]

    @cached_property
    def _split(self) -> dict[str, list[str]]:
        return {}

    def known(self, path: Sequence[str | int]) -> Path_:
        """Return the parts of ``path`` that exist in the data."""
        return tuple(part for part, _, _ in self._walk(path))

    def _walk(self, path: Sequence[str | int]) -> Iterator[tuple[str | int, tuple[int, int], Node]]:
        """Yield each existing part of ``path``, with the position of its key (or item) and its value."""
        node = self.root
        for part in path:
            if isinstance(node.children, dict) and part in node.children:
                key, node = node.keys[str(part)], node.children[str(part)]
                yield part, key, node
            elif isinstance(node.children, list) and isinstance(part, int) and part < len(node.children):
                node = node.children[part]
                yield part, node.place, node


# Function that reads the document at a path, such as :func:`read`; an editor returns the text of an open file instead.
Read = Callable[[Path], Document]


def read(path: Path) -> Document:
    """Read and parse a file.

    Raises:
        YamlError: If the file could not be read; the error contains the position.
    """
    return parse(read_text(path), str(path))


def read_text(path: Path) -> str:
    """Return the text of a file.

    Raises:
        YamlError: If the file could not be read; the error contains the position.
    """
    try:
        if path.exists() and not path.is_file():
            raise YamlError("SF001", "this is not a file")
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise YamlError("SF005", f"the file is {size / 2**20:.0f} MiB; the limit is {MAX_BYTES // 2**20} MiB")
        data = path.read_bytes()
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        place = _position(data[: error.start].decode("utf-8"))
        message = f"the byte 0x{data[error.start]:02x} is not valid UTF-8"
        raise YamlError("SF001", message, *place, "save the file as UTF-8") from None
    except OSError as error:
        if error.errno == errno.ELOOP:
            hint = "make one of the links point to a file, or remove them"
            raise YamlError("SF001", "the file could not be read: its symbolic links form a cycle", hint=hint) from None
        raise YamlError("SF001", f"the file could not be read: {error.strerror or error}") from None


def _position(before: str) -> tuple[int, int]:
    """Return the line and column, counted from 1, of the character that follows the text ``before``."""
    lines = f"{before}.".splitlines()
    return len(lines), len(lines[-1])


# Marker lines of a git conflict, in order; a repository may use markers longer than seven characters.
_MARKERS = tuple(re.compile(pattern) for pattern in (r"<{7,}(?: |$)", r"={7,}$", r">{7,}(?: |$)"))


def _conflict(text: str) -> int:
    """Return the line, counted from 1, at which a git conflict starts, or 0 if the text does not contain a conflict."""
    start, wanted = 0, 0
    for number, line in enumerate(text.splitlines() if "<<<<<<<" in text else (), 1):
        if _MARKERS[wanted].match(line):
            start, wanted = (start or number), wanted + 1
            if wanted == len(_MARKERS):
                return start
    return 0


def parse(text: str, file: str = "<text>") -> Document:
    """Parse a text.

    Raises:
        YamlError: If the text could not be parsed; the error contains the position.
    """
    try:
        return _parsed(text, file)
    except YamlError as error:
        if not error.word:
            lines = text.removeprefix("\ufeff").splitlines()
            error.word = token_at(lines[error.line - 1], error.column) if 0 < error.line <= len(lines) else ""
        raise


def _parsed(text: str, file: str) -> Document:
    conflict = _conflict(text)
    if conflict:
        hint = "choose the lines to keep and remove the markers, or merge semantically: `simfoundry git install`, then "
        hint += f"`git checkout --merge -- {file}`"
        raise YamlError("SF209", "unresolved git conflict", conflict, 1, hint)
    odd = UNPRINTABLE.search(text, 1 if text.startswith("\ufeff") else 0)
    if odd is not None:
        message = f"the character U+{ord(odd.group()):04X} is not allowed in YAML"
        hint = "remove it, or write it as an escape in double quotes"
        raise YamlError("SF002", message, *_position(text[: odd.start()]), hint)
    composer = Composer(file)
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        next_event = loader(text).get_event
        while type(event := next_event()) is not yaml.StreamEndEvent:
            EVENTS[type(event)](composer, event)
    except yaml.YAMLError as error:
        raise _unquoted_color(_before(error, text), None) or _syntax_error(error, text) from None
    root = composer.roots[0] if composer.roots else Node(None, 1, 1)
    if (unquoted := _unquoted_color(text, root)) is not None:
        raise unquoted
    document = Document(file, text, root.value, root, ())
    return replace(document, duplicates=tuple(map(document.completed, composer.duplicates)))


# Color key followed by a hexadecimal color without quotes, which YAML reads as a comment.
_UNQUOTED_COLOR = re.compile(
    r"""^(?:[^#"'\n]|"[^"\n]*"|'[^'\n]*')*?\bcolor *: +(#(?:[0-9A-Fa-f]{8}|[0-9A-Fa-f]{6}))\b""", re.MULTILINE
)


def _unquoted_color(text: str, root: Node | None) -> YamlError | None:
    """Return the error for a hexadecimal color without quotes, or None if there is none.

    If the text could be parsed, ``root`` is its content, in which the key of the color must have no value.
    """
    for found in _UNQUOTED_COLOR.finditer(text) if "color: #" in text or "color:  #" in text else ():
        line, column = _position(text[: found.start(1)])
        if root is None or _has_null_at(root, line):
            message = f"`{found[1]}` is a comment, because YAML comments start with `#`"
            hint = f'put the color in quotes: `color: "{found[1]}"`'
            return YamlError("SF002", message, line, column, hint, found[1], (Fix(f'"{found[1]}"', certain=True),))
    return None


def _has_null_at(root: Node, line: int) -> bool:
    todo = [root]
    while todo:
        node = todo.pop()
        if isinstance(node.children, dict):
            child = node.children.get("color")
            if child is not None and child.value is None and node.keys["color"][0] == line:
                return True
        todo += node.members
    return False


@cache
def _known_problems() -> tuple[dict[str, str], ...]:
    known: tuple[dict[str, str], ...] = read(Path(__file__).with_name("syntax.yaml")).data
    return known


def _before(error: yaml.YAMLError, text: str) -> str:
    """Return the lines of a text up to the one with a syntax error."""
    mark = getattr(error, "problem_mark", None)
    return text if mark is None else "\n".join(text.splitlines()[: mark.line + 1])


def _syntax_error(error: yaml.YAMLError, text: str) -> YamlError:
    mark = getattr(error, "problem_mark", None)
    problem = getattr(error, "problem", None) or getattr(error, "reason", None) or str(error)
    if mark is None:
        return YamlError("SF002", problem)
    line, column = mark.line + 1, mark.column + 1
    opening = getattr(error, "context_mark", None)
    if opening is not None and opening.line < mark.line and "expected ':'" in problem and _is_quote(text, opening):
        return YamlError("SF002", "these quotes are not closed", opening.line + 1, opening.column + 1)
    if "cannot start any token" in problem:
        found = text.removeprefix("\ufeff").splitlines()[mark.line][mark.column :]
        if found[:1] != "\t":
            message = f"an unquoted string cannot start with `{found[:1]}`"
            unquoted = _UNQUOTED.match(found)
            fixes = (Fix(f'"{unquoted[0]}"'),) if unquoted is not None else ()
            hint = "put it in double quotes"
            return YamlError("SF002", message, line, column, hint, unquoted[0] if unquoted is not None else "", fixes)
        problem = "tab character"
    if "':'" in problem or "mapping values" in problem:
        key = _key_without_colon(text, mark.line)
        if key is not None:
            line, column, word = key
            fixes = (Fix(f"{word} " if word.endswith(":") else f"{word}:", certain=True),)
            message = "a `:` and a space are missing after the key"
            return YamlError("SF002", message, line, column, "write `key: value`", word, fixes)
    for row in (row for row in _known_problems() if row["phrase"] in problem):
        start = opening.line + 1 if opening is not None else line
        if "expected ',' or" in row["phrase"] and opening is not None and _has_ended(text, opening.line, mark.line):
            kind, bracket = ("list", "[") if "]" in row["phrase"] else ("mapping", "{")
            message, hint = f"the {kind} that starts here is not closed", f"close each `{bracket}`"
            return YamlError("SF002", message, start, opening.column + 1, hint)
        if not row["hint"] and opening is not None:  # reported at the end of the text, but caused here
            line, column = start, opening.column + 1
        return YamlError("SF002", row["message"], line, column, row["hint"].format(start=start))
    return YamlError("SF002", problem, line, column)


def _is_quote(text: str, mark: Any) -> bool:
    line = text.removeprefix("\ufeff").splitlines()[mark.line]
    return line[mark.column : mark.column + 1] in ("'", '"')


# Line that consists of one word, or of a word and a value with a colon but no space between them.
_WITHOUT_COLON = re.compile(r" *(?:- )? *([A-Za-z_][A-Za-z0-9_]*)(?: +[^\s#:]|(:)[^\s:]|[ \t]*(?:#|$))")

# Text of a string that needs quotes, up to a comment or the end of its place in brackets.
_UNQUOTED = re.compile(r"[^\s,\[\]{}\"\\#](?:(?!:\s|\s#|\s*$)[^,\[\]{}\"\\])*")


def _key_without_colon(text: str, line: int) -> tuple[int, int, str] | None:
    """Return the line, column and text of a key without a colon above a syntax error, or None if there is none.

    A colon that is not followed by a space is part of the text.

    YAML reads such a line as the start of a string that continues on the line with the error.
    """
    lines = text.splitlines()
    for above in range(line - 1, -1, -1):
        if ": " in lines[above] or lines[above].rstrip().endswith((":", ",", "|", ">")):
            return None
        found = _WITHOUT_COLON.match(lines[above])
        if found is not None:
            return above + 1, found.start(1) + 1, found[1] + (found[2] or "")
    return None


def _has_ended(text: str, opening: int, line: int) -> bool:
    """Return True if a line is not indented further than an earlier line, in which a bracket opens."""
    lines = text.splitlines()
    if line <= opening or line >= len(lines):
        return line > opening
    start, end = (len(lines[k]) - len(lines[k].lstrip()) for k in (opening, line))
    return end <= start and lines[line].strip()[:1] not in ("]", "}")
