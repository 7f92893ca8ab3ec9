"""XML in, with line numbers, from files that nobody vouches for: no entities, no external files, bounded size."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from simfoundry.frontends.errors import ImportRefusedError

MAX_BYTES = 50_000_000
MAX_ELEMENTS = 500_000
MAX_DEPTH = 200


@dataclass(eq=False)
class Element:
    """An element of an XML file, with the line where it starts."""

    file: Path
    tag: str
    line: int
    attributes: dict[str, str]
    children: list[Element] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)

    @property
    def text(self) -> str:
        """The text between its tags, without that of its children."""
        return "".join(self.texts)

    def refused(self, message: str, hint: str = "") -> ImportRefusedError:
        """An error at this element."""
        return ImportRefusedError(self.file, message, self.line, hint)

    def all(self, tag: str) -> Iterator[Element]:
        """The children with a tag."""
        return (child for child in self.children if child.tag == tag)

    def first(self, tag: str) -> Element | None:
        """The first child with a tag."""
        return next(self.all(tag), None)

    def walk(self) -> Iterator[Element]:
        """This element and all below it."""
        yield self
        for child in self.children:
            yield from child.walk()

    def get(self, name: str) -> str | None:
        """The text of an attribute, without spaces around it; None where it is absent or empty."""
        return self.attributes.get(name, "").strip() or None

    def need(self, name: str) -> str:
        """The text of an attribute that must be there."""
        text = self.get(name)
        if text is None:
            raise self.refused(f"`<{self.tag}>` has no `{name}`")
        return text

    def numbers(self, name: str, count: int, default: tuple[float, ...] | None = None) -> tuple[float, ...]:
        """An attribute of ``count`` numbers; without a default it must be there."""
        text = self.need(name) if default is None else self.get(name)
        if text is None:
            assert default is not None
            return default
        words = text.split()
        try:
            values = tuple(float(word) for word in words)
        except ValueError:
            raise self.refused(f"`{name}` of `<{self.tag}>` is `{text[:60]}`, not {_counted(count)}") from None
        if len(values) != count or not all(map(math.isfinite, values)):
            raise self.refused(f"`{name}` of `<{self.tag}>` is `{text[:60]}`, not {_counted(count)}")
        return values

    def number(self, name: str, default: float | None = None) -> float:
        """An attribute of one number; without a default it must be there."""
        return self.numbers(name, 1, None if default is None else (default,))[0]


def _counted(count: int) -> str:
    return "a number" if count == 1 else f"{count} numbers"


def read_xml(path: Path, root_tag: str | None = None) -> Element:
    """The root element of an XML file; raises :class:`ImportRefusedError` for what is none, or means harm."""
    try:
        data = path.open("rb").read(MAX_BYTES + 1)
    except OSError as error:
        raise ImportRefusedError(path, f"it cannot be read: {error.strerror}") from None
    if len(data) > MAX_BYTES:
        raise ImportRefusedError(path, f"it is larger than {MAX_BYTES // 1_000_000} MB")
    root = _Reader(path).read(data)
    if root_tag is not None and root.tag != root_tag:
        raise root.refused(f"its root is `<{root.tag}>`, not `<{root_tag}>`")
    return root


class _Reader:
    """Builds elements while expat reads; entities are refused before one is used."""

    def __init__(self, path: Path) -> None:
        self.path, self.count = path, 0
        self.root: Element | None = None
        self.stack: list[Element] = []
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = self.end
        self.parser.CharacterDataHandler = self.text
        self.parser.EntityDeclHandler = self.entity
        self.parser.buffer_text = True

    def read(self, data: bytes) -> Element:
        try:
            self.parser.Parse(data, True)
        except expat.ExpatError as error:
            reason = expat.ErrorString(error.code)
            raise ImportRefusedError(self.path, f"it is not XML: {reason}", error.lineno) from None
        except (ValueError, LookupError) as error:  # an encoding that Python does not know
            raise ImportRefusedError(self.path, f"it is not XML: {error}") from None
        assert self.root is not None
        return self.root

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        self.count += 1
        element = Element(self.path, tag, self.parser.CurrentLineNumber, attributes)
        if self.count > MAX_ELEMENTS or len(self.stack) >= MAX_DEPTH:
            raise element.refused(f"it has more than {MAX_ELEMENTS} elements, or more than {MAX_DEPTH} levels")
        if self.stack:
            self.stack[-1].children.append(element)
        else:
            self.root = element
        self.stack.append(element)

    def end(self, _tag: str) -> None:
        self.stack.pop()

    def text(self, text: str) -> None:
        if not text.isspace():
            self.stack[-1].texts.append(text)

    def entity(self, name: str, *_: object) -> None:
        message = f"it defines the entity `{name}`"
        raise ImportRefusedError(self.path, message, self.parser.CurrentLineNumber, "write out what it stands for")
