"""Documents in other files than YAML: what reads them stands in higher layers, and is put here."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from simfoundry.spec.loaded import Loaded

Loader = Callable[[Path, "dict[tuple[str, str], Loaded | None]"], "Loaded"]
"""Reads and checks a file; documents that it uses are taken from the mapping where they are, and added to it."""

LOADERS: dict[str, Loader] = {}
"""Loaders by suffix, as ``.usda``."""
