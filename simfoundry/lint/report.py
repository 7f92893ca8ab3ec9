"""Findings of lints: warnings at a place of a document."""

from __future__ import annotations

from dataclasses import replace

from simfoundry.spec.diagnostics import Diagnostic, Severity
from simfoundry.spec.loaded import Loaded

Path_ = tuple[str | int, ...]

MOST = 200
"""Findings of one kind that are shown for one document; whoever has more mends these first."""


def warning(loaded: Loaded, code: str, path: Path_, message: str, hint: str, about: tuple[str, ...] = ()) -> Diagnostic:
    """A warning at a place of a document; ``about`` names what an ``allow`` can name beside the parts of the path."""
    assert loaded.document is not None
    return replace(loaded.document.finding(code, path, message, hint, Severity.WARNING), about=about)


def where(loaded: Loaded, name: str) -> Path_:
    """The path of what says where an object is: its pose or its place, or itself where it has neither."""
    assert loaded.document is not None
    path: Path_ = ("objects", name)
    for key in ("place", "pose"):
        if len(loaded.document.known((*path, key))) == 3:
            return (*path, key)
    return path
