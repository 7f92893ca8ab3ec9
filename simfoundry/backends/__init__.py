"""Scene to files: one module a target format, each a pure function."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib import import_module
from typing import cast

from simfoundry.backends.artifact import Artifact, Fidelity, Loss
from simfoundry.backends.features import SIMPLER, Cells, collider_losses
from simfoundry.scene.model import Scene

BACKENDS: dict[str, str] = {
    "mjcf": "simfoundry.backends.mjcf:compile_mjcf",
    "pybullet": "simfoundry.backends.pybullet:compile_pybullet",
    "urdf": "simfoundry.backends.urdf:compile_urdf",
    "usd": "simfoundry.backends.usd:compile_usd",
}
"""Every backend by name, as ``module:function``; it is imported when it is first used."""

SUPPORT: dict[str, str] = {
    "mjcf": "simfoundry.backends.mjcf.features",
    "pybullet": "simfoundry.backends.pybullet",
    "urdf": "simfoundry.backends.urdf",
    "usd": "simfoundry.backends.usd.features",
}
"""The module of each backend that says, in ``FEATURES``, what it keeps."""


def backend_of(name: str) -> Callable[..., Artifact]:
    """The backend called ``name``: a function of a scene and of options; a ValueError lists the names there are."""
    if name not in BACKENDS:
        raise ValueError(f"no backend {name!r}; there are: {', '.join(BACKENDS)}")
    module, function = BACKENDS[name].split(":")
    return cast(Callable[..., Artifact], getattr(import_module(module), function))


def features_of(name: str) -> Cells:
    """What the backend called ``name`` keeps of each feature; what lowering simplified is alike in all of them."""
    module = import_module(SUPPORT[name])
    return {**cast(Cells, module.FEATURES), "collision_shape": SIMPLER}


def compile_scene(scene: Scene, target: str, options: Mapping[str, float | bool | str] | None = None) -> Artifact:
    """Compile ``scene`` with the backend called ``target``; a ValueError lists the names there are."""
    artifact = backend_of(target)(scene, **(options or {}))
    left_out = tuple(Loss(part.path, Fidelity.DROPPED, part.reason) for part in scene.left_out)
    return replace(artifact, losses=(*artifact.losses, *collider_losses(scene), *left_out))
