"""What each predicate means: the terms that must hold, in the order in which they are measured."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from simfoundry.lint.report import length
from simfoundry.predicates.distance import FAR, Distances
from simfoundry.predicates.judging import thresholds as at
from simfoundry.predicates.judging.bodies import Bodies, PredicateError, Thing
from simfoundry.predicates.judging.cavity_depth import held_depth
from simfoundry.predicates.judging.fingers import Fingers, fingers, pressing, touching
from simfoundry.predicates.judging.terms import Terms
from simfoundry.predicates.judging.view import UP, View, over
from simfoundry.predicates.plumb import Meeting, centre_of_mass, meet
from simfoundry.scene.frames import Array, Pose
from simfoundry.spec.expressions import Call

STEEPEST = math.cos(math.radians(at.SUPPORT_DEG))
"""The cosine of :data:`~simfoundry.predicates.judging.thresholds.SUPPORT_DEG`."""


STEEP_SCALE = 0.01
"""What a cosine of 1 more or less counts as in a margin [m]: the middle of the margins of things that rest."""


class Context:
    """What is prepared once for a scene."""

    def __init__(self, bodies: Bodies) -> None:
        self.bodies = bodies
        self.distances = Distances(bodies)
        self._hands: dict[str, Fingers | None] = {}
        self._start: View | None = None

    def hand(self, robot: str) -> Fingers | None:
        """The fingers of a robot."""
        if robot not in self._hands:
            self._hands[robot] = fingers(self.bodies, robot)
        return self._hands[robot]

    @property
    def hands(self) -> list[tuple[str, Fingers]]:
        """The robots that have fingers."""
        return [(name, hand) for name in self.bodies.robots if (hand := self.hand(name)) is not None]

    @property
    def start(self) -> View:
        """The one state that the scene itself describes."""
        if self._start is None:
            from simfoundry.predicates.judging.states import StateBatch

            self._start = View(self.bodies, StateBatch(1, {}))
        return self._start


Rule = Callable[[Context, View, Call], Terms]


def on_top(context: Context, view: View, call: Call) -> Terms:
    """OnTop(a, b): ``b`` carries ``a``, also within it, alone or with others; nothing holds or moves ``a``."""
    a, b = _two(context, call)
    terms = Terms(view)
    _settled(terms, a)
    pushed: list[Array] = []

    def gap(some: View) -> Array:
        found, up = context.distances.support(some, a, b, at.TOUCH, STEEPEST)
        pushed.append(up[found < at.TOUCH])
        return found

    terms.must_also(gap, lambda v: at.TOUCH - v, lambda v, ok: _apart(a, b, v))
    terms.must_also(
        lambda _: pushed[-1], lambda v: STEEP_SCALE * (v - STEEPEST), lambda v, ok: "" if ok else _pushed(a, b, v)
    )
    terms.must_also(partial(_balance, context, a, b), lambda v: v, lambda v, ok: _balanced(a, b, v))
    _not_held(context, terms, a)
    return terms


def _balance(context: Context, a: Thing, b: Thing, view: View) -> Array:
    """How far the centre of mass of ``a`` is within the outline of ``b`` [m], (n,).

    Where it is beside, and another object holds ``a`` too, by how much that is nearer than what touches.
    """
    within = over(centre_of_mass(view, a), view.boxes(b))
    for name in context.bodies.objects:
        left = np.flatnonzero(within <= 0)
        if len(left) and name not in (a.owner, b.owner) and _has_shape(context, name):
            gap = context.distances.between(view.at(left), a, context.bodies.thing(name), at.TOUCH)
            within[left] = np.where(gap < at.TOUCH, at.TOUCH - gap, within[left])
    return within


def _balanced(a: Thing, b: Thing, value: float) -> str:
    if value > 0:
        return f"it carries `{a.name}`"
    return (
        f"`{a.name}` would fall: its centre of mass is {length(-value)} beside `{b.name}`, and nothing else touches it"
    )


def inside(context: Context, view: View, call: Call) -> Terms:
    """Inside(a, b): half of ``a`` is in the cavity of ``b``, which is not turned down; nothing holds or moves ``a``."""
    a, b = _two(context, call)
    terms = Terms(view)
    deep = held_depth(view, a, b)
    share = f"{at.ENCLOSED:.0%} of `{a.name}`"

    def words(v: float, ok: bool) -> str:
        if not np.isfinite(v):
            return f"`{b.name}` is turned so that it holds nothing"
        where = "deep in the cavity" if ok else "outside of the cavity"
        return f"{share} is {'at least ' if ok else ''}{length(abs(v))} {where} of `{b.name}`"

    terms.must(deep, np.where(np.isfinite(deep), deep, -FAR), words)
    _settled(terms, a)
    _not_held(context, terms, a)
    return terms


def above(context: Context, view: View, call: Call) -> Terms:
    """Above(a, b): the plumb line through the middle of ``a`` meets ``b`` under ``a``, and not over it."""
    a, b = _two(context, call)
    return _plumb(view, a, b, ("under", "over"))


def under(context: Context, view: View, call: Call) -> Terms:
    """Under(a, b): the plumb line through the middle of ``a`` meets ``b`` over ``a``, and not under it."""
    a, b = _two(context, call)
    return _plumb(view, a, b, ("over", "under"))


def _plumb(view: View, a: Thing, b: Thing, sides: tuple[str, str]) -> Terms:
    """``b`` is on the first side of the middle of ``a``, and not on the second."""
    terms = Terms(view)
    middle = view.boxes(a).middle
    beside = over(middle, view.boxes(b))
    terms.must(beside, beside, lambda v, ok: "" if ok else _over(a, b, v))
    met: list[Meeting] = []

    def wanted(some: View) -> Array:
        met.append(meet(some, a, b))
        return np.asarray(getattr(met[-1], sides[0]))

    def words(_: float, ok: bool) -> str:
        return f"`{b.name}` is {'' if ok else 'not '}straight {sides[0]} the middle of `{a.name}`"

    terms.must_also(wanted, lambda v: v, words)

    def other(_: View) -> Array:
        first, second = (np.asarray(getattr(met[-1], side)) for side in sides)
        return np.asarray(second[first > 0])

    terms.must_also(other, lambda v: -v, lambda v, ok: "" if ok else f"`{b.name}` is also {sides[1]} it")
    return terms


def _over_either(a: Thing, b: Thing, view: View) -> Array:
    boxes = view.boxes(a), view.boxes(b)
    return np.asarray(np.maximum(over(boxes[0].middle, boxes[1]), over(boxes[1].middle, boxes[0])))


def next_to(context: Context, view: View, call: Call) -> Terms:
    """NextTo(a, b): side by side, near for their size: heights overlap, neither is over the other."""
    a, b = _two(context, call)
    terms = Terms(view)
    (low_a, high_a), (low_b, high_b) = view.heights(a), view.heights(b)
    level = np.minimum(high_a, high_b) - np.maximum(low_a, low_b)
    terms.must(level, level, lambda v, ok: "" if ok else f"one is {length(-v)} higher than the other")

    def words(v: float, ok: bool) -> str:
        nearer = "nearer to" if ok else "farther from"
        return f"`{a.name}` is {length(abs(v))} {nearer} `{b.name}` than side by side allows"

    terms.must_also(partial(_spare, a, b), lambda v: v, words)
    terms.must_also(
        partial(_over_either, a, b), lambda v: -v, lambda v, ok: "" if ok else f"one is over the other, by {length(v)}"
    )
    return terms


def _spare(a: Thing, b: Thing, view: View) -> Array:
    """How much farther apart two things could be and still be side by side [m], (n,)."""
    boxes = view.boxes(a), view.boxes(b)
    near = at.NEAR_SHARE * (boxes[0].size + boxes[1].size)
    apart = np.hypot(*(boxes[0].middle - boxes[1].middle)[:, :2].T) - boxes[0].reach - boxes[1].reach
    close = np.flatnonzero(apart < near)
    if len(close):
        apart[close] = ground_gap(view.at(close), a, b)
    return np.asarray(near - apart)


def ground_gap(view: View, a: Thing, b: Thing) -> Array:
    """How far two things are apart along the ground [m], (n,), negative where they overlap.

    The widest gap across the edges of their boxes and along the line between their middles.
    """
    boxes = view.boxes(a), view.boxes(b)
    ways = [(boxes[0].middle - boxes[1].middle)[:, :2]]
    ways += [np.stack([-box.R[0, :, 1, k], box.R[0, :, 0, k]], axis=1) for box in boxes for k in range(3)]
    gap = np.full(view.n, -np.inf)
    for way in ways:
        size = np.linalg.norm(way, axis=1)
        lying = size > 1e-6
        axis = np.zeros((view.n, 3))
        axis[:, :2] = way / np.where(lying, size, 1.0)[:, None]
        (low_a, high_a), (low_b, high_b) = view.span(a, axis), view.span(b, axis)
        gap = np.maximum(gap, np.where(lying, np.maximum(low_a - high_b, low_b - high_a), -np.inf))
    return gap


def touching_(context: Context, view: View, call: Call) -> Terms:
    """Touching(a, b): the surfaces of the two meet; either may be a robot."""
    a, b = _two(context, call)
    terms = Terms(view)
    gap = context.distances.between(view, a, b, at.TOUCH)
    terms.must(gap, at.TOUCH - gap, lambda v, ok: _apart(a, b, v))
    return terms


_SIDES = {
    "LeftOf": (1, 1.0, "left of"),
    "RightOf": (1, -1.0, "right of"),
    "Behind": (0, 1.0, "behind"),
    "InFrontOf": (0, -1.0, "in front of"),
}
"""The axis of the viewer's frame (0 away, 1 left), the sign along it, and the words."""


