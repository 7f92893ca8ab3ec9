"""What is installed here, what for, and how to get what is not."""

from __future__ import annotations

import platform
import sys
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any

PYBULLET_REMEDY = (
    "pip install 'simfoundry[pybullet]' (wheels exist up to Python 3.11 on Linux; elsewhere pip compiles it, which "
    "takes some minutes and needs a C++ compiler)"
)
GL_REMEDY = "install libegl1 (or libosmesa6) with the system's package manager; until then pictures are ray-cast"


@dataclass(frozen=True)
class Part:
    """One thing the project can use: its ``version`` is empty where it is missing."""

    name: str
    version: str
    required: bool
    purpose: str
    remedy: str

    def to_json(self) -> dict[str, Any]:
        """A plain mapping."""
        return asdict(self)


_PACKAGES = (
    ("numpy", True, "arrays"),
    ("pydantic", True, "typed documents"),
    ("pyyaml", True, "reading YAML"),
    ("trimesh", True, "reading meshes"),
    ("coacd", True, "convex parts"),
    ("scipy", True, "hulls, spatial search"),
    ("shapely", True, "outlines"),
    ("opencv-python-headless", True, "pictures"),
    ("usd-core", True, "USD worlds"),
    ("mujoco", True, "MuJoCo worlds, settling, rendering"),
    ("pybullet", False, "PyBullet worlds (its files are written without it)"),
)


def examine() -> list[Part]:
    """Every part in a fixed order, the interpreter first."""
    parts = [Part("python", platform.python_version(), True, "3.11 or later", "install Python 3.11 or later")]
    for name, required, purpose in _PACKAGES:
        remedy = PYBULLET_REMEDY if name == "pybullet" else f"pip install {name}"
        parts.append(Part(name, _version(name), required, purpose, remedy))
    if sys.platform.startswith("linux"):
        from simfoundry.worlds.gl import working_drivers

        drivers = working_drivers()
        parts.append(Part("offscreen GL", " ".join(drivers), False, "MuJoCo's renderer", GL_REMEDY))
    return parts


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""
