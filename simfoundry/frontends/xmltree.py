"""Read untrusted XML files with line numbers: no entities, no external files, bounded size.

This module uses Expat, because neither lxml nor defusedxml is suitable: of 2,380 public files, lxml rejects 28 that
simulators load (26 files of PyBullet declare XML 0.0, two COLLADA files have texts of over 10 MB), and it reports the
last line of a tag rather than the first; defusedxml, like lxml, handles namespaces and rejects undeclared prefixes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from simfoundry.frontends.errors import ImportRefusedError

MAX_BYTES = 50_000_000
"""Largest file size [bytes]; the largest of 2,380 public models has 21 MB."""

MAX_ELEMENTS = 500_000
"""Largest number of elements, which takes a second and 200 MB; the largest public model has a tenth of them."""

MAX_DEPTH = 200
"""Largest nesting depth; a chain of bodies in MJCF has one level per joint."""


@dataclass(eq=False)
class Element:
    """Element of an XML file, with the line where it starts."""

    file: Path
    tag: str
    line: int
    attributes: dict[str, str]
    children: list[Element] = field(default_factory=list)

    def refused(self, message: str, hint: str = "") -> ImportRefusedError:
        """Return an error at this element."""
        return ImportRefusedError(self.file, message, self.line, hint)

    def all(self, tag: str) -> Iterator[Element]:
        """Return the children with a tag."""
        return (child for child in self.children if child.tag == tag)

    def first(self, tag: str) -> Element | None:
        """Return the first child with a tag."""
        return next(self.all(tag), None)

    def walk(self) -> Iterator[Element]:
        """Yield this element and all below it."""
        yield self
        for child in self.children:
            yield from child.walk()

    def get(self, name: str) -> str | None:
        """Return the text of an attribute without surrounding spaces; None if it is absent or empty."""
        return self.attributes.get(name, "").strip() or None

    def need(self, name: str) -> str:
        """Return the text of a required attribute."""
        text = self.get(name)
        if text is None:
            raise self.refused(f"`<{self.tag}>` has no `{name}`")
        return text

    def numbers(self, name: str, count: int, default: tuple[float, ...] | None = None) -> tuple[float, ...]:
        """Return an attribute of ``count`` numbers; it is required unless there is a default."""
        text = self.need(name) if default is None else self.get(name)
        if text is None:
            assert default is not None
            return default
        try:
            values = tuple(float(word) for word in text.split())
        except ValueError:
            values = ()
        if len(values) != count or not all(map(math.isfinite, values)):
            counted = "a number" if count == 1 else f"{count} numbers"
            raise self.refused(f"`{name}` of `<{self.tag}>` is `{text[:60]}`, not {counted}")
        return values

    def number(self, name: str, default: float | None = None) -> float:
        """Return an attribute of one number; it is required unless there is a default."""
        return self.numbers(name, 1, None if default is None else (default,))[0]


def read_xml(path: Path, root_tag: str | None = None) -> Element:
    """Return the root element of an XML file; raises :class:`ImportRefusedError` for invalid or malicious files."""
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
    """Builds elements from expat events; entity declarations are rejected before use."""

    def __init__(self, path: Path) -> None:
        self.path, self.count = path, 0
        self.root: Element | None = None
        self.stack: list[Element] = []
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = self.end
        self.parser.EntityDeclHandler = self.entity

    def read(self, data: bytes) -> Element:
        try:
            self.parser.Parse(data, True)
        except expat.ExpatError as error:
            reason = expat.ErrorString(error.code)
            raise ImportRefusedError(self.path, f"it is not XML: {reason}", error.lineno) from None
        except (ValueError, LookupError) as error:  # an encoding that Python does not support
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

    def entity(self, name: str, *_: object) -> None:
        message = f"it defines the entity `{name}`"
        raise ImportRefusedError(self.path, message, self.parser.CurrentLineNumber, "write out what it stands for")
