"""``OnTop(a, b)``: ``b`` supports ``a``, alone or with others."""

from __future__ import annotations

from typing import TYPE_CHECKING

from simfoundry.predicates.judging.thresholds import CLOSE, FRICTION_SHARE, SETTLED, SUPPORT_DEG, TOUCH
from simfoundry.spec.models.predicate import Effect, Predicate

if TYPE_CHECKING:
    from simfoundry.predicates.judging.bodies import Entity
    from simfoundry.predicates.judging.terms import Terms

STEEP_SCALE = 0.01
"""Margin [m] per unit of the support cosine: comparable to the other margins of objects at rest, a few millimeters."""


def on_top(terms: Terms, a: Entity, b: Entity) -> None:
    """Require that ``b`` touches ``a``, pushes it up and balances it, and that ``a`` is at rest and not held."""
    from functools import partial

    from simfoundry.predicates.judging import support

    terms.require_at_rest(a)
    contact = support.SupportContact(terms.context, a, b)
    terms.require_if_open(contact.gap, contact.margin, lambda v, ok: terms.gap_text(a, b, v))
    terms.require_if_open(
        contact.push,
        lambda v: STEEP_SCALE * (v - contact.least_cosine),
        lambda v, ok: "" if ok else support.push_text(a, b, v),
    )
    balance = partial(support.balance, terms.context, a, b)
    terms.require_if_open(balance, lambda v: v, lambda v, ok: support.balance_text(a, b, v))
    terms.require_not_held(a)


PREDICATE = Predicate(
    "OnTop",
    "the first rests on top of the second",
    ("thing", "thing"),
    on_top,
    f"`b` supports `a`: `b` is at most {TOUCH * 1000:g} mm from `a` and pushes it within {SUPPORT_DEG:g} deg of "
    f"straight up, with {FRICTION_SHARE:g} of the friction angle credited; the center of mass of `a` is over the "
    f"outline of `b`, or `a` also touches another object; if `b` is farther away than {CLOSE * 1000:g} mm, no object "
    f"closer than that supports `a`; `a` moves no faster than {SETTLED * 100:g} cm/s, and no robot holds it. An object "
    "in a bowl rests on the bowl, one on a hook rests on the hook, and one that leans on an edge rests on the edge",
    effect=Effect.PLACE,
    aliases=("ontop", "On", "OnTopAABB", "OnTopOf", "on_top"),
)
