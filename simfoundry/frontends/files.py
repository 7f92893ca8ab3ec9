"""Read untrusted XML and JSON files of limited size, and find the files they reference.

This module parses XML with Expat because neither lxml nor defusedxml is suitable. Among 2,380 public files, lxml
rejects 28 that simulators accept (26 PyBullet files declare XML 0.0, and two COLLADA files contain text nodes larger
than 10 MB). It also reports the last line of a tag rather than the first. Like lxml, defusedxml processes namespaces
and therefore rejects undeclared prefixes.
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

# Maximum file sizes [bytes], which limit memory use.
#
# The largest of 2,380 public XML models is 21 MB, and the largest OmniGibson scene is 3 MB.
MAX_XML_BYTES, MAX_JSON_BYTES = 50_000_000, 100_000_000

# Maximum number of elements. Reading this many takes a second and 200 MB; the largest public model has a tenth of them.
MAX_ELEMENTS = 500_000

# Maximum nesting depth; a kinematic chain in MJCF has one level per body.
MAX_DEPTH = 200


@dataclass(eq=False)
class Element:
    """An element in an XML file and the line on which it starts."""

    file: Path
    tag: str
    line: int
    attributes: dict[str, str]
    children: list[Element] = field(default_factory=list)

    def refused(self, message: str, hint: str = "") -> ImportRefusedError:
        """Return an error located at this element."""
        return ImportRefusedError(self.file, message, self.line, hint)

    def all(self, tag: str) -> Iterator[Element]:
        """Return the children with the given tag."""
        return (child for child in self.children if child.tag == tag)

    def first(self, tag: str) -> Element | None:
        """Return the first child with the given tag, or None."""
        return next(self.all(tag), None)

    def walk(self) -> Iterator[Element]:
        """Yield this element and all of its descendants."""
        yield self
        for child in self.children:
            yield from child.walk()

    def get(self, name: str) -> str | None:
        """Return the value of an attribute without surrounding whitespace, or None if it is missing or empty."""
        return self.attributes.get(name, "").strip() or None

    def need(self, name: str) -> str:
        """Return the value of a required attribute."""
        if (text := self.get(name)) is None:
            raise self.refused(f"`<{self.tag}>` has no `{name}`")
        return text

    def numbers(self, name: str, count: int, default: tuple[float, ...] | None = None) -> tuple[float, ...]:
        """Return the numbers in an attribute that must contain ``count`` numbers.

        The attribute is required unless a default is given.
        """
        if default is not None and self.get(name) is None:
            return default
        text = self.need(name)
        try:
            values = tuple(float(word) for word in text.split())
        except ValueError:
            values = ()
        if len(values) != count or not all(map(math.isfinite, values)):
            counted = "a number" if count == 1 else f"{count} numbers"
            raise self.refused(f"`{name}` of `<{self.tag}>` must be {counted}, not `{text[:60]}`")
        return values

    def number(self, name: str, default: float | None = None) -> float:
        """Return the number in an attribute that must contain exactly one number.

        The attribute is required unless a default is given.
        """
        return self.numbers(name, 1, None if default is None else (default,))[0]


def read_xml(path: Path, root_tag: str | None = None) -> Element:
    """Return the root element of an XML file.

    Raises:
        ImportRefusedError: If the file is invalid or malicious.
    """
    stack: list[Element] = []
    roots: list[Element] = []
    parser, count = expat.ParserCreate(), 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        element = Element(path, tag, parser.CurrentLineNumber, attributes)
        if count > MAX_ELEMENTS or len(stack) >= MAX_DEPTH:
            raise element.refused(f"the file has more than {MAX_ELEMENTS} elements or {MAX_DEPTH} nesting levels")
        (stack[-1].children if stack else roots).append(element)
        stack.append(element)

    def entity(name: str, *_: object) -> None:
        message = f"the file defines the entity `{name}`"
        raise ImportRefusedError(path, message, parser.CurrentLineNumber, "replace entities with their contents")

    parser.StartElementHandler, parser.EndElementHandler = start, lambda _: stack.pop()
    parser.EntityDeclHandler = entity
    try:
        parser.Parse(_bounded_bytes(path, MAX_XML_BYTES), True)
    except expat.ExpatError as error:
        message = f"the file is not valid XML: {expat.ErrorString(error.code)}"
        raise ImportRefusedError(path, message, error.lineno) from None
    except (ValueError, LookupError) as error:  # an encoding that Python does not support
        raise ImportRefusedError(path, f"the file is not valid XML: {error}") from None
    (root,) = roots
    if root_tag is not None and root.tag != root_tag:
        raise root.refused(f"the root element must be `<{root_tag}>`, not `<{root.tag}>`")
    return root


def read_json(path: Path) -> Any:
    """Return the content of a JSON file.

    Raises:
        ImportRefusedError: If the file is invalid or too large.
    """
    try:
        return json.loads(_bounded_bytes(path, MAX_JSON_BYTES))
    except json.JSONDecodeError as error:
        raise ImportRefusedError(path, f"the file is not valid JSON: {error.msg}", error.lineno) from None
    except (UnicodeDecodeError, RecursionError):
        raise ImportRefusedError(path, "the file is not valid JSON") from None


def _bounded_bytes(path: Path, most: int) -> bytes:
    try:
        with path.open("rb") as stream:
            data = stream.read(most + 1)
    except OSError as error:
        raise ImportRefusedError(path, f"the file could not be read: {error.strerror}") from None
    if len(data) > most:
        raise ImportRefusedError(path, f"the file is larger than {most // 1_000_000} MB")
    return data


# Maximum size of a referenced file [bytes], which limits memory use; typical meshes and textures are smaller.
MAX_FILE_BYTES = 500_000_000

# Number of parent folders to search for a package; ROS uses share/package/robots/name/urdf.
LEVELS = 5

# Maximum length of a reference [characters]; file systems allow fewer.
MAX_REFERENCE = 1000

_PACKAGE = re.compile(r"(?:package|model)://(.*)\Z", re.DOTALL)


class NotFoundError(Exception):
    """Raised if a referenced file is not available.

    The message is a predicate, such as "does not exist", to be placed after the file name.
    """


@dataclass(frozen=True)
class FileSearch:
    """A search for the files that ``file`` references.

    These files must be below ``root`` or in one of the ``packages`` folders.
    """

    file: Path
    packages: Mapping[str, Path] = field(default_factory=dict)

    @property
    def root(self) -> Path:
        """Return the folder that must contain all referenced files.

        This is the nearest enclosing package or project. If there is none, it is the parent of the file's folder.
        """
        folder = self.file.resolve().parent
        for candidate in (folder, *folder.parents[:LEVELS]):
            if any((candidate / mark).exists() for mark in ("package.xml", ".git", "simfoundry.yaml")):
                return candidate
        return folder.parent if folder.parent != Path(folder.anchor) else folder

    def find(self, reference: str, folder: Path | None = None) -> Path:
        """Return the file for a reference, which may be relative to ``folder`` (by default, the folder of ``file``).

        Raises:
            NotFoundError: If the file is missing, too large, or outside the allowed folders.
        """
        if "\0" in reference or len(reference) > MAX_REFERENCE:
            raise NotFoundError("is not a valid file name")
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
            raise NotFoundError(f"is outside {self.root}; add the folder that contains it with `--package NAME=PATH`")
        if package:
            name = package[1].lstrip("/").partition("/")[0]
            raise NotFoundError(f"could not be found; specify the folder of its package with `--package {name}=PATH`")
        raise NotFoundError("does not exist")

    def need(self, reference: str, file: Path, line: int, folder: Path | None = None) -> Path:
        """Return the file for a reference on line ``line`` of ``file``.

        Raises:
            ImportRefusedError: If the file is not available; the error refers to this line.
        """
        try:
            return self.find(reference, folder)
        except NotFoundError as error:
            raise missing_file(file, line, reference, error) from None

    def _beside(self, reference: str, folder: Path | None) -> Iterator[tuple[Path, Path]]:
        reference = reference.removeprefix("file://")
        yield (folder or self.file.resolve().parent) / reference, self.root
        yield from ((place / reference, place) for place in self.packages.values())

    def _in_package(self, path: str) -> Iterator[tuple[Path, Path]]:
        """Yield candidate paths for ``package://NAME/REST`` with their root folders, in order of priority.

        The package is first looked up in ``packages``, and then among the parent folders. Finally, the path is
        interpreted relative to the packages and the parent folders.
        """
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
    """Return the error for a reference to a file that is not available."""
    return ImportRefusedError(file, f"`{reference[:120]}` {error}", line)
