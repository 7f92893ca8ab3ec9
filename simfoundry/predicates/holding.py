"""The predicates ``Grasped``, ``Lifted`` and ``Released``, which relate an object to the robots that may hold it."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from simfoundry.predicates.judging.thresholds import PRESS, SETTLED, TOUCH
from simfoundry.scene.lengths import length
from simfoundry.spec.models.predicate import Effect, Predicate

if TYPE_CHECKING:
    from simfoundry.predicates.judging.bodies import Entity
    from simfoundry.predicates.judging.judge import Terms


def grasped(terms: Terms, a: Entity, robot: Entity | None = None) -> None:
    """Require that the fingers of one gripper touch ``a`` on both sides and press against it."""
    from simfoundry.predicates.judging.bodies import PredicateError
    from simfoundry.predicates.judging.fingers import grip_margin

    hands = terms.context.hands
    if robot is not None:
        hands = {robot.owner: hands[robot.owner]} if robot.owner in hands else {}
        if not hands:
            raise PredicateError(f"`{robot.name}` is not a robot with a gripper")
    held = grip_margin(terms.view, terms.context.distances, hands.values(), a)
    terms.require(held, held, lambda v, ok: f"`{a.name}` is held" if ok else f"`{a.name}` is not held")


GRASPED = Predicate(
    "Grasped",
    "the object is held by the given robot, or by any robot",
    ("thing", "robot"),
    grasped,
    f"both sides of one gripper are at most {TOUCH * 1000:g} mm from `a`, and moving either side {PRESS * 1000:g} mm "
    f"toward the other reduces its distance to `a`, or deepens its overlap with `a`, by at least {PRESS * 500:g} mm",
    optional=1,
    effect=Effect.GRASP,
    aliases=("grasped", "IsGrasping"),
    robot_first=("grasped", "IsGrasping"),
    before_motion=False,
    contact=True,
)


# Minimum rise [m] above the initial height, which is well above the rise of a pushed or tilted object and below that of
# a short lift.
RISE = 0.02


def lifted(terms: Terms, a: Entity) -> None:
    """Require that ``a`` is higher than in the initial state, and touches no objects except those that it supports."""
    from simfoundry.predicates.judging.measurements import gap_to_others

    rise = terms.view.heights(a)[0] - terms.context.start.heights(a)[0]

    def text(v: float, _: bool) -> str:
        return f"`{a.name}` is {length(abs(v))} {'higher' if v >= 0 else 'lower'} than initially"

    terms.require(rise, rise - RISE, text)
    terms.require_if_open(
        partial(gap_to_others, terms.context, a),
        lambda v: v - TOUCH,
        lambda v, ok: f"`{a.name}` touches " + ("no other object" if ok else "another object"),
    )


LIFTED = Predicate(
    "Lifted",
    "the object is lifted off its support",
    ("thing",),
    lifted,
    f"the lowest point of `a` is at least {RISE * 100:g} cm higher than in the initial state, and no object is within "
    f"{TOUCH * 1000:g} mm of `a` except objects that `a` supports",
    effect=Effect.GRASP,
    aliases=("lifted", "Up"),
    before_motion=False,
)


def released(terms: Terms, a: Entity) -> None:
    """Require that ``a`` is at rest, and that its distance from every robot is greater than :data:`TOUCH`."""
    terms.require_at_rest(a)
    for name in terms.context.bodies.robots:
        robot = terms.context.bodies.thing(name)
        terms.require_if_open(
            lambda view, robot=robot: terms.context.distances.between(view, a, robot, TOUCH),  # type: ignore[misc]
            lambda v: v - TOUCH,
            lambda v, ok, robot=robot: terms.gap_text(a, robot, v),  # type: ignore[misc]
        )


RELEASED = Predicate(
    "Released",
    "the object is at rest, and no robot touches it",
    ("thing",),
    released,
    f"no robot is within {TOUCH * 1000:g} mm of `a`, and `a` moves no faster than {SETTLED * 100:g} cm/s",
    before_motion=True,
)
