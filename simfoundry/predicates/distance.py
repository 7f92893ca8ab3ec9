"""How far things are apart in many states: bounds for all of them, the exact distance where bounds do not tell."""

from __future__ import annotations

import math
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simfoundry.predicates.boxfield import BoxField, box_field
from simfoundry.predicates.exact import LIFT, Candidates, Exact
from simfoundry.predicates.judging.bodies import Bodies, Form, Thing
from simfoundry.predicates.judging.states import Index, Poses, rotate
from simfoundry.predicates.judging.thresholds import TOUCH
from simfoundry.predicates.judging.view import UP, View
from simfoundry.scene.frames import Array

FAR = 0.05
"""Distances beyond this [m] are bounds: no farther than the truth."""

FEW = 16
"""Of so many states the distance is always measured."""

FLATTEST = math.cos(math.radians(80.0))
"""A wall that pushes up by less than this cosine does not help to hold a thing."""


class Distances:
    """Distances between the bodies of one scene."""

    def __init__(self, bodies: Bodies) -> None:
        self._bodies = bodies

    @cached_property
    def _exact(self) -> Exact:
        return Exact(self._bodies)

    def between(self, view: View, a: Thing, b: Thing, threshold: float | None = None) -> Array:
        """Signed distance [m] between two things, (n,), negative where they overlap; inf where one touches nothing.

        Exact below :data:`FAR`; beyond, no less than that and no more than the truth. Of more than :data:`FEW` states
        with a ``threshold`` [m] only the side of it is exact: below it, the distance is no more than what is returned;
        above it, no less.
        """
        limit = threshold if threshold is not None and view.n > FEW else None
        out = np.full(view.n, np.inf)
        for i, one in view.forms(a):
            for j, other in view.forms(b):
                if not (one.solid and other.solid) or (a.owner == b.owner and i == j):
                    continue
                X_WA, X_WB = view.link(a.owner, i), view.link(b.owner, j)
                lower = middles_apart(X_WA, one, X_WB, other)
                some = np.flatnonzero(lower < np.minimum(out, FAR))
                if len(some):
                    lower[some] = np.maximum(lower[some], ball_bound(X_WA.at(some), one, X_WB.at(some), other))
                cut = FAR if limit is None else float(np.nextafter(limit, np.inf))
                close = np.flatnonzero((lower < np.minimum(out, cut)) & (out > (-np.inf if limit is None else limit)))
                out = np.where(out > cut, np.minimum(out, np.maximum(lower, cut)), out)
                if len(close):
                    pair = _Pair((a.owner, i), (b.owner, j), one, other, X_WA.at(close), X_WB.at(close))
                    found = self._measured(pair, out[close]) if limit is None else self._decided(pair, limit)
                    out[close] = np.minimum(out[close], found)
        return out

    def support(self, view: View, a: Thing, b: Thing, limit: float, steepest: float) -> tuple[Array, Array]:
        """How far ``a`` is from ``b`` [m], and how much of the way up leads away from it, (n,) each.

        The second is the greatest cosine between up and the way from a part of ``b`` no farther than ``limit`` [m] to a
        part of ``a``; -1 where none is so near. Where several parts push together, as the walls of a funnel do, it is
        that of the steepest way in which they can. Of more than :data:`FEW` states only the sides of ``limit`` and of
        ``steepest`` are exact.
        """
        many = view.n > FEW
        gap = np.full(view.n, np.inf) if many else self.between(view, a, b)
        cosine = np.full(view.n, -1.0)
        pushes: list[tuple[Index, Array, Array]] = []
        for i, one in view.forms(a):
            for j, other in view.forms(b):
                if not (one.solid and other.solid) or (a.owner == b.owner and i == j):
                    continue
                X_WA, X_WB = view.link(a.owner, i), view.link(b.owner, j)
                close = np.flatnonzero((cosine < steepest) & (middles_apart(X_WA, one, X_WB, other) <= limit))
                close = close[ball_bound(X_WA.at(close), one, X_WB.at(close), other) <= limit]
                if not len(close):
                    continue
                pair = _Pair((a.owner, i), (b.owner, j), one, other, X_WA.at(close), X_WB.at(close))
                apart, up, open_ = _box_support(pair, limit, steepest)
                if not many:
                    open_ = np.arange(len(close))
                if len(open_):
                    some = pair.at(open_)
                    most = np.full(len(open_), np.nextafter(limit, np.inf))
                    state, near, way = self._exact.pushes(
                        some.a,
                        some.b,
                        some.X_WA,
                        some.X_WB,
                        candidates(some, most),
                        limit,
                        steepest if many else np.inf,
                    )
                    apart[open_], up[open_] = np.inf, -1.0
                    np.minimum.at(apart, open_[state], near)
                    np.maximum.at(up, open_[state], way[:, 2])
                    pushes.append((close[open_][state], near, way))
                gap[close] = np.minimum(gap[close], apart)
                cosine[close] = np.maximum(cosine[close], up)
        left = np.flatnonzero((cosine < steepest) & (gap <= limit))
        if len(left) and pushes:
            states, near, ways = (np.concatenate(column) for column in zip(*pushes, strict=True))
            helps = (np.abs(near) <= TOUCH) & (
                ways[:, 2] > FLATTEST
            )  # of what overlaps deeply the direction is a guess
            for k in left.tolist():
                together = ways[helps & (states == k)]
                if len(together) > 1:
                    cosine[k] = max(cosine[k], steepest_together(together))
        return gap, cosine

    def _measured(self, pair: _Pair, most: Array) -> Array:
        """The distances [m] of two links, where they are below ``most`` [m]."""
        return self._exact.distance(pair.a, pair.b, pair.X_WA, pair.X_WB, candidates(pair, most), most)

    def _decided(self, pair: _Pair, threshold: float) -> Array:
        """On which side of a threshold the distances of two links are: bounds that are on the same side."""
        found, open_ = box_bounds(pair, threshold)
        if len(open_):
            some = pair.at(open_)
            most = np.full(len(open_), np.nextafter(threshold, np.inf))
            near = candidates(some, most)
            found[open_] = self._exact.distance(some.a, some.b, some.X_WA, some.X_WB, near, most, threshold)
        return found


