"""Engines that load a build folder: one module each, ``open_build(folder) -> Session``.

A module imports its engine at the top, and from this project only what needs nothing but numpy: it runs in the
environment of its engine.
"""

from __future__ import annotations

import importlib
import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Protocol, cast

from simfoundry.verify.facts import Facts, Moment

READERS = {
    "mujoco": "mujoco",
    "pybullet": "pybullet",
    "usd": "usd",
    "newton-usd": "newton_usd",
    "newton-mjcf": "newton_mjcf",
    "sapien": "sapien",
    "drake": "drake",
    "genesis": "genesis",
}
"""The module of each engine here."""

LOADERS = Path(__file__).parents[2] / "backends" / "templates"
"""The loaders that targets ship, for engines that no backend's own ``load.py`` is for."""

TIMESTEP = 1e-3
"""Seconds a step, for engines whose build does not say."""


class Session(Protocol):
    """A build in an engine, in the state that the scene describes."""

    @property
    def timestep(self) -> float:
        """Seconds a step; 0 where the engine only reads."""
        ...

    def facts(self) -> Facts:
        """What the engine holds."""
        ...

    def step(self) -> None:
        """Advance by one step."""
        ...

    def moment(self, time: float) -> Moment:
        """Where everything is; ``time`` [s] is only written down."""
        ...

    def close(self) -> None:
        """Let go of the engine."""
        ...


class _Reader(Protocol):
    def open_build(self, folder: Path) -> Session: ...


def open_build(engine: str, folder: Path) -> Session:
    """The build in ``folder``, loaded by ``engine``."""
    module = importlib.import_module(f"simfoundry.verify.readers.{READERS[engine]}")
    return cast(_Reader, module).open_build(folder)


def load_module(path: Path) -> ModuleType:
    """A ``load.py`` of a build as a module of its own."""
    spec = importlib.util.spec_from_file_location(f"build_{abs(hash(path))}", path)
    if spec is None or spec.loader is None:
        raise ImportError(f"cannot import {path}")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
