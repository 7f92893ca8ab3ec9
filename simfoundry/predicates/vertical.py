"""``Above(a, b)`` and ``Under(a, b)``: the plumb line through the middle of ``a`` intersects ``b`` on one side only."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from simfoundry.spec.models.predicate import Effect, Predicate

if TYPE_CHECKING:
    from simfoundry.geometry.frames import Array
    from simfoundry.predicates.judging.bodies import Entity
    from simfoundry.predicates.judging.terms import Terms
    from simfoundry.predicates.judging.view import View


def _vertical(side: str, opposite: str, terms: Terms, a: Entity, b: Entity) -> None:
    """Require that ``b`` is on one ``side`` of the middle of ``a``, ``over`` or ``under``, and not on the other."""
    import numpy as np

    from simfoundry.predicates.judging.plumb import Meeting, meet
    from simfoundry.predicates.judging.view import over
    from simfoundry.scene.lengths import length

    beside = over(terms.view.boxes(a).middle, terms.view.boxes(b))
    terms.require(beside, beside, lambda v, ok: "" if ok else f"`{a.name}` is {length(-v)} beside `{b.name}`")
    met: list[Meeting] = []

    def wanted(view: View) -> Array:
        met.append(meet(view, a, b))
        return np.asarray(getattr(met[-1], side))

    def excluded(_: View) -> Array:
        first, second = (np.asarray(getattr(met[-1], one)) for one in (side, opposite))
        return np.asarray(second[first > 0])

    terms.require_if_open(
        wanted,
        lambda v: v,
        lambda v, ok: f"`{b.name}` is {'' if ok else 'not '}straight {side} the middle of `{a.name}`",
    )
    terms.require_if_open(excluded, lambda v: -v, lambda v, ok: "" if ok else f"`{b.name}` is also {opposite} it")


ABOVE = Predicate(
    "Above",
    "the first is above the second, touching or not",
    ("thing", "thing"),
    partial(_vertical, "under", "over"),
    "the plumb line through the middle of `a` intersects `b` below `a` and not above it; `a` may be held",
    effect=Effect.MOVE,
    aliases=("above", "AboveAABB"),
)
UNDER = Predicate(
    "Under",
    "the first is below the second",
    ("thing", "thing"),
    partial(_vertical, "over", "under"),
    "the plumb line through the middle of `a` intersects `b` above `a` and not below it; `a` may be held",
    effect=Effect.MOVE,
    aliases=("under",),
)
