"""Restitution in MuJoCo, which has none: the damping of a contact."""

from __future__ import annotations

import math
from functools import lru_cache

from simfoundry.backends.artifact import Fidelity, Loss
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


def restitution_losses(scene: Scene) -> tuple[Loss, ...]:
    """One loss for each object that bounces, and one for all that should not and do a little."""
    reason = "MuJoCo has no restitution: a contact is damped to rebound within 0.03 of it, but never below 0.14"
    bouncing = {o.name: [c.restitution for link in o.links for c in link.colliders] for o in scene.objects}
    losses = [Loss(f"{name}.restitution", Fidelity.APPROXIMATED, reason) for name, es in bouncing.items() if any(es)]
    if any(e == 0 for es in bouncing.values() for e in es):
        still = "MuJoCo's soft contacts rebound with 0.10 to 0.14 of the speed of impact where the scene says 0"
        losses.append(Loss("restitution", Fidelity.APPROXIMATED, still))
    return tuple(losses)
