"""Optional packages: the purpose and packages of each extra, and the command that installs it."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from types import MappingProxyType

from simfoundry.errors import SimfoundryError


@dataclass(frozen=True)
class Extra:
    """One optional dependency of the package.

    ``packages`` maps the distributions that it installs to the modules by which they are imported.
    """

    name: str
    purpose: str
    packages: Mapping[str, str]

    @property
    def missing(self) -> tuple[str, ...]:
        """The distributions that cannot be found; nothing is imported."""
        return tuple(name for name, module in self.packages.items() if not is_installed(module))


def is_installed(module: str) -> bool:
    """Return true if a top-level module can be found, without importing it."""
    if module in sys.modules:
        return sys.modules[module] is not None  # None blocks the import of a module
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
            _extra("expert", "the scripted expert (`-p expert`) and reachability checks by inverse kinematics",
                   mink="mink", qpsolvers="qpsolvers", daqp="daqp"),
            _extra("robots", "known robots except `demo_arm`; each is downloaded on first use",
                   mujoco_menagerie="mujoco_menagerie"),
            _extra("pybullet", "PyBullet worlds (not needed to write their files)", pybullet="pybullet"),
            _extra("policies", "policies behind a server (`eval -p policy.yaml`)",
                   msgpack="msgpack", pyzmq="zmq", websockets="websockets"),
            _extra("gymnasium", "tasks as `gymnasium` environments", gymnasium="gymnasium"),
            _extra("vlm", "vision-language models that propose tasks and variants",
                   pydantic_ai_slim="pydantic_ai"),
            _extra("ray", "cousins on a cluster (`cousins --on ray`)", ray="ray"),
            _extra("drake", "builds checked in Drake (`verify`)", drake="pydrake"),
            _extra("newton", "builds checked in Newton (`verify`)", newton="newton"),
            _extra("genesis", "builds checked in Genesis (`verify`)", genesis_world="genesis", torch="torch"),
            _extra("sapien", "builds checked in SAPIEN (`verify`)", sapien="sapien"),
        )
    )
)  # fmt: skip


class MissingExtraError(SimfoundryError):
    """An error for packages that are not installed; the message names the feature and the install command."""


def need_extra(extra: str, what: str) -> None:
    """Raise :class:`MissingExtraError` if ``what`` needs packages of an extra that are missing."""
    missing = EXTRAS[extra].missing
    if missing:
        raise MissingExtraError(f"{what} needs {', '.join(missing)}; install with `{install_line(extra)}`")


def how_to_install(module: str) -> str:
    """Return the command that installs a module: that of the extra it belongs to, or that of its own package."""
    top = module.partition(".")[0]
    extra = next((extra.name for extra in EXTRAS.values() if top in extra.packages.values()), None)
    return install_line(extra) if extra is not None else f"pip install {top.replace('_', '-')}"


def install_line(extra: str) -> str:
    """Return the command that installs an extra."""
    return f"pip install 'simfoundry[{EXTRAS[extra].name}]'"
