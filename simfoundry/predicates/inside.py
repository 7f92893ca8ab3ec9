"""``Inside(a, b)``: half of ``a`` is in the cavity of ``b``, which is not turned upside down."""

from __future__ import annotations

from typing import TYPE_CHECKING

from simfoundry.predicates.judging.thresholds import ENCLOSED, FACING_DOWN_DEG, SETTLED
from simfoundry.spec.models.predicate import Effect, Predicate

if TYPE_CHECKING:
    from simfoundry.predicates.judging.bodies import Entity
    from simfoundry.predicates.judging.terms import Terms


def inside(terms: Terms, a: Entity, b: Entity) -> None:
    """Require that half of ``a`` is in a suitable cavity of ``b``, that ``a`` is at rest and not held by a robot."""
    import numpy as np

    from simfoundry.predicates.judging.cavity_depth import enclosed_depth
    from simfoundry.predicates.judging.distances import FAR
    from simfoundry.scene.lengths import length

    depth = enclosed_depth(terms.view, a, b)
    share = f"{ENCLOSED:.0%} of `{a.name}`"

    def text(v: float, ok: bool) -> str:
        if not np.isfinite(v):
            return f"`{b.name}` is turned so that it cannot contain an object"
        where = "deep in the cavity" if ok else "outside of the cavity"
        return f"{share} is {'at least ' if ok else ''}{length(abs(v))} {where} of `{b.name}`"

    terms.require(depth, np.where(np.isfinite(depth), depth, -FAR), text)
    terms.require_at_rest(a)
    terms.require_not_held(a)


PREDICATE = Predicate(
    "Inside",
    "the first is in the cavity of the second",
    ("thing", "thing"),
    inside,
    f"at least {ENCLOSED:.0%} of the volume of `a` is in the cavity of `b`, whose opening points at most "
    f"{FACING_DOWN_DEG:g} deg away from up; `a` moves no faster than {SETTLED * 100:g} cm/s, and no robot holds it",
    effect=Effect.PLACE,
    aliases=("inside", "In", "InsideAABB"),
)
