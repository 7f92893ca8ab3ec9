"""The predicates ``Touching``, ``OnTop`` and ``Inside``, which describe contact, support and containment."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from simfoundry.predicates.judging import thresholds
from simfoundry.predicates.judging.thresholds import ENCLOSED, SETTLED, TOUCH
from simfoundry.scene.lengths import length
from simfoundry.spec.models.predicate import Effect, Predicate

if TYPE_CHECKING:
    from simfoundry.predicates.judging.bodies import Entity
    from simfoundry.predicates.judging.judge import Terms


def touching(terms: Terms, a: Entity, b: Entity) -> None:
    """Require that the distance between two entities is at most :data:`TOUCH`."""
    gap = terms.context.distances.between(terms.view, a, b, TOUCH)
    terms.require(gap, TOUCH - gap, lambda v, ok: terms.gap_text(a, b, v))


TOUCHING = Predicate(
    "Touching",
    "the two objects touch",
    ("body", "body"),
    touching,
    f"their surfaces are at most {TOUCH * 1000:g} mm apart",
    effect=Effect.MOVE,
    aliases=("touching",),
    contact=True,
)


# Conversion from the cosine of the support angle to a margin [m]. The result is comparable to the other margins of
# objects at rest, which are a few millimeters.
STEEP_SCALE = 0.01


def on_top(terms: Terms, a: Entity, b: Entity) -> None:
    """Require that ``b`` touches ``a``, pushes it up and balances it, and that ``a`` is at rest and not held."""
    from simfoundry.predicates.judging import measurements

    terms.require_at_rest(a)
    contact = measurements.SupportContact(terms.context, a, b)
    terms.require_if_open(contact.gap, contact.margin, lambda v, ok: terms.gap_text(a, b, v))
    terms.require_if_open(
        contact.push,
        lambda v: STEEP_SCALE * (v - contact.least_cosine),
        lambda v, ok: "" if ok else measurements.push_text(a, b, v),
    )
    balance = partial(measurements.balance, terms.context, a, b)
    terms.require_if_open(balance, lambda v: v, lambda v, ok: measurements.balance_text(a, b, v))
    terms.require_not_held(a)


ON_TOP = Predicate(
    "OnTop",
    "the first object rests on top of the second",
    ("thing", "thing"),
    on_top,
    f"`b` supports `a`: `b` is at most {TOUCH * 1000:g} mm from `a` and pushes it within {thresholds.SUPPORT_DEG:g} "
    f"deg of straight up, allowing for {thresholds.FRICTION_SHARE:.0%} of the friction angle; the center of mass of "
    "`a` is over the outline of `b`, or `a` also touches another object; if `b` is farther away than "
    f"{thresholds.CLOSE * 1000:g} mm, no object closer than that supports `a`; `a` moves no faster than "
    f"{SETTLED * 100:g} cm/s and is not held by a robot. For example, an object in a bowl rests on the bowl, an object "
    "on a hook rests on the hook, and an object that leans on an edge rests on the edge",
    effect=Effect.PLACE,
    aliases=("ontop", "On", "OnTopAABB", "OnTopOf", "on_top"),
    contact=True,
)


def inside(terms: Terms, a: Entity, b: Entity) -> None:
    """Require that at least half of ``a`` is in a cavity of ``b``, and that ``a`` is at rest and not held."""
    import numpy as np

    from simfoundry.predicates.judging.distances import FAR
    from simfoundry.predicates.judging.measurements import enclosed_depth

    depth = enclosed_depth(terms.view, a, b)
    share = f"{ENCLOSED:.0%} of `{a.name}`"

    def text(v: float, ok: bool) -> str:
        if not np.isfinite(v):
            return f"`{b.name}` is tilted too far to contain an object"
        where = "deep in the cavity" if ok else "outside the cavity"
        return f"{share} is {'at least ' if ok else ''}{length(abs(v))} {where} of `{b.name}`"

    terms.require(depth, np.where(np.isfinite(depth), depth, -FAR), text)
    terms.require_at_rest(a)
    terms.require_not_held(a)


INSIDE = Predicate(
    "Inside",
    "the first object is in a cavity of the second",
    ("thing", "thing"),
    inside,
    f"at least {ENCLOSED:.0%} of the volume of `a` is in a cavity of `b` whose opening is tilted at most "
    f"{thresholds.OPENING_DEG:g} deg from straight up; `a` moves no faster than {SETTLED * 100:g} cm/s and is not "
    "held by a robot",
    effect=Effect.PLACE,
    aliases=("inside", "In", "InsideAABB"),
    contact=True,
)
