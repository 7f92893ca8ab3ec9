"""An inventory of the components that SimFoundry can use, and the commands that install missing components."""

from __future__ import annotations

import importlib
import os
import platform
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import yaml

from simfoundry.errors import SimfoundryError
from simfoundry.models.generators import IMAGES_URL, MESHES_URL
from simfoundry.runtime.extras import EXTRAS, install_line
from simfoundry.runtime.native_output import quiet_native_output

PYBULLET_REMEDY = (
    f"{install_line('pybullet')} (wheels exist for Linux up to Python 3.11; elsewhere pip compiles it, which takes "
    "several minutes and requires a C++ compiler)"
)
GL_REMEDY = "install libegl1 (or libosmesa6) with the system's package manager; until then, images are ray-cast"


@dataclass(frozen=True)
class Part:
    """A component that SimFoundry can use. If the component is not installed, ``version`` is empty."""

    section: str
    name: str
    version: str
    required: bool
    purpose: str
    remedy: str


def examine() -> list[Part]:
    """Return all components, grouped by section in a fixed order.

    Nothing is downloaded, and model servers are not contacted.
    """
    return [*_packages(), *_extras(), *_robots(), *_renderers(), *_models()]


def _packages() -> Iterator[Part]:
    here = platform.python_version()
    yield Part("packages", "python", here, True, "3.11 or later", "install Python 3.11 or later")
    table = yaml.safe_load(Path(__file__).with_name("packages.yaml").read_text(encoding="utf-8"))
    for name, (module, purpose) in table.items():
        found, problem = _found(name, module)
        yield Part("packages", name, found, True, purpose, f"pip install {name}{problem}")


def _extras() -> Iterator[Part]:
    """Yield the optional dependencies. Packages that are slow to load are located without importing them."""
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
    """Yield the known robots, along with the commands that install missing models."""
    from simfoundry.scene.robot import lower_robot
    from simfoundry.scene.robot_files import NoModelError
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
    absent = "not available on this system; the ray caster is used instead"
    remedy = GL_REMEDY if sys.platform.startswith("linux") else absent
    for name in ("egl", "osmesa"):
        yield Part("renderers", name, "works" if name in drivers else "", False, "MuJoCo's renderer", remedy)
    yield Part("renderers", "raycast", "built in", False, "images of scenes without a GL driver", "")


def _models() -> Iterator[Part]:
    """Yield the configured connections to foundation models, without contacting any server."""
    vlm = EXTRAS["vlm"]
    found = "" if vlm.missing else f"pydantic-ai {_version('pydantic-ai-slim')}"
    purpose = "proposes tasks and variants (`--vlm MODEL`, with the API key in the provider's variable)"
    yield Part("models", "vision-language", found, False, purpose, install_line("vlm"))
    for name, variable, purpose in (
        ("images", IMAGES_URL, "generates images of object variants, for recipes that request them"),
        ("meshes", MESHES_URL, "generates meshes from images, for recipes that request them"),
    ):
        address = "set" if os.environ.get(variable) else ""
        yield Part("models", name, address, False, purpose, f"export {variable}=http://… with its server address")


def _found(name: str, module: str) -> tuple[str, str]:
    """Return the version of a package, and a note about the error if the package is installed but cannot be imported.

    The version is empty if the package cannot be imported, and the note is empty if there is no such error.
    """
    try:
        with quiet_native_output():
            loaded = importlib.import_module(module)
    except Exception as error:  # a missing library can raise any exception
        reason = "" if isinstance(error, ModuleNotFoundError) else f" (importing it fails: {error})"
        return "", reason
    return _version(name) or str(getattr(loaded, "__version__", "unknown")), ""


def _version(name: str) -> str:
    """Return the version of a distribution, or an empty string if no distribution has this name.

    This is the case for some variants of OpenCV.
    """
    try:
        return version(name)
    except PackageNotFoundError:
        return ""