def steepest_together(ways: Array) -> float:
    """The greatest cosine with up of a push that is a sum of pushes along unit vectors, (k, 3)."""
    from scipy.optimize import nnls

    # The push nearest to up is the projection of up on the cone of all of them: its length is the cosine.
    return float(np.sqrt(max(0.0, 1 - nnls(ways.T, UP)[1] ** 2)))


class _Pair:
    """Two links, by name and index, in n states."""

    def __init__(
        self, a: tuple[str, int], b: tuple[str, int], one: Form, other: Form, X_WA: Poses, X_WB: Poses
    ) -> None:
        self.a, self.b, self.one, self.other, self.X_WA, self.X_WB = a, b, one, other, X_WA, X_WB

    def at(self, index: Index) -> _Pair:
        """Some of the states."""
        return _Pair(self.a, self.b, self.one, self.other, self.X_WA.at(index), self.X_WB.at(index))


def box_bounds(pair: _Pair, threshold: float) -> tuple[Array, Index]:
    """Bounds of distances [m], (n,), and the states in which they do not tell on which side of the threshold it is.

    Where a link is one box, the corners of the other's hull tell nearly always.
    """
    if (seen := from_box(pair)) is None:
        n = len(pair.X_WA.p)
        return np.full(n, -np.inf), np.arange(n)
    lower, upper = seen.lower(), seen.upper()
    found = np.where(upper <= threshold, upper, lower).astype(np.float64)
    return found, np.flatnonzero((lower <= threshold) & (upper > threshold))


def _box_support(pair: _Pair, limit: float, steepest: float) -> tuple[Array, Array, Index]:
    """Bounds of the distance [m] and of the cosine of :meth:`Distances.support`, (n,) each, and where they do not tell.

    Where a link is one box, the corners of the other's hull tell nearly always that it is far, or stands on the other.
    """
    n = len(pair.X_WA.p)
    if (seen := from_box(pair)) is None:
        return np.full(n, np.inf), np.full(n, -1.0), np.arange(n)
    lower, upper = seen.lower(), seen.upper()
    up = (seen.lower(LIFT) - upper) / LIFT
    stands = (upper <= limit) & (up >= steepest)
    apart = np.where(stands, upper, np.where(lower > limit, lower, np.inf)).astype(np.float64)
    open_ = np.flatnonzero(~stands & (lower <= limit))
    return apart, np.where(stands, up, -1.0).astype(np.float64), open_


