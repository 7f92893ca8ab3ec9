"""Scene to files: one module a target format, each a pure function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from typing import cast

from simfoundry.backends.artifact import Artifact, Fidelity, Loss
from simfoundry.scene.model import Scene

BACKENDS: dict[str, str] = {
    "mjcf": "simfoundry.backends.mjcf:compile_mjcf",
    "pybullet": "simfoundry.backends.pybullet:compile_pybullet",
    "urdf": "simfoundry.backends.urdf:compile_urdf",
    "usd": "simfoundry.backends.usd:compile_usd",
}
"""Every backend by name, as ``module:function``; it is imported when it is first used."""


def compile_scene(scene: Scene, target: str) -> Artifact:
    """Compile ``scene`` with the backend called ``target``; a ValueError lists the names there are."""
    if target not in BACKENDS:
        raise ValueError(f"no backend {target!r}; there are: {', '.join(BACKENDS)}")
    module, function = BACKENDS[target].split(":")
    backend = cast(Callable[[Scene], Artifact], getattr(import_module(module), function))
    artifact = backend(scene)
    left_out = tuple(Loss(part.path, Fidelity.DROPPED, part.reason) for part in scene.left_out)
    return replace(artifact, losses=(*artifact.losses, *left_out))
