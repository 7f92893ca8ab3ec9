"""Optional dependencies of SimFoundry, and the commands that install them."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec

from simfoundry.errors import SimfoundryError


@dataclass(frozen=True)
class Extra:
    """An optional dependency group of SimFoundry.

    ``packages`` maps each distribution in the group to the name of its importable module.
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


# The extras in pyproject.toml, starting with the most useful one; a test compares the two lists.
EXTRAS: Mapping[str, Extra] = {extra.name: extra for extra in (
    Extra("expert", "the scripted expert (`-p expert`) and reachability checks using inverse kinematics",
          {"mink": "mink", "qpsolvers": "qpsolvers", "daqp": "daqp"}),
    Extra("robots", "known robots except `demo_arm`; each is downloaded on first use",
          {"mujoco-menagerie": "mujoco_menagerie"}),
    Extra("train", "training of the baseline (`train`) and rollouts with it (`eval -p baseline:FOLDER`)",
          {"torch": "torch", "safetensors": "safetensors", "mink": "mink", "qpsolvers": "qpsolvers", "daqp": "daqp"}),
    Extra("pybullet", "PyBullet worlds (not required for compiling to PyBullet)", {"pybullet": "pybullet"}),
    Extra("policies", "policies served over a network (`eval -p policy.yaml`)",
          {"msgpack": "msgpack", "pyzmq": "zmq", "websockets": "websockets"}),
    Extra("data", "datasets for training (`dataset build`)",
          {"av": "av", "google-crc32c": "google_crc32c", "h5py": "h5py", "pyarrow": "pyarrow"}),
    Extra("sensors", "recordings of depth cameras (`capture FILE`) and depth in OpenEXR",
          {"lzfse": "lzfse", "mcap": "mcap", "mcap-ros2-support": "mcap_ros2", "openexr": "OpenEXR",
           "rosbags": "rosbags"}),
    Extra("gymnasium", "tasks as Gymnasium environments", {"gymnasium": "gymnasium"}),
    Extra("editor", "the language server (`lsp`)", {"pygls": "pygls", "lsprotocol": "lsprotocol"}),
    Extra("studio", "the editor in the browser (`studio`, `show --web`, `show --html`)",
          {"viser": "viser", "zstandard": "zstandard"}),
    Extra("onnx", "models that run on a CPU from ONNX files (`models`)", {"onnxruntime": "onnxruntime"}),
    Extra("vlm", "vision-language models that propose tasks and variants", {"pydantic-ai-slim": "pydantic_ai"}),
    Extra("ray", "batch commands on a cluster (`--on ray`)", {"ray": "ray"}),
    Extra("drake", "verification of builds in Drake (`verify`)", {"drake": "pydrake"}),
    Extra("newton", "verification of builds in Newton (`verify`)", {"newton": "newton"}),
    Extra("genesis", "verification of builds in Genesis (`verify`)", {"genesis-world": "genesis", "torch": "torch"}),
    Extra("sapien", "verification of builds in SAPIEN (`verify`)", {"sapien": "sapien"}),
)}  # fmt: skip


class MissingExtraError(SimfoundryError):
    """Raised if optional packages are missing. The message names the feature and the install command."""


def need_extra(extra: str, what: str) -> None:
    """Ensure that the extra that the feature ``what`` requires is fully installed.

    Raises:
        MissingExtraError: If a package of the extra is missing.
    """
    missing = EXTRAS[extra].missing
    if missing:
        raise MissingExtraError(f"{what} requires {', '.join(missing)}; install with `{install_line(extra)}`")


def how_to_install(module: str) -> str:
    """Return the command that installs a module, either with the extra that contains it or as a separate package."""
    top = module.partition(".")[0]
    extra = next((extra.name for extra in EXTRAS.values() if top in extra.packages.values()), None)
    return install_line(extra) if extra is not None else f"pip install {top.replace('_', '-')}"


def install_line(extra: str) -> str:
    """Return the command that installs an extra."""
    return f"pip install 'simfoundry[{extra}]'"
