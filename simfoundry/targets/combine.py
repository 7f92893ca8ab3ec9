"""Losses due to an engine's rule for combining friction and restitution, which is the geometric mean in a scene."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import combinations

from simfoundry.backends.artifact import number
from simfoundry.backends.features import Loss, approximate
from simfoundry.scene.model import Scene
from simfoundry.targets.profile import Combines

RULES: dict[str, tuple[str, Callable[[float, float], float]]] = {
    "average": ("the average", lambda a, b: (a + b) / 2),
    "harmonic": ("the harmonic mean", lambda a, b: 2 * a * b / (a + b) if a + b else 0.0),
    "maximum": ("the larger", max),
    "minimum": ("the smaller", min),
    "multiply": ("the product", lambda a, b: a * b),
}


def pair_losses(scene: Scene, combines: Combines, simulator: str) -> Iterator[Loss]:
    """Yield a loss each for friction and restitution, with the pair of the scene that has the largest error."""
    for field in ("friction", "restitution"):
        rule = getattr(combines, field)
        worst = None if rule is None else _worst(scene, field, RULES[rule][1])
        if worst is not None:
            a, b, meant, got = (number(float(format(v, ".3g"))) for v in worst)
            words = RULES[rule][0]
            reason = f"{simulator} takes {words} of a pair: {got} for {a} and {b}; the scene specifies {meant}."
            yield approximate(field, "", reason, abs(worst[3] - worst[2]))


def _worst(scene: Scene, field: str, rule: Callable[[float, float], float]) -> tuple[float, float, float, float] | None:
    """Return the pair with the largest error, its intended and resulting coefficient; None if they never differ."""
    values: set[tuple[str, float]] = set()
    for item in scene.objects:
        values |= {(item.name, float(getattr(c, field))) for link in item.links for c in link.colliders}
    met = {(a, b) if a <= b else (b, a) for (one, a), (two, b) in combinations(sorted(values), 2) if one != two}
    pairs = [(a, b, math.sqrt(a * b), rule(a, b)) for a, b in sorted(met)]
    off = [p for p in pairs if abs(p[3] - p[2]) > 1e-9]
    return max(off, key=lambda p: abs(p[3] - p[2]), default=None)
