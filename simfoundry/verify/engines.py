"""The engines that can check a build: what each reads, how it is installed, and what it is known not to do."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from simfoundry.errors import SimfoundryError
from simfoundry.targets.find import find_target, profile_names
from simfoundry.targets.profile import Band, Gap, TargetSpec
from simfoundry.verify.process import ask_probe

VARIABLE = "SIMFOUNDRY_ENGINES"
"""Names interpreters, separated by commas: ``PATH`` is searched for every engine, ``ENGINE=PATH`` for that one."""


_FEATURES = {"joint friction": "joint_friction", "bounds": "convex_mesh"}
"""The features of profiles whose names are not those of the quantities that are compared."""


@dataclass(frozen=True)
class Engine:
    """One engine reading one target.

    ``modules`` are what it needs, as ``module:distribution``, the engine itself first; ``family`` is what
    ``--python FAMILY=PATH`` may say for all engines of one package. What it is known not to keep, and what its loader
    brings back of what the target's format drops, is in the ``profile`` of that name; default: of its family.
    """

    name: str
    family: str
    target: str
    modules: tuple[str, ...]
    install: str
    note: str
    steps: bool = True
    profile: str = ""

    @property
    def module(self) -> str:
        """The module that is the engine."""
        return self.modules[0].partition(":")[0]

    def gap(self, quantity: str) -> Gap | None:
        """What the profile says of a quantity that the engine does not keep although its build says it.

        The engine then has none of it, or, where there is a ``size``, one that is off by no more than that.
        """
        profile = _profile(self.profile or self.family)
        return profile.gaps.get(_FEATURES.get(quantity, quantity)) if profile is not None else None

    @property
    def by_loader(self) -> frozenset[str]:
        """The features that the target's format drops and the loader for this engine brings back."""
        profile = _profile(self.profile or self.family)
        if profile is None:
            return frozenset()
        combined = {name for name in ("friction", "restitution") if getattr(profile.combines, name) is not None}
        return frozenset(profile.restores.keys() | combined)

    def band(self, behaviour: str) -> Band | None:
        """What it is known to do instead of the right answer."""
        profile = _profile(self.profile or self.family)
        return profile.behaviours.get(behaviour) if profile is not None else None


@cache
def _profile(family: str) -> TargetSpec | None:
    """The profile of a simulator; None of what is none, as OpenUSD itself."""
    return find_target(family).profile if family in profile_names() else None


_NEWTON = ("newton:newton", "warp:warp-lang", "mujoco_warp:mujoco-warp", "mujoco:mujoco")

ENGINES: tuple[Engine, ...] = (
    Engine("mujoco", "mujoco", "mjcf", ("mujoco:mujoco",), "pip install mujoco", "its own solver"),
    Engine("pybullet", "pybullet", "pybullet", ("pybullet:pybullet",), "pip install pybullet", "its own solver"),
    Engine(
        "newton-usd",
        "newton",
        "usd",
        (*_NEWTON, "pxr:usd-core"),
        "pip install 'newton[importers,sim]'",
        "SolverMuJoCo on the CPU",
        profile="newton_usd",
    ),
    Engine(
        "newton-mjcf",
        "newton",
        "mjcf",
        _NEWTON,
        "pip install 'newton[importers,sim]'",
        "SolverMuJoCo on the CPU",
    ),
    Engine(
        "sapien",
        "sapien",
        "urdf",
        ("sapien:sapien",),
        "pip install sapien",
        "PhysX on the CPU",
    ),
    Engine(
        "drake",
        "drake",
        "urdf",
        ("pydrake:drake",),
        "pip install drake",
        "discrete, with the default contact solver",
    ),
    Engine(
        "genesis",
        "genesis",
        "urdf",
        ("genesis:genesis-world", "torch:torch"),
        "pip install genesis-world torch",
        "its rigid solver on the CPU",
    ),
    Engine(
        "usd", "usd", "usd", ("pxr:usd-core",), "pip install usd-core", "the stage itself, no simulator", steps=False
    ),
)
"""In the order of the table."""


@dataclass(frozen=True)
class Found:
    """An engine, the interpreter that has it, and its version."""

    engine: Engine
    python: Path
    version: str


class UnknownEngineError(SimfoundryError):
    """A name that is no engine; the message lists those there are."""


def engine_called(name: str) -> Engine:
    """The engine called ``name``."""
    for engine in ENGINES:
        if engine.name == name:
            return engine
    raise UnknownEngineError(f"no engine is called `{name}`; there are: {', '.join(e.name for e in ENGINES)}")


def interpreters(options: Sequence[str], environment: Mapping[str, str] = os.environ) -> dict[str, list[Path]]:
    """Where to look, by engine or family, ``""`` for all: what ``--python`` says, then the variable, then here."""
    places: dict[str, list[Path]] = {"": []}
    families = {e.name for e in ENGINES} | {e.family for e in ENGINES}
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


def find(engines: Iterable[Engine], places: Mapping[str, Sequence[Path]]) -> dict[str, Found | None]:
    """Each engine by name, with the first interpreter that has all it needs; None where there is none."""
    return {engine.name: _find(engine, places) for engine in engines}


def _find(engine: Engine, places: Mapping[str, Sequence[Path]]) -> Found | None:
    for python in (*places.get(engine.name, ()), *places.get(engine.family, ()), *places.get("", ())):
        versions = _versions(python)
        if all(module in versions for module in engine.modules):
            return Found(engine, python, versions[engine.modules[0]])
    return None


@cache
def _versions(python: Path) -> dict[str, str]:
    """What of all that any engine needs an interpreter has; nothing where it does not even start."""
    modules = sorted({module for engine in ENGINES for module in engine.modules})
    try:
        return ask_probe(python, modules)
    except (OSError, ValueError, subprocess.SubprocessError):
        return {}
