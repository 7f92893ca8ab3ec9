"""Read untrusted files: bounded XML with line numbers, bounded JSON, and the files that they refer to.

XML is read with Expat, because neither lxml nor defusedxml is suitable: of 2,380 public files, lxml rejects 28 that
simulators load (26 files of PyBullet declare XML 0.0, two COLLADA files have texts of over 10 MB), and it reports the
last line of a tag rather than the first; defusedxml, like lxml, handles namespaces and rejects undeclared prefixes.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote
from xml.parsers import expat

from simfoundry.frontends.errors import ImportRefusedError

MAX_XML_BYTES, MAX_JSON_BYTES = 50_000_000, 100_000_000
"""Largest file sizes [bytes], which bound memory use: the largest of 2,380 public XML models has 21 MB, and the largest
scene of OmniGibson 3 MB."""

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
        if default is not None and self.get(name) is None:
            return default
        text = self.need(name)
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
    stack: list[Element] = []
    roots: list[Element] = []
    parser, count = expat.ParserCreate(), 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        element = Element(path, tag, parser.CurrentLineNumber, attributes)
        if count > MAX_ELEMENTS or len(stack) >= MAX_DEPTH:
            raise element.refused(f"it has more than {MAX_ELEMENTS} elements, or more than {MAX_DEPTH} levels")
        (stack[-1].children if stack else roots).append(element)
        stack.append(element)

    def entity(name: str, *_: object) -> None:
        message = f"it defines the entity `{name}`"
        raise ImportRefusedError(path, message, parser.CurrentLineNumber, "write out what it stands for")

    parser.StartElementHandler, parser.EndElementHandler = start, lambda _: stack.pop()
    parser.EntityDeclHandler = entity
    try:
        parser.Parse(_bounded_bytes(path, MAX_XML_BYTES), True)
    except expat.ExpatError as error:
        raise ImportRefusedError(path, f"it is not XML: {expat.ErrorString(error.code)}", error.lineno) from None
    except (ValueError, LookupError) as error:  # an encoding that Python does not support
        raise ImportRefusedError(path, f"it is not XML: {error}") from None
    (root,) = roots
    if root_tag is not None and root.tag != root_tag:
        raise root.refused(f"its root is `<{root.tag}>`, not `<{root_tag}>`")
    return root


def read_json(path: Path) -> Any:
    """Return the content of a JSON file; raises :class:`ImportRefusedError`."""
    try:
        return json.loads(_bounded_bytes(path, MAX_JSON_BYTES))
    except json.JSONDecodeError as error:
        raise ImportRefusedError(path, f"it is not JSON: {error.msg}", error.lineno) from None
    except (UnicodeDecodeError, RecursionError):
        raise ImportRefusedError(path, "it is not JSON") from None


def _bounded_bytes(path: Path, most: int) -> bytes:
    try:
        with path.open("rb") as stream:
            data = stream.read(most + 1)
    except OSError as error:
        raise ImportRefusedError(path, f"it cannot be read: {error.strerror}") from None
    if len(data) > most:
        raise ImportRefusedError(path, f"it is larger than {most // 1_000_000} MB")
    return data


MAX_FILE_BYTES = 500_000_000
"""Largest size [bytes] of a referenced file, which bounds memory use; meshes and textures of scenes are smaller."""

LEVELS = 5
"""Number of parent folders that are searched for a package: ROS nests share/package/robots/name/urdf."""

MAX_REFERENCE = 1000
"""Longest reference [characters]; file systems allow fewer."""

_PACKAGE = re.compile(r"(?:package|model)://(.*)\Z", re.DOTALL)


class NotFoundError(Exception):
    """Error with the reason why a referenced file is not available, as the end of a sentence."""


@dataclass(frozen=True)
class FileSearch:
    """Looks up files that ``file`` refers to, below ``root`` or in the folder of one of ``packages``."""

    file: Path
    packages: Mapping[str, Path] = field(default_factory=dict)

    @property
    def root(self) -> Path:
        """Return the folder that must contain all files: the package of the file, or its parent folder."""
        folder = self.file.resolve().parent
        for candidate in (folder, *folder.parents[:LEVELS]):
            if any((candidate / mark).exists() for mark in ("package.xml", ".git", "simfoundry.yaml")):
                return candidate
        return folder.parent if folder.parent != Path(folder.anchor) else folder

    def find(self, reference: str, folder: Path | None = None) -> Path:
        """Return the file of a reference relative to ``folder`` (by default the folder of the file).

        Raises :class:`NotFoundError`.
        """
        if "\0" in reference or len(reference) > MAX_REFERENCE:
            raise NotFoundError("is no file name")
        reference = reference.replace("\\", "/")
        package = _PACKAGE.match(reference)
        outside = False
        for candidate, root in self._in_package(unquote(package[1])) if package else self._beside(reference, folder):
            target = candidate.resolve()
            if target.is_file() and not target.is_relative_to(root.resolve()):
                outside = True
            elif target.is_file():
                if target.stat().st_size > MAX_FILE_BYTES:
                    raise NotFoundError(f"is larger than {MAX_FILE_BYTES // 1_000_000} MB")
                return target
        if outside:
            hint = "name the folder that it belongs to with `--package NAME=PATH`"
            raise NotFoundError(f"lies outside {self.root}; {hint}")
        if package:
            name = package[1].lstrip("/").partition("/")[0]
            raise NotFoundError(f"is not found; say where its package lies: `--package {name}=PATH`")
        raise NotFoundError("does not exist")

    def need(self, reference: str, file: Path, line: int, folder: Path | None = None) -> Path:
        """Return the file of a reference on a line of ``file``; raises :class:`ImportRefusedError` with that line."""
        try:
            return self.find(reference, folder)
        except NotFoundError as error:
            raise missing_file(file, line, reference, error) from None

    def _beside(self, reference: str, folder: Path | None) -> Iterator[tuple[Path, Path]]:
        reference = reference.removeprefix("file://")
        yield (folder or self.file.resolve().parent) / reference, self.root
        yield from ((place / reference, place) for place in self.packages.values())

    def _in_package(self, path: str) -> Iterator[tuple[Path, Path]]:
        """Yield candidates for ``package://NAME/REST``: named packages, then parent folders, then without the name."""
        path = path.lstrip("/")
        name, _, rest = path.partition("/")
        if name in ("", ".", ".."):
            return
        if name in self.packages:
            yield self.packages[name] / rest, self.packages[name]
            return
        here = self.file.resolve().parent
        above = [here, *here.parents[:LEVELS]]
        for folder in above:
            if folder.name == name:
                yield folder / rest, folder
            yield folder / name / rest, folder / name
        yield from ((place / path, place) for place in self.packages.values())
        yield from ((folder / path, self.root) for folder in above[:3])


def missing_file(file: Path, line: int, reference: str, error: NotFoundError) -> ImportRefusedError:
    """Return the error for a file that refers to an unavailable file."""
    return ImportRefusedError(file, f"`{reference[:120]}` {error}", line)
