"""Compilation of a scene for a target, which combines a backend's files with a simulator's loader."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING

from simfoundry.backends import compile_scene
from simfoundry.backends.artifact import Artifact
from simfoundry.backends.features import FEATURES, Fidelity, Loss, approximate, combination_reason
from simfoundry.scene.model import Scene
from simfoundry.targets.find import Target

if TYPE_CHECKING:
    from simfoundry.targets.profile import Combines


def compile_target(scene: Scene, target: Target) -> Artifact:
    """Compile ``scene`` for ``target``, including the losses of both the backend and the simulator."""
    artifact, profile = target_files(scene, target), target.profile
    # The loader restores some losses of the backend, but not what lowering omitted.
    absent = {part.path for part in scene.left_out}
    combined = {name for name in ("friction", "restitution") if getattr(profile.combines, name) is not None}
    restated = profile.restores.keys() | combined | profile.gaps.keys()
    left = [loss for loss in artifact.losses if loss.element in absent or loss.feature not in restated]
    gaps = [
        Loss(name, "", Fidelity(gap.fidelity), f"{gap.reason} ({gap.kind})")
        for name, gap in profile.gaps.items()
        if any(FEATURES[name].users(scene))
    ]
    return replace(artifact, losses=(*left, *pair_losses(scene, profile.combines, profile.name), *gaps))


def target_files(scene: Scene, target: Target) -> Artifact:
    """Compile the files for ``target``, including only the backend's losses."""
    artifact = replace(compile_scene(scene, target.backend, target.options), target=target.name)
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
    """Yield one loss each for friction and restitution, based on the pair in the scene with the largest error."""
    for field in ("friction", "restitution"):
        rule = getattr(combines, field)
        worst = None if rule is None else _worst(scene, field, RULES[rule][1])
        if worst is not None:
            a, b, meant, got = worst
            reason = combination_reason(simulator, RULES[rule][0], a, b, got, meant)
            yield approximate(field, "", reason, abs(got - meant))


def _worst(scene: Scene, field: str, rule: Callable[[float, float], float]) -> tuple[float, float, float, float] | None:
    """Return the pair of coefficients with the largest error, followed by the intended and the actual combined value.

    Returns None if the two combined values never differ.
    """
    values = {(o.name, float(getattr(c, field))) for o in scene.objects for link in o.links for c in link.colliders}
    met = {(a, b) if a <= b else (b, a) for (one, a), (two, b) in combinations(sorted(values), 2) if one != two}
    pairs = [(a, b, math.sqrt(a * b), rule(a, b)) for a, b in sorted(met)]
    off = [p for p in pairs if abs(p[3] - p[2]) > 1e-9]
    return max(off, key=lambda p: abs(p[3] - p[2]), default=None)
