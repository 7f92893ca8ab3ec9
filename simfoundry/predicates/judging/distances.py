"""Distances between entities in many states. Exact values are computed only where bounds are inconclusive."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from simfoundry.geometry import distance
from simfoundry.geometry.distance import Exact, LinkPair, ball_bound, candidates
from simfoundry.geometry.form import FEW
from simfoundry.geometry.frames import Array, Index
from simfoundry.predicates.judging.bodies import Bodies, Entity
from simfoundry.predicates.judging.thresholds import TOUCH
from simfoundry.predicates.judging.view import Balls, View

# Distance [m] beyond which values are only lower bounds.
FAR = 0.05

# Minimum cosine between the vertical and the push of a wall for the push to contribute to the support of an object.
FLATTEST = math.cos(math.radians(80.0))


class Distances:
    """Distances between the bodies in a scene.

    If ``bounds_first`` is set, comparisons with thresholds are decided from bounds even if there are few states, and
    MuJoCo is loaded only if the bounds are inconclusive. The verdicts are the same, but the reported values are not
    exact distances.
    """

    def __init__(self, bodies: Bodies, bounds_first: bool = False) -> None:
        self._bodies = bodies
        self._bounds_first = bounds_first

    @cached_property
    def _exact(self) -> Exact:
        return Exact(self._bodies.link_shapes())

    def between(self, view: View, a: Entity, b: Entity, threshold: float | None = None) -> Array:
        """Return the signed distance [m] between two entities, as an array of shape (n,).

        The distance is negative if they overlap, and inf if either entity has no colliders. Distances below :data:`FAR`
        are exact; larger distances are returned as values between :data:`FAR` and the true distance. For more than
        :data:`FEW` states with a ``threshold`` [m], only the comparison with the threshold is exact: values below it
        are upper bounds, and values above it are lower bounds. In an exact view, all distances are exact.
        """
        far = np.inf if view.exact else FAR
        limit = threshold if threshold is not None and self._is_bounded(view) else None
        balls, lowers = _balls_apart(view, a, b)
        beyond = (lowers >= far).all(axis=0)
        out: Array = lowers[:, beyond].min(axis=1, initial=np.inf)
        for row, column in np.argwhere(~beyond).tolist():
            (i, one), (j, other) = balls[0].links[row], balls[1].links[column]
            X_WA, X_WB = view.link(a.owner, i), view.link(b.owner, j)
            lower = lowers[:, row, column]
            some = np.flatnonzero(lower < np.minimum(out, far))
            if len(some):
                lower[some] = np.maximum(lower[some], ball_bound(X_WA.at(some), one, X_WB.at(some), other))
            cut = far if limit is None else float(np.nextafter(limit, np.inf))
            close = np.flatnonzero((lower < np.minimum(out, cut)) & (out > (-np.inf if limit is None else limit)))
            out = np.where(out > cut, np.minimum(out, np.maximum(lower, cut)), out)
            if len(close):
                pair = LinkPair((a.owner, i), (b.owner, j), one, other, X_WA.at(close), X_WB.at(close))
                if limit is None:
                    found = self._exact.distance(pair, candidates(pair, out[close]), out[close])
                else:
                    found = self._decided(pair, limit)
                out[close] = np.minimum(out[close], found)
        return np.asarray(out)

    def _is_bounded(self, view: View) -> bool:
        """Return True if bounds are sufficient in a view."""
        return not view.exact and (view.n > FEW or self._bounds_first)

    def support(self, view: View, a: Entity, b: Entity, limit: float, steepest: float) -> tuple[Array, Array]:
        """Return the distance from ``b`` to ``a``, and the cosine between the push of ``b`` and the vertical.

        The cosine is the largest one for any direction from a part of ``b`` to a part of ``a`` that is within ``limit``
        [m] of it, or -1 if no parts are that close. If several parts push together, like the walls of a funnel, it is
        the cosine of their steepest combined direction. For more than :data:`FEW` states, only the comparisons with
        ``limit`` and ``steepest`` are exact.

        Returns:
            The distance [m] and the cosine, shape (n,) each.
        """
        many = self._is_bounded(view)
        gap = np.full(view.n, np.inf) if many else self.between(view, a, b)
        cosine = np.full(view.n, -1.0)
        pushes: list[tuple[Index, Array, Array]] = []
        balls, lowers = _balls_apart(view, a, b)
        for row, column in np.argwhere((lowers <= limit).any(axis=0)).tolist():
            (i, one), (j, other) = balls[0].links[row], balls[1].links[column]
            X_WA, X_WB = view.link(a.owner, i), view.link(b.owner, j)
            close = np.flatnonzero((cosine < steepest) & (lowers[:, row, column] <= limit))
            close = close[ball_bound(X_WA.at(close), one, X_WB.at(close), other) <= limit]
            if not len(close):
                continue
            pair = LinkPair((a.owner, i), (b.owner, j), one, other, X_WA.at(close), X_WB.at(close))
            apart, up, open_ = distance.bound_support(pair, limit, steepest, self._bounds_first and many)
            if not many:
                open_ = np.arange(len(close))
            if len(open_):
                some = pair.at(open_)
                most = np.full(len(open_), np.nextafter(limit, np.inf))
                enough = steepest if many else np.inf
                state, near, way = self._exact.pushes(some, candidates(some, most), limit, enough)
                apart[open_], up[open_] = np.inf, -1.0
                np.minimum.at(apart, open_[state], near)
                np.maximum.at(up, open_[state], way[:, 2])
                pushes.append((close[open_][state], near, way))
            gap[close] = np.minimum(gap[close], apart)
            cosine[close] = np.maximum(cosine[close], up)
        left = np.flatnonzero((cosine < steepest) & (gap <= limit))
        if len(left) and pushes:
            states, near, ways = (np.concatenate(column) for column in zip(*pushes, strict=True))
            helps = (np.abs(near) <= TOUCH) & (ways[:, 2] > FLATTEST)  # the direction is unreliable for deep overlaps
            for k in left.tolist():
                together = ways[helps & (states == k)]
                if len(together) > 1:
                    cosine[k] = max(cosine[k], distance.steepest_together(together))
        return gap, cosine

    def _decided(self, pair: LinkPair, threshold: float) -> Array:
        """Return bounds on the distances between two links. The bounds are on the correct side of a threshold."""
        found, open_ = distance.bound_distances(pair, threshold, self._bounds_first)
        if len(open_):
            some, most = pair.at(open_), np.full(len(open_), np.nextafter(threshold, np.inf))
            found[open_] = self._exact.distance(some, candidates(some, most), most, threshold)
        return found


def _balls_apart(view: View, a: Entity, b: Entity) -> tuple[tuple[Balls, Balls], Array]:
    """Return the bounding balls of the links of two entities, and the gaps between these balls.

    The gaps [m] have the shape (n, links of a, links of b). The gap between a link and itself is infinite.
    """
    first, second = view.balls(a), view.balls(b)
    off = first.center[:, :, None] - second.center[:, None]
    apart = np.sqrt(np.einsum("nijk,nijk->nij", off, off)) - first.radius[:, None] - second.radius
    if a.owner == b.owner:
        same = np.equal.outer([i for i, _ in first.links], [j for j, _ in second.links])
        apart[:, same] = np.inf
    return (first, second), apart
