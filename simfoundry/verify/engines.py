"""The engines that can check a build: every target with a ``readback.py``, and the interpreters that have them."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from simfoundry.errors import SimfoundryError
from simfoundry.targets.find import Target, find_target, target_names
from simfoundry.targets.profile import READ_BACK, Band, EngineSpec, Gap
from simfoundry.verify.process import EngineJob, Run, ask_probe

VARIABLE = "SIMFOUNDRY_ENGINES"
"""Names interpreters, separated by commas: ``PATH`` is searched for every engine, ``ENGINE=PATH`` for that one."""

TOLERANCE = 1e-5
"""Relative tolerance of a profile that states none: a hundred times what single precision needs."""

_FEATURES = {"joint friction": "joint_friction", "bounds": "convex_mesh"}
"""The features of profiles whose names are not those of the quantities that are compared."""


@dataclass(frozen=True)
class VerifyEngine:
    """A target whose builds can be read back, as its profile describes it."""

    target: Target

    @property
    def spec(self) -> EngineSpec:
        """The description of the engine: its name, its packages, its solver."""
        assert self.target.profile.engine is not None
        return self.target.profile.engine

    @property
    def name(self) -> str:
        """The name in tables and after ``-e``."""
        return self.spec.name or self.target.name

    @property
    def family(self) -> str:
        """The name that all engines of one package answer to."""
        return self.spec.family or self.name

    @property
    def modules(self) -> tuple[str, ...]:
        """The packages that it needs as ``module:distribution``, the engine itself first."""
        return tuple(f"{module}:{distribution}" for module, distribution in self.spec.modules.items())

    @property
    def readback(self) -> Path:
        """The module that reads a build into it."""
        assert self.target.readback is not None
        return self.target.readback

    @property
    def build(self) -> Target:
        """The target whose build it reads: the plain one of the backend, unless its own has other files or options."""
        profile = self.target.profile
        return self.target if profile.options or profile.writes else find_target(profile.backend)

    def folder_in(self, out: Path) -> Path | None:
        """The folder in what ``compile -o`` wrote that it can read: that of its own target, else of its build."""
        return next((p for p in (out / self.target.name, out / self.build.name) if p.is_dir()), None)

    def job(self, build: Path, run: Run | None = None) -> EngineJob:
        """The task of reading ``build`` with the loader that is meant for this engine."""
        own = self.target.loader
        if own is None or build.name == self.target.name:
            return EngineJob(build, run)
        beside = build / f"load_{self.target.name}.py"
        return EngineJob(build, run, beside if beside.is_file() else own)

    def gap(self, quantity: str) -> Gap | None:
        """Return the gap of a quantity that the engine does not keep although its build has it.

        The engine then has none of it, or, where there is a ``size``, one that is off by no more than that.
        """
        return self.target.profile.gaps.get(_FEATURES.get(quantity, quantity))

    @property
    def restored(self) -> frozenset[str]:
        """The features that the target's format drops and the loader for this engine brings back."""
        profile = self.target.profile
        combined = {name for name in ("friction", "restitution") if getattr(profile.combines, name) is not None}
        return frozenset(profile.restores.keys() | combined)

    def band(self, behaviour: str) -> Band | None:
        """Return the values that the engine is known to give instead of the right answer."""
        return self.target.profile.behaviours.get(behaviour)

    def tolerance(self, quantity: str) -> float:
        """The greatest relative error of a quantity that is read back."""
        stated = self.target.profile.tolerances
        found = stated.get(quantity.replace(" ", "_")) or stated.get(READ_BACK)
        return TOLERANCE if found is None else found.value

    def behaviour_tolerance(self, behaviour: str, default: float) -> float:
        """The greatest error of a behaviour, in its unit."""
        found = self.target.profile.tolerances.get(behaviour)
        return default if found is None else found.value


@dataclass(frozen=True)
class InstalledEngine:
    """An engine, the interpreter that has it, and its version."""

    engine: VerifyEngine
    python: Path
    version: str


class UnknownEngineError(SimfoundryError):
    """A name that is no engine; the message lists those there are."""


def all_engines() -> tuple[VerifyEngine, ...]:
    """Every engine, in the order of the targets."""
    targets = (find_target(name) for name in target_names())
    return tuple(VerifyEngine(target) for target in targets if target.readback is not None)


def find_engine(name: str) -> VerifyEngine:
    """The engine called ``name``, or that of the target or folder of that name."""
    engines = all_engines()
    for engine in engines:
        if name in (engine.name, engine.target.name):
            return engine
    if "/" in name:
        target = find_target(name)
        if target.readback is not None:
            return VerifyEngine(target)
        raise UnknownEngineError(f"the target at {name} has no `readback.py`, so nothing can read its builds")
    raise UnknownEngineError(f"no engine is called `{name}`; there are: {', '.join(e.name for e in engines)}")


def interpreters(
    options: Sequence[str], engines: Iterable[VerifyEngine], environment: Mapping[str, str] = os.environ
) -> dict[str, list[Path]]:
    """Return the interpreters by engine or family, ``""`` for all: of ``--python``, of the variable, and this one."""
    places: dict[str, list[Path]] = {"": []}
    families = {name for e in (*all_engines(), *engines) for name in (e.name, e.family)}
    for entry in (*options, *environment.get(VARIABLE, "").split(",")):
        name, _, path = entry.strip().rpartition("=")
        if not path:
            continue
        if name and name not in families:
            raise UnknownEngineError(f"no engine is called `{name}`; there are: {', '.join(sorted(families))}")
        if not Path(path).is_file():
            raise SimfoundryError(f"there is no interpreter at {path}, where {name or 'engines'} should be")
        places.setdefault(name, []).append(Path(path))
    places[""].insert(0, Path(sys.executable))
    return places


def find_installed(
    engines: Mapping[str, VerifyEngine], places: Mapping[str, Sequence[Path]]
) -> dict[str, InstalledEngine | None]:
    """Each engine by name, with the first interpreter that has all it needs; None where there is none."""
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
    """The versions of those modules that an interpreter has; none if it does not even start."""
    try:
        return ask_probe(python, modules)
    except (OSError, ValueError, subprocess.SubprocessError):
        return {}
