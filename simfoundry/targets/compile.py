"""Compilation of a scene for a target, which combines a backend's files with a simulator's loader."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING

from simfoundry.backends import compile_scene
from simfoundry.backends.artifact import Artifact
from simfoundry.backends.features import FEATURES, Fidelity
from simfoundry.backends.losses import Loss, approximate, combination_reason
from simfoundry.scene.model import Scene
from simfoundry.targets.event_terms import event_losses
from simfoundry.targets.find import Target

if TYPE_CHECKING:
    from simfoundry.targets.profile import Combines


def compile_target(scene: Scene, target: Target) -> Artifact:
    """Compile ``scene`` for ``target``, including the losses of both the backend and the simulator."""
    artifact, profile = target_files(scene, target), target.profile
    # The loader restores some losses of the backend, but not what lowering omitted.
    absent = {part.path for part in scene.left_out}
    restated = profile.restored | profile.gaps.keys()
    left = [loss for loss in artifact.losses if loss.element in absent or loss.feature not in restated]
    gaps = [
        Loss(name, "", Fidelity(gap.fidelity), f"{gap.reason} ({gap.kind})")
        for name, gap in profile.gaps.items()
        if any(FEATURES[name].users(scene))
    ]
    if "events" in profile.writes:
        gaps += event_losses(scene)
    return replace(artifact, losses=(*left, *pair_losses(scene, profile.combines, profile.name), *gaps))


def target_files(scene: Scene, target: Target) -> Artifact:
    """Compile the files for ``target``, including only the losses of the backend."""
    artifact = replace(compile_scene(scene, target.backend, target.profile.options), target=target.name)
    files = dict(artifact.files)
    if target.loader is not None:
        files = {path: data for path, data in files.items() if not path.startswith("load_")}
        files["load.py"] = target.loader.read_bytes()
    for name in target.profile.writes:
        from simfoundry.targets.writers import WRITERS

        files |= WRITERS[name](scene)
    return replace(artifact, files=files)


RULES: dict[str, tuple[str, Callable[[float, float], float]]] = {
    "average": ("the average", lambda a, b: (a + b) / 2),
    "harmonic": ("the harmonic mean", lambda a, b: 2 * a * b / (a + b) if a + b else 0.0),
    "maximum": ("the larger", max),
    "minimum": ("the smaller", min),
    "multiply": ("the product", lambda a, b: a * b),
}


def pair_losses(scene: Scene, combines: Combines, simulator: str) -> Iterator[Loss]:
    """Yield one loss for friction and one for restitution.

    Each is based on the pair of surfaces with the largest error.
    """
    for field in ("friction", "restitution"):
        if getattr(combines, field) is None:
            continue
        words, rule = RULES[getattr(combines, field)]
        values = {(o.name, float(getattr(c, field))) for o in scene.objects for link in o.links for c in link.colliders}
        met = {(a, b) if a <= b else (b, a) for (one, a), (two, b) in combinations(sorted(values), 2) if one != two}
        pairs = [(a, b, rule(a, b), math.sqrt(a * b)) for a, b in sorted(met)]
        a, b, got, wanted = max(pairs, key=lambda pair: abs(pair[2] - pair[3]), default=(0.0, 0.0, 0.0, 0.0))
        if abs(got - wanted) > 1e-9:
            reason = combination_reason(simulator, words, a, b, got, wanted)
            yield approximate(field, "", reason, abs(got - wanted))
