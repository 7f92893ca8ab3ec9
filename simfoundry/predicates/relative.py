"""The predicates for relative positions.

These are ``LeftOf``, ``RightOf``, ``InFrontOf``, ``Behind``, ``NextTo``, ``Above`` and ``Under``.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from simfoundry.scene.lengths import length
from simfoundry.spec.models.predicate import Effect, Predicate

if TYPE_CHECKING:
    from simfoundry.geometry.frames import Array, Pose
    from simfoundry.predicates.judging.bodies import Entity
    from simfoundry.predicates.judging.judge import Terms
    from simfoundry.predicates.judging.view import View

# The axis of the viewer's frame (0 points away, 1 points left) and the direction along it.
AXES = {"LeftOf": (1, 1.0), "RightOf": (1, -1.0), "Behind": (0, 1.0), "InFrontOf": (0, -1.0)}


def viewer_axis(viewer: Pose | None, column: int) -> Array:
    """Return one of the two horizontal unit vectors that a viewer defines.

    Args:
        viewer: The frame of the viewer, or None for the world frame.
        column: 0 for the vector that points away from the viewer, or 1 for the vector to the viewer's left.

    Returns:
        The unit vector, shape (3,).
    """
    import numpy as np

    x, y = (1.0, 0.0) if viewer is None else viewer.rotation[:2, 0]
    size = float(np.hypot(x, y))
    away = np.array([1.0, 0.0, 0.0]) if size < LEVEL else np.array([x, y, 0.0]) / size
    return away if column == 0 else np.array([-away[1], away[0], 0.0])


# Length of the horizontal component of the unit viewing direction below which the viewer looks straight up or down.
LEVEL = 1e-6


def _beside(name: str, words: str, terms: Terms, a: Entity, b: Entity) -> None:
    """Require that the middle of each object is beyond the edge of the other object along the axis of ``name``."""
    import numpy as np

    column, sign = AXES[name]
    axis = sign * viewer_axis(terms.context.bodies.scene.viewer, column)
    (low_a, high_a), (low_b, high_b) = terms.view.span(a, axis), terms.view.span(b, axis)
    off = (low_a + high_a - low_b - high_b) / 2
    half = np.maximum(high_a - low_a, high_b - low_b) / 2

    def text(v: float, ok: bool) -> str:
        if ok:
            return f"`{a.name}` is {words} `{b.name}`: each middle is at least {length(v)} beyond the other's edge"
        return f"`{a.name}` is not {words} `{b.name}`: it would have to be {length(-v)} farther in that direction"

    terms.require(off - half, off - half, text)


def _side(name: str, alias: str, meaning: str) -> Predicate:
    return Predicate(
        name,
        meaning,
        ("thing", "thing"),
        partial(_beside, name, alias.replace("_", " ")),
        "as seen from the viewpoint, the middle of `a` is farther in the predicate's direction than every point of "
        "`b`, and every point of `a` is farther in that direction than the middle of `b`",
        effect=Effect.MOVE,
        aliases=(alias,),
    )


LEFT_OF = _side("LeftOf", "left_of", "the first object is to the left of the second, as seen from the viewpoint")
RIGHT_OF = _side("RightOf", "right_of", "the first object is to the right of the second, as seen from the viewpoint")
IN_FRONT_OF = _side("InFrontOf", "in_front_of", "the first object is closer to the viewpoint than the second")
BEHIND = _side("Behind", "behind", "the first object is farther from the viewpoint than the second")


# Maximum horizontal gap as a fraction of the sum of the mean extents (as in OmniGibson).
NEAR_SHARE = 1 / 6


def next_to(terms: Terms, a: Entity, b: Entity) -> None:
    """Require that the objects' height ranges overlap, that the gap is small, and that neither is above the other."""
    import numpy as np

    from simfoundry.predicates.judging.view import ground_gap, over

    def spare_gap(view: View) -> Array:
        boxes = view.boxes(a), view.boxes(b)
        near = NEAR_SHARE * (boxes[0].size + boxes[1].size)
        apart = np.hypot(*(boxes[0].middle - boxes[1].middle)[:, :2].T) - boxes[0].reach - boxes[1].reach
        close = np.flatnonzero(apart < near)
        if len(close):
            apart[close] = ground_gap(view if len(close) == view.n else view.at(close), a, b)
        return np.asarray(near - apart)

    def overlap(view: View) -> Array:
        one, other = view.boxes(a), view.boxes(b)
        return np.asarray(np.maximum(over(one.middle, other), over(other.middle, one)))

    def gap_text(v: float, ok: bool) -> str:
        nearer = "closer to" if ok else "farther from"
        return f"`{a.name}` is {length(abs(v))} {nearer} `{b.name}` than the limit"

    (low_a, high_a), (low_b, high_b) = terms.view.heights(a), terms.view.heights(b)
    level = np.minimum(high_a, high_b) - np.maximum(low_a, low_b)
    terms.require(level, level, lambda v, ok: "" if ok else f"one object is {length(-v)} above the other")
    terms.require_if_open(spare_gap, lambda v: v, gap_text)
    terms.require_if_open(
        overlap, lambda v: -v, lambda v, ok: "" if ok else f"one object is over the other by {length(v)}"
    )


NEXT_TO = Predicate(
    "NextTo",
    "the two objects are side by side",
    ("thing", "thing"),
    next_to,
    "the horizontal gap between `a` and `b` is at most a sixth of the sum of their mean extents, their height ranges "
    "overlap, and neither is over the other",
    effect=Effect.MOVE,
    aliases=("nextto", "next_to"),
)


def _vertical(side: str, opposite: str, terms: Terms, a: Entity, b: Entity) -> None:
    """Require that ``b`` is above or below the middle of ``a``, depending on ``side``, but not both.

    ``side`` is ``over`` or ``under``.
    """
    import numpy as np

    from simfoundry.predicates.judging.measurements import Meeting, meet
    from simfoundry.predicates.judging.view import over

    beside = over(terms.view.aabb_middle(a), terms.view.boxes(b))
    terms.require(beside, beside, lambda v, ok: "" if ok else f"`{a.name}` is {length(-v)} to the side of `{b.name}`")
    met: list[Meeting] = []

    def wanted(view: View) -> Array:
        met.append(meet(view, a, b))
        return np.asarray(getattr(met[-1], side))

    def excluded(_: View) -> Array:
        first, second = (np.asarray(getattr(met[-1], one)) for one in (side, opposite))
        return np.asarray(second[first > 0])

    def text(_: float, ok: bool) -> str:
        return f"`{b.name}` is {'' if ok else 'not '}directly {side} the middle of `{a.name}`"

    terms.require_if_open(wanted, lambda v: v, text)
    terms.require_if_open(excluded, lambda v: -v, lambda v, ok: "" if ok else f"`{b.name}` is also {opposite} it")


ABOVE = Predicate(
    "Above",
    "the first object is above the second, whether or not they touch",
    ("thing", "thing"),
    partial(_vertical, "under", "over"),
    "the plumb line through the middle of `a` intersects `b` below `a` and not above it; `a` may be held",
    effect=Effect.MOVE,
    aliases=("above", "AboveAABB"),
)
UNDER = Predicate(
    "Under",
    "the first object is below the second",
    ("thing", "thing"),
    partial(_vertical, "over", "under"),
    "the plumb line through the middle of `a` intersects `b` above `a` and not below it; `a` may be held",
    effect=Effect.MOVE,
    aliases=("under",),
)