def on_side(context: Context, view: View, call: Call) -> Terms:
    """LeftOf, RightOf, InFrontOf, Behind: seen from the viewpoint, the middle of each is beyond the other's edge."""
    a, b = _two(context, call)
    column, sign, word = _SIDES[call.predicate]
    axis = sign * seen_along(context.bodies.scene.viewer, column)
    (low_a, high_a), (low_b, high_b) = view.span(a, axis), view.span(b, axis)
    off = (low_a + high_a - low_b - high_b) / 2
    half = np.maximum(high_a - low_a, high_b - low_b) / 2
    terms = Terms(view)

    def words(v: float, ok: bool) -> str:
        if ok:
            return f"`{a.name}` is {word} `{b.name}`: each middle is {length(v)} or more beyond the other's edge"
        return f"`{a.name}` is not {word} `{b.name}`: their middles are {length(-v)} short of being side by side"

    terms.must(off - half, off - half, words)
    return terms


def seen_along(viewer: Pose | None, column: int) -> Array:
    """The level unit vector away from the viewer (0) or to its left (1), shape (3,)."""
    x, y, _ = UP if viewer is None else viewer.rotation[:, 0]
    size = float(np.hypot(x, y))
    away = np.array([1.0, 0.0, 0.0]) if size < 1e-6 else np.array([x, y, 0.0]) / size
    return away if column == 0 else np.cross(UP, away)


