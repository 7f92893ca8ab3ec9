"""Data files distributed with the package: targets, example assets, a capture."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).parents[1]


def shipped(path: str) -> Path:
    """Return the folder ``path`` of the repository, in a checkout or an installed wheel.

    In a wheel it is below ``simfoundry/shipped``; ``force-include`` in pyproject.toml lists the folders.
    """
    installed = _PACKAGE / "shipped"
    return (installed if installed.is_dir() else _PACKAGE.parent) / path
