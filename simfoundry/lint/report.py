"""Findings of lints: warnings at a place of a document."""

from __future__ import annotations

from dataclasses import replace

from simfoundry.spec.diagnostics import Diagnostic, Severity
from simfoundry.spec.files import Loaded

Path_ = tuple[str | int, ...]

MOST = 200
"""Number of findings of one kind shown for one document; more appear once these are fixed."""


def warning(loaded: Loaded, code: str, path: Path_, message: str, hint: str, about: tuple[str, ...] = ()) -> Diagnostic:
    """Return a warning at a place of a document; ``about`` lists names that ``allow`` accepts besides those in the
    path.
    """
    assert loaded.document is not None
    return replace(loaded.document.finding(code, path, message, hint, Severity.WARNING), about=about)


def where(loaded: Loaded, name: str) -> Path_:
    """Return the path of an object's pose or placement, or of the object itself if it has neither."""
    assert loaded.document is not None
    path: Path_ = ("objects", name)
    for key in ("place", "pose"):
        if len(loaded.document.known((*path, key))) == 3:
            return (*path, key)
    return path
