"""Files that come with the package and are not its code: targets, example assets, a capture."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).parents[1]


def shipped(path: str) -> Path:
    """Return the folder ``path`` of the repository, as a checkout or a wheel has it.

    A wheel has it below ``simfoundry/shipped``; ``force-include`` in pyproject.toml lists what goes there.
    """
    installed = _PACKAGE / "shipped"
    return (installed if installed.is_dir() else _PACKAGE.parent) / path
