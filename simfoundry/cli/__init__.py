"""The ``simfoundry`` command: one file a command, no logic of its own."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from simfoundry.spec.loaders import LOADERS

if TYPE_CHECKING:
    from simfoundry.spec.loaded import Loaded


def _stage(path: Path, known: dict[tuple[str, str], Loaded | None]) -> Loaded:
    from simfoundry.frontends.usd.compiled import load_usd

    return load_usd(path, known)


LOADERS.update(dict.fromkeys((".usda", ".usdc", ".usd", ".usdz"), _stage))
