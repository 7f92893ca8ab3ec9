"""Words for where a thing is to an anchor: which can hold at once, and which way they mean."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations

from simfoundry.geometry.frames import Array, Pose
from simfoundry.predicates.sides import viewer_axis

SIDES = {
    "LeftOf": "left of",
    "RightOf": "right of",
    "InFrontOf": "in front of",
    "Behind": "behind",
    "NextTo": "next to",
}
"""Predicates of things that stand on one support, in words."""

DROPPED = {"OnTop": "on", "Inside": "inside"}
"""Predicates of what the anchor carries."""

AGAINST = ({"LeftOf", "RightOf"}, {"InFrontOf", "Behind"})

_WAYS = {"LeftOf": (1, 1.0), "RightOf": (1, -1.0), "Behind": (0, 1.0), "InFrontOf": (0, -1.0)}


def sets_of(allowed: Sequence[str], together: int) -> tuple[tuple[str, ...], ...]:
    """The sets of predicates that can hold at once, of the largest size up to ``together``, so that each is in one.

    A predicate that fits in none of that size comes in its largest.
    """
    words = tuple(dict.fromkeys(allowed))
    found: list[tuple[str, ...]] = []
    for size in range(min(together, len(words)), 0, -1):
        covered = {word for some in found for word in some}
        for some in combinations(words, size):
            if compatible(some) and (not found or len(found[0]) == size or not set(some) <= covered):
                found.append(some)
    return tuple(found)


def compatible(words: Iterable[str]) -> bool:
    """Whether predicates of the same two things can hold at once."""
    some = set(words)
    if any(pair <= some for pair in AGAINST):
        return False
    return not (some & set(SIDES) and some & set(DROPPED))


def side_axis(viewer: Pose | None, word: str) -> Array | None:
    """The level unit vector, shape (3,), that a side means; None for a word that means none."""
    if word not in _WAYS:
        return None
    column, sign = _WAYS[word]
    return sign * viewer_axis(viewer, column)
