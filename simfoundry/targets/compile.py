"""Compilation of a scene for a target: the files of its backend, the simulator's loader, and the losses of both."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from simfoundry.backends import compile_scene
from simfoundry.backends.artifact import Artifact
from simfoundry.backends.features import FEATURES, Fidelity, Loss
from simfoundry.scene.model import Scene
from simfoundry.targets.find import Target

if TYPE_CHECKING:
    from simfoundry.targets.profile import TargetSpec


def compile_target(scene: Scene, target: Target) -> Artifact:
    """Compile ``scene`` for ``target``; the losses are those of the backend and of the simulator."""
    artifact, profile = target_files(scene, target), target.profile
    return replace(artifact, losses=(*_left(artifact, scene, profile), *_own(scene, profile)))


def target_files(scene: Scene, target: Target) -> Artifact:
    """Compile the files of ``target``, with the losses of the backend alone."""
    artifact = replace(compile_scene(scene, target.backend, target.options), target=target.name)
    files = dict(artifact.files)
    if target.loader is not None:
        files = {path: data for path, data in files.items() if not path.startswith("load_")}
        files["load.py"] = target.loader.read_bytes()
    for name in target.profile.writes:
        from simfoundry.targets.writers import WRITERS

        files |= WRITERS[name](scene)
    return replace(artifact, files=files)


def _left(artifact: Artifact, scene: Scene, profile: TargetSpec) -> Iterator[Loss]:
    """Yield the losses of the backend that the loader does not restore; it cannot restore what lowering left out."""
    absent = {part.path for part in scene.left_out}
    combined = {name for name in ("friction", "restitution") if getattr(profile.combines, name) is not None}
    told = profile.restores.keys() | combined | profile.gaps.keys()
    for loss in artifact.losses:
        if loss.element in absent or loss.feature not in told:
            yield loss


def _own(scene: Scene, profile: TargetSpec) -> Iterator[Loss]:
    """Yield the losses of the simulator for the features that the scene uses."""
    from simfoundry.targets.combine import pair_losses

    yield from pair_losses(scene, profile.combines, profile.name)
    for name, gap in profile.gaps.items():
        if any(FEATURES[name].users(scene)):
            yield Loss(name, "", Fidelity(gap.fidelity), f"{gap.reason} ({gap.kind})")