def at_point(context: Context, view: View, call: Call) -> Terms:
    """At(a, x, y[, z]): the frame of ``a`` is at that point of the world."""
    a = context.bodies.thing(call.args[0])
    wanted = np.array([float(v) for v in call.args[1:]])
    off = np.linalg.norm(view.frame(a).p[:, : len(wanted)] - wanted, axis=1)
    terms = Terms(view)
    terms.must(off, at.AT - off, lambda v, ok: f"`{a.name}` is {length(v)} from there")
    return terms


def upright(context: Context, view: View, call: Call) -> Terms:
    """Upright(a): the z axis of ``a`` points up."""
    a = context.bodies.thing(call.args[0])
    z = view.frame(a).R[:, :, 2]
    lean = np.degrees(np.arctan2(np.hypot(z[:, 0], z[:, 1]), z[:, 2]))
    terms = Terms(view)
    terms.must(lean, at.UPRIGHT_DEG - lean, lambda v, ok: f"`{a.name}` leans by {v:.1f} deg")
    return terms


def is_open(context: Context, view: View, call: Call) -> Terms:
    """Open(joint), Closed(joint): by the share of its range; of an object, every joint that has limits."""
    owner = call.args[0].partition(".")[0]
    terms = Terms(view)
    for joint in context.bodies.joints(call.args[0]):
        assert joint.limits is not None
        reach = joint.limits[1] - joint.limits[0]
        share = np.abs(view.position(owner, joint) - joint.closed_position) / reach
        spare = (share - at.OPEN_SHARE) * reach
        if call.predicate == "Closed":
            spare = np.where(spare == 0, np.nextafter(0.0, 1.0), -spare)  # at the threshold itself it is still closed
        name = f"{owner}.{joint.name}"
        terms.must(share, spare, lambda v, ok, name=name: f"`{name}` is open by {v:.1%} of its range")  # type: ignore[misc]
    return terms


