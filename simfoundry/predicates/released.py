"""``Released(a)``: no robot touches ``a``, and it is at rest."""

from __future__ import annotations

from typing import TYPE_CHECKING

from simfoundry.predicates.judging.thresholds import SETTLED, TOUCH
from simfoundry.spec.models.predicate import Predicate

if TYPE_CHECKING:
    from simfoundry.predicates.judging.bodies import Entity
    from simfoundry.predicates.judging.terms import Terms


def released(terms: Terms, a: Entity) -> None:
    """Require that ``a`` is at rest and farther than :data:`TOUCH` from every robot."""
    terms.require_at_rest(a)
    for name in terms.context.bodies.robots:
        robot = terms.context.bodies.thing(name)
        terms.require_if_open(
            lambda view, robot=robot: terms.context.distances.between(view, a, robot, TOUCH),  # type: ignore[misc]
            lambda v: v - TOUCH,
            lambda v, ok, robot=robot: terms.gap_text(a, robot, v),  # type: ignore[misc]
        )


PREDICATE = Predicate(
    "Released",
    "no robot touches it and it is at rest",
    ("thing",),
    released,
    f"no robot is within {TOUCH * 1000:g} mm of `a`, and `a` moves no faster than {SETTLED * 100:g} cm/s",
    before_motion=True,
)
