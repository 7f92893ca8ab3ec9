"""Find the documents that a command works on."""

from __future__ import annotations

from pathlib import Path

from simfoundry.cli.output import CannotError
from simfoundry.spec.models.kinds import is_document
from simfoundry.spec.project import MARKER, Project, find_project


def documents(paths: tuple[Path, ...]) -> list[Path]:
    """Return the given files and the documents below the given folders, each once.

    Below folders, names that start with a dot and documents that the project excludes are skipped.
    """
    files: dict[Path, None] = {}
    excluded = 0
    for path in paths:
        if path.is_dir():
            found = [p for p in sorted(path.rglob("*.yaml")) if is_document(p) and not _is_hidden(p.relative_to(path))]
            kept = _included(found, path)
            excluded += len(found) - len(kept)
            files |= dict.fromkeys(kept)
        elif path.exists() or path.is_symlink():  # a link to nothing is reported when it is read
            files[path] = None
        else:
            raise CannotError(f"there is no file {path}")
    if not files:
        but = f" but {excluded} that {MARKER} excludes" if excluded else ""
        raise CannotError(f"there is no document below {', '.join(map(str, paths))}{but}")
    return list(files)


def _included(found: list[Path], folder: Path) -> list[Path]:
    """Return the documents that are excluded neither by the project of ``folder`` nor by their own project."""
    outer = find_project(folder)
    projects: dict[Path, Project | None] = {}
    kept = []
    for path in found:
        if path.parent not in projects:
            inner = find_project(path.parent)
            projects[path.parent] = None if inner == outer else inner
        near = (p for p in (outer, projects[path.parent]) if p is not None)
        if not any(project.excludes(path, folder) for project in near):
            kept.append(path)
    return kept


def _is_hidden(path: Path) -> bool:
    return any(part.startswith(".") for part in path.parts)
