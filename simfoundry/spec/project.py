"""The project that a document belongs to: its folder, and what its marker ``simfoundry.yaml`` says."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path

from pydantic import Field

from simfoundry.spec.base import Model
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.text import YamlError, read
from simfoundry.spec.validate import validate

MARKER = "simfoundry.yaml"
"""The file that marks the topmost folder of a project; it may be empty."""


class ProjectSpec(Model):
    """What a ``simfoundry.yaml`` may say."""

    exclude: tuple[str, ...] = Field(
        (),
        max_length=1000,
        description="Files and folders that commands over folders pass over, from this file's folder; "
        "`*` stands for any part of a name, `**` for any number of folders.",
    )


@dataclass(frozen=True)
class Project:
    """A folder below which the files of its documents lie."""

    root: Path

    @property
    def marker(self) -> Path:
        """The file that marks the folder; there is none where a repository stands for the project."""
        return self.root / MARKER

    @cached_property
    def exclude(self) -> tuple[str, ...]:
        """The patterns of the files and folders that commands over folders pass over.

        Raises :class:`SpecError` where the marker cannot be read.
        """
        if not self.marker.is_file():
            return ()
        try:
            document = read(self.marker)
        except YamlError as error:
            raise SpecError([error.diagnostic(str(self.marker))]) from None
        if document.data is None:
            return ()
        spec, findings = validate(ProjectSpec, document)
        if spec is None:
            raise SpecError(findings)
        return spec.exclude

    def excludes(self, path: Path, named: Path) -> bool:
        """Whether ``path`` is passed over by a command that works on the folder ``named``.

        What a person names is never passed over: only what lies below ``named`` counts.
        """
        if not self.exclude:
            return False
        parts, above = _parts(path, self.root), _parts(named, self.root)
        patterns = [[part for part in pattern.split("/") if part not in ("", ".")] for pattern in self.exclude]
        return any(
            _matches(parts[:count], pattern)
            for pattern in patterns
            for count in range(len(above) + 1, len(parts) + 1)
            if pattern
        )


def find_project(path: Path) -> Project | None:
    """The project of a file or folder: the nearest folder upwards with a ``simfoundry.yaml``, else with a ``.git``."""
    real = Path(os.path.realpath(path))  # unlike `Path.resolve`, also of links that form a ring
    start = real if real.is_dir() else real.parent
    folders = (start, *start.parents)
    for mark in (MARKER, ".git"):
        for folder in folders:
            if (folder / mark).exists():
                return Project(folder)
    return None


def project_root(path: Path) -> Path:
    """The folder below which a document's files must lie: that of its project, or else its own."""
    project = find_project(path)
    return project.root if project is not None else Path(os.path.realpath(path)).parent


def _parts(path: Path, root: Path) -> tuple[str, ...]:
    """The names from ``root`` to ``path``, whose own link is not followed; none where it lies elsewhere."""
    whole = Path(os.path.normpath(path.absolute()))
    real = Path(os.path.realpath(whole.parent)) / whole.name
    return real.relative_to(root).parts if real.is_relative_to(root) else ()


def _matches(parts: Sequence[str], pattern: Sequence[str]) -> bool:
    """Whether the names of a path are what a pattern says, name by name."""
    if not pattern:
        return not parts
    if pattern[0] == "**":
        return any(_matches(parts[skipped:], pattern[1:]) for skipped in range(len(parts) + 1))
    return bool(parts) and fnmatchcase(parts[0], pattern[0]) and _matches(parts[1:], pattern[1:])
