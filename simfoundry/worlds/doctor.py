"""What is installed here, what for, and how to get what is not."""

from __future__ import annotations

import importlib
import platform
import sys
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any

PYBULLET_REMEDY = (
    "`pip install pybullet` adds it (wheels exist up to Python 3.11 on Linux; elsewhere pip compiles it, which takes "
    "some minutes and needs a C++ compiler)"
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
    ("numpy", "numpy", True, "arrays"),
    ("pydantic", "pydantic", True, "typed documents"),
    ("pyyaml", "yaml", True, "reading YAML"),
    ("click", "click", True, "the command line"),
    ("rich", "rich", True, "progress bars"),
    ("pillow", "PIL", True, "reading pictures"),
    ("opencv-python-headless", "cv2", True, "working on pictures"),
    ("trimesh", "trimesh", True, "reading meshes"),
    ("coacd", "coacd", True, "convex parts"),
    ("fast-simplification", "fast_simplification", True, "large meshes made smaller"),
    ("mapbox-earcut", "mapbox_earcut", True, "triangles of outlines"),
    ("scipy", "scipy", True, "hulls, spatial search"),
    ("shapely", "shapely", True, "outlines"),
    ("usd-core", "pxr.Usd", True, "USD worlds"),
    ("mujoco", "mujoco", True, "MuJoCo worlds, settling, rendering"),
    ("pybullet", "pybullet", False, "PyBullet worlds (its files are written without it)"),
)
"""Name of the distribution, of the module, whether it is required, and what for."""


def examine() -> list[Part]:
    """Every part in a fixed order, the interpreter first."""
    parts = [Part("python", platform.python_version(), True, "3.11 or later", "install Python 3.11 or later")]
    for name, module, required, purpose in _PACKAGES:
        found, problem = _found(name, module)
        remedy = PYBULLET_REMEDY if name == "pybullet" else f"pip install {name}"
        parts.append(Part(name, found, required, purpose, f"{remedy}{problem}"))
    if sys.platform.startswith("linux"):
        from simfoundry.worlds.gl import working_drivers

        drivers = working_drivers()
        parts.append(Part("offscreen GL", " ".join(drivers), False, "MuJoCo's renderer", GL_REMEDY))
    return parts


def _found(name: str, module: str) -> tuple[str, str]:
    """The version of a package that can be imported; else nothing, and what went wrong if it is installed."""
    from simfoundry.worlds.pybullet_world import quiet_native_output

    try:
        with quiet_native_output():
            loaded = importlib.import_module(module)
    except Exception as error:  # a library that the package needs may be missing, and say so in its own way
        reason = "" if isinstance(error, ModuleNotFoundError) else f" (importing it fails: {error})"
        return "", reason
    try:
        return version(name), ""
    except PackageNotFoundError:  # from another distribution of it, as OpenCV has several
        return str(getattr(loaded, "__version__", "unknown")), ""
