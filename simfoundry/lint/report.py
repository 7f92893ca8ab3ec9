"""Findings of lints: where they point, and lengths as people say them."""

from __future__ import annotations

import math
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


def length(metres: float) -> str:
    """A length with a unit that suits it: ``3.2 mm``, ``4.5 cm``, ``1.25 m``."""
    if not math.isfinite(metres) or metres >= 1:
        return f"{metres:.2f} m"
    return f"{metres * 1000:.1f} mm" if metres < 0.0095 else f"{metres * 100:.1f} cm"


def number(value: float) -> str:
    """A coordinate [m] to a tenth of a millimetre, without zeros at its end."""
    return f"{round(value, 4) + 0.0:.4f}".rstrip("0").rstrip(".")
