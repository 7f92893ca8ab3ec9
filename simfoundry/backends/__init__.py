"""Backends, each of which compiles a lowered scene to files in one format.

Each backend has its own folder and is registered here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from simfoundry.backends.artifact import Artifact, Backend
from simfoundry.backends.features import FEATURES, SIMPLIFIED_COLLIDERS, Cells, Fidelity
from simfoundry.backends.losses import shared_losses
from simfoundry.backends.names import InvalidSceneError
from simfoundry.runtime.plugins import Registry
from simfoundry.scene.model import Scene

# All backends by name. An installed package adds a backend through an entry point.
BACKENDS: Registry[Backend] = Registry(
    "simfoundry.backends",
    {name: f"simfoundry.backends.{name}:BACKEND" for name in ("mjcf", "pybullet", "urdf", "usd")},
    Backend,
)


def features_of(name: str) -> Cells:
    """Return the fidelity with which the ``name`` backend preserves each feature."""
    return {**BACKENDS.load(name).features, "collision_shape": SIMPLIFIED_COLLIDERS}


def compile_scene(scene: Scene, target: str, options: Mapping[str, float | bool | str] | None = None) -> Artifact:
    """Compile ``scene`` with the ``target`` backend.

    Raises:
        UnknownExtensionError: If there is no backend with this name.
        InvalidSceneError: If the scene uses a feature that the backend rejects.
    """
    backend = BACKENDS.load(target)
    for name, cell in backend.features.items():
        if cell.fidelity is Fidelity.REJECTED and (users := list(FEATURES[name].users(scene))):
            shown = ", ".join(f"`{user}`" for user in users[:3])
            raise InvalidSceneError(f"the backend `{target}` rejects {FEATURES[name].label} ({shown}): {cell.reason}")
    artifact = BACKENDS.running(target)(backend.compile)(scene, **(options or {}))
    return replace(artifact, losses=(*artifact.losses, *shared_losses(scene)))
