"""Engines that can verify a build, and their Python interpreters. Each target with a ``readback.py`` is an engine."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from simfoundry.errors import SimfoundryError
from simfoundry.targets.find import Target, find_target, find_targets, target_names
from simfoundry.targets.profile import READ_BACK, EngineSpec
from simfoundry.verify.process import EngineJob, Run, ask_probe

# The environment variable that lists interpreters, separated by commas; each entry is ``PATH`` or ``ENGINE=PATH``.
VARIABLE = "SIMFOUNDRY_ENGINES"

# Default relative tolerance of a profile, which is a hundred times the single-precision rounding error.
TOLERANCE = 1e-5


@dataclass(frozen=True)
class VerifyEngine:
    """A target whose builds can be read back, as described by its profile."""

    target: Target

    @property
    def spec(self) -> EngineSpec:
        """The description of the engine: its name, required packages and solver."""
        assert self.target.profile.engine is not None
        return self.target.profile.engine

    @property
    def name(self) -> str:
        """The engine's name in tables and for ``-e``."""
        return self.spec.name or self.target.name

    @property
    def family(self) -> str:
        """The name shared by all engines in the same package."""
        return self.spec.family or self.name

    @property
    def modules(self) -> tuple[str, ...]:
        """The required packages as ``module:distribution``, starting with the engine itself."""
        return tuple(f"{module}:{distribution}" for module, distribution in self.spec.modules.items())

    @property
    def readback(self) -> Path:
        """The module that reads a build with the engine."""
        assert self.target.readback is not None
        return self.target.readback

    @property
    def build(self) -> Target:
        """The target whose build is read.

        This is the plain backend, unless the engine's target has different files or options.
        """
        profile = self.target.profile
        return self.target if profile.options or profile.writes else find_target(profile.backend)

    def folder_in(self, out: Path) -> Path | None:
        """Return the folder to read in the output of ``compile -o``, or None if the output contains no such folder."""
        return next((p for p in (out / self.target.name, out / self.build.name) if p.is_dir()), None)

    def job(self, build: Path, run: Run | None = None) -> EngineJob:
        """Return a job that reads ``build`` with the loader for this engine."""
        own = self.target.loader
        if own is None or build.name == self.target.name:
            return EngineJob(build, run)
        beside = build / f"load_{self.target.name}.py"
        return EngineJob(build, run, beside if beside.is_file() else own)

    def tolerance(self, quantity: str) -> float:
        """Return the maximum relative error for a quantity that is read back."""
        stated = self.target.profile.tolerances
        found = stated.get(quantity.replace(" ", "_")) or stated.get(READ_BACK)
        return TOLERANCE if found is None else found.value


@dataclass(frozen=True)
class InstalledEngine:
    """An engine, together with its version and the interpreter in which it is installed."""

    engine: VerifyEngine
    python: Path
    version: str


class UnknownEngineError(SimfoundryError):
    """Raised for an unknown engine name. The message lists the valid names."""


def all_engines() -> tuple[VerifyEngine, ...]:
    """Return all engines in target order."""
    return tuple(VerifyEngine(target) for target in find_targets(target_names())[0] if target.readback is not None)


def find_engine(name: str) -> VerifyEngine:
    """Return the engine called ``name``, or the engine of the target or folder with this name."""
    engines = all_engines()
    found = next((engine for engine in engines if name in (engine.name, engine.target.name)), None)
    if found is not None:
        return found
    if "/" in name or name in target_names():
        target = find_target(name)
        if target.readback is not None:
            return VerifyEngine(target)
        raise UnknownEngineError(f"the target at {name} has no `readback.py`, so its builds cannot be read back")
    raise UnknownEngineError(f"no engine is called `{name}`; available engines: {', '.join(e.name for e in engines)}")


def interpreters(
    options: Sequence[str], engines: Iterable[VerifyEngine], environment: Mapping[str, str] = os.environ
) -> dict[str, list[Path]]:
    """Return the interpreters, keyed by engine or family. Interpreters under the key ``""`` are for all engines.

    Interpreters specified with ``--python`` precede those in the environment variable.
    """
    places: dict[str, list[Path]] = {"": []}
    families = {name for e in (*all_engines(), *engines) for name in (e.name, e.family)}
    for entry in (*options, *environment.get(VARIABLE, "").split(",")):
        name, _, path = entry.strip().rpartition("=")
        if not path:
            continue
        if name and name not in families:
            raise UnknownEngineError(f"no engine is called `{name}`; available engines: {', '.join(sorted(families))}")
        if not Path(path).is_file():
            raise SimfoundryError(f"the interpreter {path}, configured for {name or 'all engines'}, does not exist")
        places.setdefault(name, []).append(Path(path))
    places[""].insert(0, Path(sys.executable))
    return places


def find_installed(
    engines: Mapping[str, VerifyEngine], places: Mapping[str, Sequence[Path]]
) -> dict[str, InstalledEngine | None]:
    """Return, by engine name, the first interpreter that meets the engine's requirements, or None if there is none."""
    modules = tuple(sorted({module for engine in engines.values() for module in engine.modules}))
    found: dict[str, InstalledEngine | None] = {}
    for engine in engines.values():
        here = (*places.get(engine.name, ()), *places.get(engine.family, ()), *places.get("", ()))
        versions = ((python, _versions(python, modules)) for python in here)
        whole = ((python, has) for python, has in versions if all(module in has for module in engine.modules))
        found[engine.name] = next((InstalledEngine(engine, p, has[engine.modules[0]]) for p, has in whole), None)
    return found


@cache
def _versions(python: Path, modules: tuple[str, ...]) -> dict[str, str]:
    """Return the versions of the given modules in an interpreter, or {} if the interpreter does not start."""
    try:
        return ask_probe(python, modules)
    except (OSError, ValueError, subprocess.SubprocessError):
        return {}
