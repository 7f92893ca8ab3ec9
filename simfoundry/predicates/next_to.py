"""``NextTo(a, b)``: side by side, at a distance that is small relative to their size."""

from __future__ import annotations

from typing import TYPE_CHECKING

from simfoundry.spec.models.predicate import Effect, Predicate

if TYPE_CHECKING:
    from simfoundry.geometry.frames import Array
    from simfoundry.predicates.judging.bodies import Entity
    from simfoundry.predicates.judging.terms import Terms
    from simfoundry.predicates.judging.view import View

NEAR_SHARE = 1 / 6
"""Largest gap along the ground as a share of the sum of the mean extents (OmniGibson's rule)."""


def next_to(terms: Terms, a: Entity, b: Entity) -> None:
    """Require overlapping heights, a gap that is small relative to the sizes, and that neither is above the other."""
    import numpy as np

    from simfoundry.predicates.judging.view import ground_gap, over
    from simfoundry.scene.lengths import length

    def spare_gap(view: View) -> Array:
        boxes = view.boxes(a), view.boxes(b)
        near = NEAR_SHARE * (boxes[0].size + boxes[1].size)
        apart = np.hypot(*(boxes[0].middle - boxes[1].middle)[:, :2].T) - boxes[0].reach - boxes[1].reach
        close = np.flatnonzero(apart < near)
        if len(close):
            apart[close] = ground_gap(view.at(close), a, b)
        return np.asarray(near - apart)

    def overlap(view: View) -> Array:
        one, other = view.boxes(a), view.boxes(b)
        return np.asarray(np.maximum(over(one.middle, other), over(other.middle, one)))

    def gap_text(v: float, ok: bool) -> str:
        nearer = "nearer to" if ok else "farther from"
        return f"`{a.name}` is {length(abs(v))} {nearer} `{b.name}` than side by side allows"

    (low_a, high_a), (low_b, high_b) = terms.view.heights(a), terms.view.heights(b)
    level = np.minimum(high_a, high_b) - np.maximum(low_a, low_b)
    terms.require(level, level, lambda v, ok: "" if ok else f"one is {length(-v)} higher than the other")
    terms.require_if_open(spare_gap, lambda v: v, gap_text)
    terms.require_if_open(overlap, lambda v: -v, lambda v, ok: "" if ok else f"one is over the other, by {length(v)}")


PREDICATE = Predicate(
    "NextTo",
    "the two stand side by side",
    ("thing", "thing"),
    next_to,
    "their horizontal gap is at most a sixth of the sum of their mean extents, their height ranges overlap, and "
    "neither is over the other",
    effect=Effect.MOVE,
    aliases=("nextto", "next_to"),
)
