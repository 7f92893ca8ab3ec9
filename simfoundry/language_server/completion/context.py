"""The context of a completion request: the document, the cursor, and the known names."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from simfoundry.language_server.analysis import Analysis
from simfoundry.language_server.completion.insertion import Insertion
from simfoundry.language_server.completion.known_names import KnownName, KnownNames
from simfoundry.language_server.cursor.cursor import Cursor
from simfoundry.language_server.positions import Lines
from simfoundry.spec.models.base import DocumentSpec
from simfoundry.spec.models.kinds import KINDS, model_of
from simfoundry.spec.yaml.text import Path_

_KIND_LINE = re.compile(r"""^(?:\ufeff)?simfoundry:[ \t]*["']?([a-z]+/\d+)""", re.MULTILINE)
_EXTENDS = re.compile(r"^extends:", re.MULTILINE)


@dataclass(frozen=True)
class CompletionContext:
    """The place of the cursor and what is known about its document.

    Attributes:
        path: The file.
        lines: The text.
        cursor: The place in it.
        analysis: The latest analysis of a text that could be parsed, or None.
    """

    path: Path
    lines: Lines
    cursor: Cursor
    analysis: Analysis | None

    @cached_property
    def kind(self) -> str:
        """Return the kind of the document, such as ``scene``, or an empty string if it is unknown."""
        found = _KIND_LINE.search(self.lines.text)
        if found is not None and found[1] in KINDS:
            return found[1].partition("/")[0]
        return kind_of_file(self.path)

    @cached_property
    def model(self) -> type[DocumentSpec]:
        """Return the model of the document."""
        return model_of(f"{self.kind}/1")

    @cached_property
    def names(self) -> KnownNames:
        """Return the names that the document can use."""
        return KnownNames(self.analysis.loaded if self.analysis is not None else None, self.kind, self.lines.text)

    @property
    def is_overlay(self) -> bool:
        """Return True if the document changes another one."""
        return _EXTENDS.search(self.lines.text) is not None or "\ninclude:" in self.lines.text

    @cached_property
    def insertion(self) -> Insertion:
        """Return the place where text is inserted."""
        return Insertion(self.lines, self.cursor)

    @property
    def has_colon(self) -> bool:
        """Return True if a colon follows the key at the cursor."""
        return re.match(r"[ \t]*:(?:\s|\Z)", self.insertion.rest + "\n") is not None

    @property
    def separator(self) -> str:
        """Return the comma that is missing behind a new member in braces, if others follow."""
        rest = self.insertion.rest.lstrip()
        return ", " if self.cursor.in_flow and rest and rest[0] not in ",]}#" else ""

    @property
    def own_names(self) -> tuple[str, ...]:
        """Return the name of the member that contains the cursor, which cannot refer to itself."""
        return tuple(str(part) for part in self.cursor.path[1:2])

    def member(self, *path: Any) -> Any:
        """Return the data at a path of the document joined with its bases, or None."""
        loaded = self.analysis.loaded if self.analysis is not None else None
        value = loaded.document.data if loaded is not None and loaded.document is not None else None
        for part in path:
            if isinstance(value, dict):
                value = value.get(part)
            elif isinstance(value, tuple) and isinstance(part, int) and part < len(value):
                value = value[part]
            else:
                return None
        return value

    def keys_for(self, section: str, container: Path_) -> Iterator[KnownName]:
        """Yield the names that can be keys of a mapping whose keys name members of a section."""
        of, _, own = section.partition(".")
        if own == "joints":
            owner = str(container[-2] if self.kind == "scene" else container[-1])
            yield from self.names.moving_joints(owner)
        elif own == "parameters":
            yield from self._included_parameters(str(container[1]))
        else:
            for known in self.names.names(of):
                if of != "objects" or container[-1] == "joints" or not self.names.is_fixed(known.name):
                    if container[-1] == "joints" and not any(self.names.moving_joints(known.name)):
                        continue
                    yield known

    def _included_parameters(self, include: str) -> Iterator[KnownName]:
        from simfoundry.spec.files import FileError, located
        from simfoundry.spec.yaml.nodes import YamlError
        from simfoundry.spec.yaml.text import read

        scene = self.member("include", include, "scene")
        loaded = self.analysis.loaded if self.analysis is not None else None
        try:
            target = located(scene, self.path) if isinstance(scene, str) else None
            if target is None or loaded is None or not target.is_relative_to(loaded.root):
                return
            for name, value in read(target).section("parameters").items():
                yield KnownName(name, "parameters", f"= {value}"[:60])
        except (YamlError, FileError, OSError, RuntimeError, ValueError):
            return


def kind_of_file(path: Path) -> str:
    """Return the kind of a document by its file name, or an empty string."""
    words = [kind.partition("/")[0] for kind in KINDS]
    if path.name == "capture.yaml":
        return "capture"
    return next((word for word in words if path.name.endswith(f".{word}.yaml")), "")