def lifted(context: Context, view: View, call: Call) -> Terms:
    """Lifted(a): higher than the scene describes it, and touching nothing but robots and what it carries."""
    a = context.bodies.thing(call.args[0])
    terms = Terms(view)
    rise = view.heights(a)[0] - context.start.heights(a)[0]

    def words(v: float, _: bool) -> str:
        return f"`{a.name}` is {length(abs(v))} {'higher' if v >= 0 else 'lower'} than at the start"

    terms.must(rise, rise - at.RISE, words)
    others = [context.bodies.thing(n) for n in context.bodies.objects if n != a.owner and _has_shape(context, n)]

    def gap(some: View) -> Array:
        gaps = {b.name: context.distances.between(some, a, b, at.TOUCH) for b in others}
        load = _load(context, some, a, {b.name: b for b in others}, gaps)
        found = [np.where(load[name], np.inf, gap) for name, gap in gaps.items()]
        return np.asarray(np.min([*found, np.full(some.n, np.inf)], axis=0))

    terms.must_also(
        gap, lambda v: v - at.TOUCH, lambda v, ok: f"`{a.name}` touches " + ("nothing else" if ok else "another thing")
    )
    return terms


def _load(
    context: Context, view: View, a: Thing, others: dict[str, Thing], gaps: dict[str, Array]
) -> dict[str, NDArray[np.bool_]]:
    """Which of the others ``a`` carries, (n,) each: they rest on it, or on what it carries.

    Asked only in states in which something touches ``a``, ``gaps`` [m] being how far they are from it.
    """
    load = {name: np.zeros(view.n, bool) for name in others}
    touched = {name: gap <= at.TOUCH for name, gap in gaps.items()}
    asked = np.flatnonzero(np.any(list(touched.values()), axis=0)) if others else np.zeros(0, np.int64)
    if not len(asked):
        return load
    some = view.at(asked)
    carried = {name: np.zeros(some.n, bool) for name in others}
    for name, b in others.items():
        met = np.flatnonzero(touched[name][asked])
        if len(met):
            carried[name][met] = _rests(context, some.at(met), b, a)
    news = [name for name, found in carried.items() if found.any()]
    while news:
        below = news.pop()
        for name, b in others.items():
            left = np.flatnonzero(carried[below] & ~carried[name])
            if name != below and len(left):
                found = left[_rests(context, some.at(left), b, others[below])]
                carried[name][found] = True
                news += [name] if len(found) else []
    for name, values in carried.items():
        load[name][asked] = values
    return load


def _rests(context: Context, view: View, a: Thing, b: Thing) -> NDArray[np.bool_]:
    """Whether ``b`` touches ``a`` and pushes it up, (n,)."""
    gap, up = context.distances.support(view, a, b, at.TOUCH, STEEPEST)
    return np.asarray((gap <= at.TOUCH) & (up >= STEEPEST))


def grasped(context: Context, view: View, call: Call) -> Terms:
    """Grasped(a[, robot]): touched by the fingers of one gripper on both sides, which press against each other."""
    a = context.bodies.thing(call.args[0])
    if len(call.args) > 1:
        robot = context.bodies.thing(call.args[1]).owner
        hands = [(robot, hand)] if robot in context.bodies.robots and (hand := context.hand(robot)) else []
        if not hands:
            raise PredicateError(f"`{call.args[1]}` is no robot with a gripper")
    else:
        hands = context.hands
    held = held_by(context, view, a, hands)
    terms = Terms(view)
    terms.must(held, held, lambda v, ok: f"`{a.name}` is held" if ok else f"`{a.name}` is not held")
    return terms


