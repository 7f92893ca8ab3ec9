"""``Touching(a, b)``: the surfaces of the two are in contact; either may be a robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from simfoundry.predicates.judging.thresholds import TOUCH
from simfoundry.spec.models.predicate import Effect, Predicate

if TYPE_CHECKING:
    from simfoundry.predicates.judging.bodies import Entity
    from simfoundry.predicates.judging.terms import Terms


def touching(terms: Terms, a: Entity, b: Entity) -> None:
    """Require that the distance is no more than :data:`TOUCH`."""
    gap = terms.context.distances.between(terms.view, a, b, TOUCH)
    terms.require(gap, TOUCH - gap, lambda v, ok: terms.gap_text(a, b, v))


PREDICATE = Predicate(
    "Touching",
    "the two touch",
    ("body", "body"),
    touching,
    f"their surfaces are at most {TOUCH * 1000:g} mm apart",
    effect=Effect.MOVE,
    aliases=("touching",),
)
