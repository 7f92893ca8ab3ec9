"""Find the project that a document belongs to: its folder and its marker file ``simfoundry.yaml``."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cached_property
from itertools import product
from pathlib import Path
from tempfile import gettempdir
from typing import NamedTuple

from pydantic import Field

from simfoundry.spec.check.validate import validate
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.models.base import Model
from simfoundry.spec.models.kinds import is_document
from simfoundry.spec.models.model_sources import ProjectModels
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import read

# File that marks the root folder of a project; it may be empty.
MARKER = "simfoundry.yaml"


# Content of a new marker file.
MARKING = "# Root of a SimFoundry project, which contains all files that its documents refer to.\n"


class ProjectSpec(Model):
    """The contents of ``simfoundry.yaml``."""

    exclude: tuple[str, ...] = Field(
        (),
        max_length=1000,
        description="Files and folders that commands on folders skip, relative to this file; "
        "`*` stands for any part of a name, `**` for any number of folders.",
    )
    models: ProjectModels = Field(
        ProjectModels.model_construct(), description="Foundation models, by the tasks that they solve."
    )


@dataclass(frozen=True)
class Project:
    """A project folder, which contains all files that its documents use."""

    root: Path

    @property
    def marker(self) -> Path:
        """Return the path of the marker file, which may be missing if the project is a git repository."""
        return self.root / MARKER

    @property
    def is_marked(self) -> bool:
        """Return True if the folder contains a marker file or is a repository."""
        return self.marker.exists() or (self.root / ".git").exists()

    @cached_property
    def spec(self) -> ProjectSpec:
        """Return the content of the marker file, or the defaults if there is none.

        Raises:
            SpecError: If the marker file cannot be read.
        """
        if not self.marker.is_file():
            return ProjectSpec.model_construct()
        try:
            document = read(self.marker)
        except YamlError as error:
            raise SpecError([error.diagnostic(str(self.marker))]) from None
        if document.data is None:
            return ProjectSpec.model_construct()
        spec, findings = validate(ProjectSpec, document)
        if spec is None:
            raise SpecError(findings)
        return spec

    @property
    def exclude(self) -> tuple[str, ...]:
        """Return the patterns for files and folders that are skipped by commands on folders.

        Raises:
            SpecError: If the marker file cannot be read.
        """
        return self.spec.exclude

    def excludes(self, path: Path, named: Path) -> bool:
        """Return True if a command that is run on the folder ``named`` skips ``path``.

        Only paths below ``named`` can be skipped, never ``named`` itself.
        """
        if not self.exclude:
            return False
        parts, above = _parts(path, self.root), _parts(named, self.root)
        patterns = [[part for part in pattern.split("/") if part not in ("", ".")] for pattern in self.exclude]
        inner = [parts[:count] for count in range(len(above) + 1, len(parts) + 1)]
        return any(_matches(below, pattern) for pattern in filter(None, patterns) for below in inner)


def find_project(path: Path) -> Project | None:
    """Find the project of a file or folder: the nearest parent with ``simfoundry.yaml``, or otherwise with ``.git``."""
    real = Path(os.path.realpath(path))  # unlike `Path.resolve`, it also works for cyclic symbolic links
    start = real if real.is_dir() else real.parent
    marked = product((MARKER, ".git"), (start, *start.parents))
    return next((Project(folder) for mark, folder in marked if (folder / mark).exists()), None)


def project_root(path: Path) -> Path:
    """Return the folder that must contain a document's files: its project folder, or else its own folder."""
    project = find_project(path)
    return project.root if project is not None else Path(os.path.realpath(path)).parent


class DocumentFiles(NamedTuple):
    """The documents below a folder: those that commands read, and those that the project excludes."""

    included: list[Path]
    excluded: list[Path]


def document_files(folder: Path) -> DocumentFiles:
    """Find the documents below a folder, in alphabetical order.

    Files and folders whose names start with a dot are skipped, and links to folders are not followed. A document is
    excluded by the project that contains ``folder`` or by its own project.

    Raises:
        SpecError: If the marker file of a project cannot be read.
    """
    found: list[Path] = []
    for parent, folders, files in os.walk(folder):
        here = Path(parent)
        found += (here / name for name in (*files, *folders) if not name.startswith(".") and is_document(here / name))
        folders[:] = [name for name in folders if not name.startswith(".")]
    found.sort()
    projects = {parent: find_project(parent) for parent in {folder, *(path.parent for path in found)}}
    done = DocumentFiles([], [])
    for path in found:
        both = (projects[folder], projects[path.parent])
        skipped = any(project is not None and project.excludes(path, folder) for project in both)
        (done.excluded if skipped else done.included).append(path)
    return done


def common_project(*files: Path) -> Project:
    """Return the nearest project that contains all ``files``, which need not exist.

    If there is none, return an unmarked project: the working folder if it contains all files, else the closest common
    folder.

    Raises:
        NoProjectError: If no such project is possible, because one of the files belongs to a nested project or because
            the folder is shared and marking it would include unrelated files.
    """
    folders = [Path(os.path.realpath(file.absolute().parent)) for file in files]
    try:
        closest = Path(os.path.commonpath(folders))
    except ValueError:  # on different drives
        raise NoProjectError(f"no folder contains {_listed(files)}; move them into one folder") from None
    here = Path.cwd()
    below = closest.is_relative_to(here) and not is_shared(here)
    project = find_project(closest) or Project(here if below else closest)
    for file, folder in zip(files, folders, strict=True):
        inner = find_project(folder)
        if inner is not None and inner.root != project.root:
            others = [f for f, at in zip(files, folders, strict=True) if not at.is_relative_to(inner.root)]
            message = f"`{file}` belongs to the project {inner.root}, which does not contain {_listed(others)}"
            raise NoProjectError(f"{message}; move all files into {inner.root}, or its {MARKER} to {project.root}")
    if not project.is_marked and len({*folders}) > 1 and is_shared(project.root):
        raise NoProjectError(
            f"the closest folder that contains {_listed(files)} is {project.root}, "
            f"which also contains unrelated files; move them into a separate folder"
        )
    return project


class NoProjectError(Exception):
    """Raised if files cannot belong to one project. The message is one sentence that states the reason."""


def markers(project: Project) -> dict[Path, str]:
    """Return the content of the marker file to write, keyed by its path.

    The result is empty if the project already has a marker file or if its folder is shared.
    """
    return {} if project.is_marked or is_shared(project.root) else {project.marker: MARKING}


def is_shared(folder: Path) -> bool:
    """Return True for folders that do not belong to a single project: system, home, and temporary folders."""
    return any(Path(os.path.realpath(owned)).is_relative_to(folder) for owned in (Path.home(), gettempdir()))


def _listed(files: Iterable[Path]) -> str:
    return " and ".join(f"`{file}`" for file in files)


def _parts(path: Path, root: Path) -> tuple[str, ...]:
    """Return the path components from ``root`` to ``path``, or () if ``path`` is outside ``root``.

    A link at the end of ``path`` is not resolved.
    """
    whole = Path(os.path.normpath(path.absolute()))
    real = Path(os.path.realpath(whole.parent)) / whole.name
    return real.relative_to(root).parts if real.is_relative_to(root) else ()


def _matches(parts: Sequence[str], pattern: Sequence[str]) -> bool:
    """Return True if the components of a path match a pattern one by one."""
    if not pattern:
        return not parts
    if pattern[0] == "**":
        return any(_matches(parts[skipped:], pattern[1:]) for skipped in range(len(parts) + 1))
    return bool(parts) and fnmatchcase(parts[0], pattern[0]) and _matches(parts[1:], pattern[1:])