def held_by(context: Context, view: View, a: Thing, hands: list[tuple[str, Fingers]]) -> Array:
    """The margin by which one of the hands holds a thing [m], (n,), at least -:data:`FAR`."""
    best = np.full(view.n, -FAR)
    for _, hand in hands:
        terms = Terms(view)
        gap = touching(view, context.distances, hand, a)
        terms.must(gap, at.TOUCH - gap, lambda v, ok: "")
        terms.must_also(
            lambda some, hand=hand: pressing(some, context.distances, hand, a),  # type: ignore[misc]
            lambda v: v - at.PRESS / 2,
            lambda v, ok: "",
        )
        best = np.maximum(best, terms.margin)
    return best


def released(context: Context, view: View, call: Call) -> Terms:
    """Released(a): no robot touches it, and it is at rest."""
    a = context.bodies.thing(call.args[0])
    terms = Terms(view)
    _settled(terms, a)
    for name in context.bodies.robots:
        robot = context.bodies.thing(name)
        gap = partial(_distance, context, a, robot, at.TOUCH)
        terms.must_also(gap, lambda v: v - at.TOUCH, lambda v, ok, robot=robot: _apart(a, robot, v))  # type: ignore[misc]
    return terms


RULES: dict[str, Rule] = {
    "OnTop": on_top,
    "Inside": inside,
    "Under": under,
    "Above": above,
    "NextTo": next_to,
    "Touching": touching_,
    **dict.fromkeys(_SIDES, on_side),
    "At": at_point,
    **dict.fromkeys(("Open", "Closed"), is_open),
    "Upright": upright,
    "Lifted": lifted,
    "Grasped": grasped,
    "Released": released,
}


# -- parts of several ------------------------------------------------------------------------------------------------


def _two(context: Context, call: Call) -> tuple[Thing, Thing]:
    a, b = (context.bodies.thing(arg) for arg in call.args[:2])
    if a.owner == b.owner and set(a.links) & set(b.links):
        raise PredicateError(f"`{call}` is about one thing twice")
    return a, b


def _has_shape(context: Context, name: str) -> bool:
    return any(context.bodies[name].forms)


def _distance(context: Context, a: Thing, b: Thing, threshold: float, view: View) -> Array:
    return context.distances.between(view, a, b, threshold)


def _settled(terms: Terms, a: Thing) -> None:
    speed = terms.view.batch.speeds.get(a.owner, np.zeros(terms.view.n))
    words = f"`{a.name}` moves at {{:.1f}} cm/s"
    terms.must(speed, at.SETTLED - speed, lambda v, ok: "" if ok else words.format(100 * v))


def _not_held(context: Context, terms: Terms, a: Thing) -> None:
    if context.bodies.robots:
        held = partial(_held, context, a)
        terms.must_also(held, lambda v: -v, lambda v, ok: "" if ok else f"a robot holds `{a.name}`")


def _held(context: Context, a: Thing, view: View) -> Array:
    return held_by(context, view, a, context.hands)


def _over(a: Thing, b: Thing, value: float) -> str:
    if value > 0:
        return f"`{a.name}` is over `{b.name}`, {length(value)} within its outline"
    return f"`{a.name}` is {length(-value)} beside `{b.name}`"


def _pushed(a: Thing, b: Thing, cosine: float) -> str:
    """What is wrong with how a thing is pushed by another that is near."""
    if cosine < 0:
        return f"`{b.name}` is over `{a.name}`, not under it"
    off = np.degrees(np.arccos(min(cosine, 1.0)))
    return f"`{b.name}` pushes `{a.name}` to the side, {off:.0f} deg off straight up"


def _apart(a: Thing, b: Thing, value: float) -> str:
    if not np.isfinite(value):
        return f"`{a.name}` and `{b.name}` touch nothing"
    return f"`{a.name}` is {length(value)} away from `{b.name}`" if value > 0 else f"`{a.name}` touches `{b.name}`"
