"""``Grasped(a[, robot])``: held between the fingers of one gripper."""

from __future__ import annotations

from typing import TYPE_CHECKING

from simfoundry.predicates.judging.thresholds import PRESS, TOUCH
from simfoundry.spec.models.predicate import Effect, Predicate

if TYPE_CHECKING:
    from simfoundry.predicates.judging.bodies import Entity
    from simfoundry.predicates.judging.terms import Terms


def grasped(terms: Terms, a: Entity, robot: Entity | None = None) -> None:
    """Require that the fingers of one gripper touch ``a`` on both sides and press against each other."""
    from simfoundry.predicates.judging.bodies import PredicateError
    from simfoundry.predicates.judging.fingers import grip_margin

    hands = terms.context.hands
    if robot is not None:
        hands = {robot.owner: hands[robot.owner]} if robot.owner in hands else {}
        if not hands:
            raise PredicateError(f"`{robot.name}` is not a robot with a gripper")
    held = grip_margin(terms.view, terms.context.distances, hands.values(), a)
    terms.require(held, held, lambda v, ok: f"`{a.name}` is held" if ok else f"`{a.name}` is not held")


PREDICATE = Predicate(
    "Grasped",
    "it is held, by the named robot or by any",
    ("thing", "robot"),
    grasped,
    f"both sides of one gripper are at most {TOUCH * 1000:g} mm from `a`, and moving either side {PRESS * 1000:g} mm "
    f"toward the other reduces its distance to `a`, or increases its penetration, by at least {PRESS * 500:g} mm",
    optional=1,
    effect=Effect.GRASP,
    aliases=("grasped", "IsGrasping"),
    robot_first=("grasped", "IsGrasping"),
    before_motion=False,
)
