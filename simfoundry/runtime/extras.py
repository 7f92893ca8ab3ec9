"""Optional packages: the purpose of each extra, its packages, and the line that installs it."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from types import MappingProxyType

from simfoundry.errors import SimfoundryError


@dataclass(frozen=True)
class Extra:
    """One of the package's optional dependencies.

    ``packages`` maps the distributions that it installs onto the modules by which they are imported.
    """

    name: str
    purpose: str
    packages: Mapping[str, str]

    @property
    def missing(self) -> tuple[str, ...]:
        """The distributions that cannot be imported here; nothing is imported to find out."""
        return tuple(name for name, module in self.packages.items() if not is_installed(module))


def is_installed(module: str) -> bool:
    """Return whether a top-level module can be found; it is not imported."""
    if module in sys.modules:
        return sys.modules[module] is not None  # None stands for one that must not be imported
    try:
        return find_spec(module) is not None
    except ImportError:  # a finder that refuses it
        return False


def _extra(name: str, purpose: str, **packages: str) -> tuple[str, Extra]:
    return name, Extra(name, purpose, {key.replace("_", "-"): module for key, module in packages.items()})


EXTRAS: Mapping[str, Extra] = MappingProxyType(
    dict(
        (
            _extra("expert", "the scripted expert (`-p expert`), and whether an arm reaches: inverse kinematics",
                   mink="mink", qpsolvers="qpsolvers", daqp="daqp"),
            _extra("robots", "known robots but `demo_arm`: each is fetched when it is first used",
                   mujoco_menagerie="mujoco_menagerie"),
            _extra("pybullet", "PyBullet worlds (their files are written without it)", pybullet="pybullet"),
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
"""The extras of pyproject.toml, most wanted first; a test compares the two."""


class MissingExtraError(SimfoundryError):
    """Packages that are not installed; the message says what needs them, and the line that installs them."""


def need_extra(extra: str, what: str) -> None:
    """Raise :class:`MissingExtraError` where packages of an extra are missing that ``what`` needs."""
    missing = EXTRAS[extra].missing
    if missing:
        raise MissingExtraError(f"{what} needs {', '.join(missing)}; install with `{install_line(extra)}`")


def how_to_install(module: str) -> str:
    """The line that installs the package of a module: that of the extra that it belongs to, or its own."""
    top = module.partition(".")[0]
    extra = next((extra.name for extra in EXTRAS.values() if top in extra.packages.values()), None)
    return install_line(extra) if extra is not None else f"pip install {top.replace('_', '-')}"


def install_line(extra: str) -> str:
    """The line that installs an extra, as people type it."""
    return f"pip install 'simfoundry[{EXTRAS[extra].name}]'"
