"""Inventory of what is installed, what it is for, and how to get what is missing."""

from __future__ import annotations

import importlib
import os
import platform
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from simfoundry.errors import SimfoundryError
from simfoundry.models import images, meshes
from simfoundry.runtime.extras import EXTRAS, install_line

PYBULLET_REMEDY = (
    f"{install_line('pybullet')} (wheels exist up to Python 3.11 on Linux; elsewhere pip compiles it, which takes "
    "some minutes and needs a C++ compiler)"
)
GL_REMEDY = "install libegl1 (or libosmesa6) with the system's package manager; until then pictures are ray-cast"


SECTIONS = ("packages", "extras", "robots", "renderers", "models")
"""What is looked at, in this order."""


@dataclass(frozen=True)
class Part:
    """One thing that the project can use. ``version`` is what is here, empty where it is missing."""

    section: str
    name: str
    version: str
    required: bool
    purpose: str
    remedy: str

    def to_json(self) -> dict[str, Any]:
        """A plain mapping."""
        return asdict(self)


_PACKAGES = (
    ("numpy", "numpy", "arrays"),
    ("pydantic", "pydantic", "typed documents"),
    ("pyyaml", "yaml", "reading YAML"),
    ("click", "click", "the command line"),
    ("rich", "rich", "progress bars"),
    ("pillow", "PIL", "reading pictures"),
    ("opencv-python-headless", "cv2", "working on pictures"),
    ("trimesh", "trimesh", "reading meshes"),
    ("coacd", "coacd", "convex parts"),
    ("fast-simplification", "fast_simplification", "large meshes made smaller"),
    ("mapbox-earcut", "mapbox_earcut", "triangles of outlines"),
    ("scipy", "scipy", "hulls, spatial search"),
    ("shapely", "shapely", "outlines"),
    ("usd-core", "pxr.Usd", "USD worlds"),
    ("mujoco", "mujoco", "MuJoCo worlds, settling, rendering"),
)
"""Name of the distribution, of the module, and what for. All are required."""


def examine() -> list[Part]:
    """Every part, section by section, in a fixed order; nothing is fetched, and no model is asked anything."""
    return [*_packages(), *_extras(), *_robots(), *_renderers(), *_models()]


def _packages() -> Iterator[Part]:
    here = platform.python_version()
    yield Part("packages", "python", here, True, "3.11 or later", "install Python 3.11 or later")
    for name, module, purpose in _PACKAGES:
        found, problem = _found(name, module)
        yield Part("packages", name, found, True, purpose, f"pip install {name}{problem}")


def _extras() -> Iterator[Part]:
    """The extras; those that are slow to load are only looked for."""
    for extra in EXTRAS.values():
        found, problem = "", ""
        if extra.name == "pybullet":
            found, problem = _found("pybullet", "pybullet")
        elif not extra.missing:
            name = next(iter(extra.packages))
            found = f"{name} {_version(name)}"
        elif len(extra.missing) < len(extra.packages):
            problem = f" (missing: {', '.join(extra.missing)})"
        remedy = PYBULLET_REMEDY if extra.name == "pybullet" else install_line(extra.name)
        yield Part("extras", extra.name, found, False, extra.purpose, f"{remedy}{problem}")


def _robots() -> Iterator[Part]:
    """The known robots: whether a model of each is here, and else what brings it."""
    from simfoundry.scene.robot_packages import NoModelError
    from simfoundry.scene.robots import lower_robot
    from simfoundry.spec.models.robot import RobotSpec
    from simfoundry.spec.models.robot_file import find_robot, robot_names

    for name in robot_names():
        found, remedy, purpose = "", "", ""
        try:
            known = find_robot(name)
            assert known is not None
            purpose = f"{len(known.home)} joints, reach {known.reach:g} m, opens {1000 * known.opening:g} mm"
            robot = lower_robot(name, RobotSpec(model=name), Path(), fetch=False)
            found = ", ".join(robot.models)
        except (NoModelError, SimfoundryError) as error:
            remedy = str(error)
        yield Part("robots", name, found, False, purpose, remedy)


def _renderers() -> Iterator[Part]:
    from simfoundry.render.gl import working_drivers

    drivers = working_drivers()
    for name in ("egl", "osmesa"):
        remedy = GL_REMEDY if sys.platform.startswith("linux") else "there is none for this system; rays draw instead"
        yield Part("renderers", name, "works" if name in drivers else "", False, "MuJoCo's renderer", remedy)
    yield Part("renderers", "raycast", "built in", False, "pictures of scenes where there is no driver", "")


def _models() -> Iterator[Part]:
    """Yield the ways to foundation models, by names and addresses that the user gives; else nothing is asked."""
    vlm = EXTRAS["vlm"]
    found = "" if vlm.missing else f"pydantic-ai {_version('pydantic-ai-slim')}"
    purpose = "proposes tasks and variants: `--vlm MODEL`, with the key in its provider's variable"
    yield Part("models", "vision-language", found, False, purpose, install_line("vlm"))
    for name, variable, purpose in (
        ("images", images.URL, "draws variants of objects, for recipes that ask for it"),
        ("meshes", meshes.URL, "makes meshes of pictures, for recipes that ask for it"),
    ):
        address = "set" if os.environ.get(variable) else ""
        yield Part("models", name, address, False, purpose, f"export {variable}=http://…, the address of its server")


def _found(name: str, module: str) -> tuple[str, str]:
    """The version of a package that can be imported; else nothing, and what went wrong if it is installed."""
    from simfoundry.worlds.pybullet_world import quiet_native_output

    try:
        with quiet_native_output():
            loaded = importlib.import_module(module)
    except Exception as error:  # a library that the package needs may be missing, and say so in its own way
        reason = "" if isinstance(error, ModuleNotFoundError) else f" (importing it fails: {error})"
        return "", reason
    return _version(name) or str(getattr(loaded, "__version__", "unknown")), ""


def _version(name: str) -> str:
    """The version of an installed distribution; empty for one of another name, as OpenCV has several."""
    try:
        return version(name)
    except PackageNotFoundError:
        return ""
