"""Restitution in MuJoCo, which has none: the damping of a contact."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache

from simfoundry.backends.losses import Loss, approximate
from simfoundry.scene.model import Scene

_CONTACT_TIME = 0.02
"""Time constant of a contact [s]: MuJoCo's own default. At 0.008 a bowl that falls by 2 cm sinks 1.5 mm into a table,
not 4, but below 0.012 a can on its side rolls away."""

CRITICAL_REBOUND = math.exp(-2)
"""Restitution of a critically damped contact."""


def solref(restitution: float) -> tuple[float, float]:
    """MuJoCo's time constant [s] and damping ratio of a contact that rebounds at ``restitution``.

    The stiffness is that of MuJoCo's default contact; only the damping follows the restitution.
    """
    ratio = damping_ratio(restitution)
    return _CONTACT_TIME / ratio, ratio


@lru_cache(maxsize=256)
def damping_ratio(restitution: float) -> float:
    """Damping ratio of a spring and damper that only push and rebound at ``restitution``.

    The bodies part when the force, not the depth, reaches zero (Schwager and Poeschel, Granular Matter 9, 2007), so
    critical damping still rebounds at exp(-2): less than that is out of reach and gets ratio 1.
    """
    if restitution <= CRITICAL_REBOUND:
        return 1.0
    low, high = 1e-3, 1.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if rebound(middle) > restitution else (low, middle)
    return (low + high) / 2


def rebound(ratio: float) -> float:
    """Restitution of a spring and damper of a damping ratio below 1 that only push."""
    root = math.sqrt(1 - ratio * ratio)
    return math.exp(-ratio / root * math.atan2(2 * ratio * root, 2 * ratio * ratio - 1))


def restitution_losses(scene: Scene) -> Iterator[Loss]:
    """Yield one loss for each object that bounces, and one for all that should not and do a little."""
    reason = "MuJoCo has no restitution; a contact is damped to rebound within 0.03 of it, but never below 0.14."
    bouncing = {o.name: [c.restitution for link in o.links for c in link.colliders] for o in scene.objects}
    yield from (approximate("restitution", name, reason, 0.03) for name, values in bouncing.items() if any(values))
    if any(e == 0 for values in bouncing.values() for e in values):
        still = "MuJoCo's soft contacts rebound at 0.10 to 0.14 of the impact speed where the scene states 0."
        yield approximate("restitution", "", still, 0.14)
