"""Optional dependencies: the purpose and packages of each extra, and the command to install it."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from types import MappingProxyType

from simfoundry.errors import SimfoundryError


@dataclass(frozen=True)
class Extra:
    """An optional dependency group of this package.

    ``packages`` maps each distribution that it installs to the name of its importable module.
    """

    name: str
    purpose: str
    packages: Mapping[str, str]

    @property
    def missing(self) -> tuple[str, ...]:
        """Return the distributions that are not installed, without importing anything."""
        return tuple(name for name, module in self.packages.items() if not is_installed(module))


def is_installed(module: str) -> bool:
    """Return True if a top-level module is installed, without importing it."""
    if module in sys.modules:
        return sys.modules[module] is not None  # None prevents a module from being imported
    try:
        return find_spec(module) is not None
    except ImportError:  # raised by an import hook
        return False


def _extra(name: str, purpose: str, **packages: str) -> tuple[str, Extra]:
    return name, Extra(name, purpose, {key.replace("_", "-"): module for key, module in packages.items()})


# The extras of pyproject.toml, most useful first; a test compares the two.
EXTRAS: Mapping[str, Extra] = MappingProxyType(
    dict(
        (
            _extra("expert", "the scripted expert (`-p expert`) and reachability checks using inverse kinematics",
                   mink="mink", qpsolvers="qpsolvers", daqp="daqp"),
            _extra("robots", "known robots except `demo_arm`; each is downloaded on first use",
                   mujoco_menagerie="mujoco_menagerie"),
            _extra("pybullet", "PyBullet worlds (not required for compiling to PyBullet)", pybullet="pybullet"),
            _extra("policies", "policies served over a network (`eval -p policy.yaml`)",
                   msgpack="msgpack", pyzmq="zmq", websockets="websockets"),
            _extra("gymnasium", "tasks as Gymnasium environments", gymnasium="gymnasium"),
            _extra("vlm", "vision-language models that propose tasks and variants",
                   pydantic_ai_slim="pydantic_ai"),
            _extra("ray", "cousins on a cluster (`cousins --on ray`)", ray="ray"),
            _extra("drake", "verification of builds in Drake (`verify`)", drake="pydrake"),
            _extra("newton", "verification of builds in Newton (`verify`)", newton="newton"),
            _extra("genesis", "verification of builds in Genesis (`verify`)", genesis_world="genesis", torch="torch"),
            _extra("sapien", "verification of builds in SAPIEN (`verify`)", sapien="sapien"),
        )
    )
)  # fmt: skip


class MissingExtraError(SimfoundryError):
    """An error for missing optional packages; the message names the feature and the install command."""


def need_extra(extra: str, what: str) -> None:
    """Raise :class:`MissingExtraError` if packages in an extra, which the feature ``what`` requires, are missing."""
    missing = EXTRAS[extra].missing
    if missing:
        raise MissingExtraError(f"{what} requires {', '.join(missing)}; install with `{install_line(extra)}`")


def how_to_install(module: str) -> str:
    """Return the command that installs a module, either through the extra that contains it or as a separate package."""
    top = module.partition(".")[0]
    extra = next((extra.name for extra in EXTRAS.values() if top in extra.packages.values()), None)
    return install_line(extra) if extra is not None else f"pip install {top.replace('_', '-')}"


def install_line(extra: str) -> str:
    """Return the command that installs an extra."""
    return f"pip install 'simfoundry[{EXTRAS[extra].name}]'"
