"""``Lifted(a)``: ``a`` is above its initial height and touches only robots and objects that it supports."""

from __future__ import annotations

from typing import TYPE_CHECKING

from simfoundry.predicates.judging.thresholds import TOUCH
from simfoundry.spec.models.predicate import Effect, Predicate

if TYPE_CHECKING:
    from simfoundry.predicates.judging.bodies import Entity
    from simfoundry.predicates.judging.terms import Terms

RISE = 0.02
"""Least rise [m] above the initial height: well above that of a pushed or tilted object, below that of a short lift."""


def lifted(terms: Terms, a: Entity) -> None:
    """Require that ``a`` is higher than at the start and touches no object except those that it supports."""
    from functools import partial

    from simfoundry.predicates.judging.support import gap_to_others
    from simfoundry.scene.lengths import length

    rise = terms.view.heights(a)[0] - terms.context.start.heights(a)[0]

    def text(v: float, _: bool) -> str:
        return f"`{a.name}` is {length(abs(v))} {'higher' if v >= 0 else 'lower'} than at the start"

    terms.require(rise, rise - RISE, text)
    terms.require_if_open(
        partial(gap_to_others, terms.context, a),
        lambda v: v - TOUCH,
        lambda v, ok: f"`{a.name}` touches " + ("no other object" if ok else "another object"),
    )


PREDICATE = Predicate(
    "Lifted",
    "it is lifted off its support",
    ("thing",),
    lifted,
    f"the lowest point of `a` is at least {RISE * 100:g} cm higher than in the scene, and no object is within "
    f"{TOUCH * 1000:g} mm of it except those that it supports",
    effect=Effect.GRASP,
    aliases=("lifted", "Up"),
    before_motion=False,
)