class FromBox(NamedTuple):
    """The hull of one link of a pair in the frame of the other, which is one box, in n states.

    ``local`` [m], (n, m, 3), are points with a ``radius`` [m] each, which reach from ``low`` to ``high`` [m], (n, 3);
    ``up`` is the way in which they move in that frame where the first link of the pair is raised, (n, 3).
    """

    field: BoxField
    local: NDArray[np.float32]
    radius: NDArray[np.float32]
    low: NDArray[np.float32]
    high: NDArray[np.float32]
    up: NDArray[np.float32]

    def lower(self, raised: float = 0.0) -> Array:
        """A lower bound of the distance [m], (n,), where the first link is raised [m]."""
        move = np.float32(raised) * self.up
        return self.field.lower(self.low + move, self.high + move)

    def upper(self) -> Array:
        """An upper bound of the distance [m], (n,)."""
        return self.field.upper(self.local, self.radius)


def from_box(pair: _Pair) -> FromBox | None:
    """A pair of links seen from that which is one box; None where neither is."""
    one, other, X_WA, X_WB, sign = pair.one, pair.other, pair.X_WA, pair.X_WB, 1.0
    if box_field(other) is None:
        one, other, X_WA, X_WB, sign = other, one, X_WB, X_WA, -1.0
    field = box_field(other)
    if field is None:
        return None
    X_BA = X_WB.inverse() @ X_WA
    p, turned = X_BA.p.astype(np.float32), X_BA.R.transpose(0, 2, 1).astype(np.float32)
    points = one.points.astype(np.float32) @ turned + p[:, None]
    up = sign * X_WB.R[:, 2].astype(np.float32) @ field.axes
    local, radius = field.local(points), one.radius.astype(np.float32)
    low, high = (local - radius[:, None]).min(axis=1), (local + radius[:, None]).max(axis=1)
    return FromBox(field, local, radius, low, high, np.asarray(up, dtype=np.float32))


def middles_apart(X_WA: Poses, a: Form, X_WB: Poses, b: Form) -> Array:
    """A distance [m] that two links have at least, (n,): of the balls around them."""
    (ball_a, size_a), (ball_b, size_b) = a.ball, b.ball
    off = X_WA.p + X_WA.R @ ball_a - X_WB.p - X_WB.R @ ball_b
    return np.asarray(np.sqrt(np.einsum("ni,ni->n", off, off)) - size_a - size_b)


def ball_bound(X_WA: Poses, a: Form, X_WB: Poses, b: Form) -> Array:
    """A distance [m] that two links have at least, (n,): of the ball around each from the box around the other."""
    (ball_a, size_a), (ball_b, size_b) = a.ball, b.ball
    middle_a, middle_b = X_WA.p + X_WA.R @ ball_a, X_WB.p + X_WB.R @ ball_b
    b_in_a = rotate(X_WA.R.transpose(0, 2, 1), middle_b - X_WA.p)
    a_in_b = rotate(X_WB.R.transpose(0, 2, 1), middle_a - X_WB.p)
    first = _beyond(b_in_a, a.low[:3], a.high[:3]) - size_b
    second = _beyond(a_in_b, b.low[:3], b.high[:3]) - size_a
    return np.asarray(np.maximum(first, second))


def candidates(pair: _Pair, most: Array) -> Candidates:
    """The parts of two links that may be nearer to each other than ``most`` [m], (n,), by state, the nearest first."""
    X_AB = pair.X_WA.inverse() @ pair.X_WB
    low_a, high_a, ball_a, size_a = pair.one.pieces
    low_b, high_b, ball_b, size_b = pair.other.pieces
    b_in_a = X_AB.p[:, None] + ball_b @ X_AB.R.transpose(0, 2, 1)
    reach = most[:, None, None] + (size_a[:, None] + size_b)
    square = (
        (b_in_a**2).sum(axis=2)[:, None] + (ball_a**2).sum(axis=1)[:, None] - 2 * (ball_a @ b_in_a.transpose(0, 2, 1))
    )
    state, i, j = np.nonzero(square < reach**2 * (reach > 0))
    a_in_b = (ball_a - X_AB.p[:, None]) @ X_AB.R
    bound = _beyond(b_in_a[state, j], low_a[i], high_a[i]) - size_b[j]
    bound = np.maximum(bound, _beyond(a_in_b[state, i], low_b[j], high_b[j]) - size_a[i])
    kept = np.flatnonzero(bound < most[state])
    kept = kept[np.lexsort((bound[kept], state[kept]))]
    return Candidates(state[kept], i[kept], j[kept], bound[kept])


def _beyond(points: Array, low: Array, high: Array) -> Array:
    """How far points lie outside of boxes [m]."""
    off = np.maximum(np.maximum(low - points, points - high), 0.0)
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", off, off)))
