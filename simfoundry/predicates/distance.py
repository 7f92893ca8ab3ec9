"""How far things are apart in many states: bounds for all of them, the exact distance where bounds do not tell."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from simfoundry.predicates.batch import Index, Poses, rotate
from simfoundry.predicates.exact import Exact
from simfoundry.predicates.shapes import Bodies, Form, Thing
from simfoundry.predicates.view import View
from simfoundry.scene.frames import Array

FAR = 0.05
"""Distances beyond this [m] are bounds: no farther than the truth."""


class Distances:
    """Distances between the bodies of one scene."""

    def __init__(self, bodies: Bodies) -> None:
        self._bodies = bodies

    @cached_property
    def _exact(self) -> Exact:
        return Exact(self._bodies)

    def between(self, view: View, a: Thing, b: Thing, far: float = FAR, own: bool = False) -> Array:
        """Signed distance [m] between two things, (n,), negative where they overlap.

        Exact below ``far`` [m]; else no less than ``far`` and no more than the truth. inf where one touches nothing.
        """
        out = np.full(view.n, np.inf)
        for i, one in view.forms(a):
            for j, other in view.forms(b):
                if not (one.solid and other.solid) or (a.owner == b.owner and i == j):
                    continue
                X_WA, X_WB = view.link(a.owner, i), view.link(b.owner, j)
                lower = ball_bound(X_WA, one, X_WB, other)
                close = np.flatnonzero(lower < np.minimum(out, far))
                out = np.minimum(out, np.maximum(lower, far))
                if len(close):
                    out[close] = self._near(
                        (a.owner, i), (b.owner, j), one, other, X_WA.at(close), X_WB.at(close), out[close]
                    )
        return out

    def _near(
        self, a: tuple[str, int], b: tuple[str, int], one: Form, other: Form, X_WA: Poses, X_WB: Poses, limit: Array
    ) -> Array:
        bounds = part_bounds(X_WA, one, X_WB, other)
        lowest = bounds.min(axis=(1, 2))
        out = np.array(limit)
        index: Index = np.flatnonzero(lowest < limit)
        if len(index):
            X_WA, X_WB = X_WA.at(index), X_WB.at(index)
            out[index] = self._exact.distance(a, b, X_WA, X_WB, bounds[index], limit[index])
        return out


def ball_bound(X_WA: Poses, a: Form, X_WB: Poses, b: Form) -> Array:
    """A distance [m] that two links have at least, (n,): of the ball around each from the box around the other."""
    X_AB = X_WA.inverse() @ X_WB
    (ball_a, size_a), (ball_b, size_b) = a.ball, b.ball
    b_in_a = X_AB.p + X_AB.R @ ball_b
    a_in_b = rotate(X_AB.R.transpose(0, 2, 1), ball_a - X_AB.p)
    first = _beyond(b_in_a, a.low[:3], a.high[:3]) - size_b
    second = _beyond(a_in_b, b.low[:3], b.high[:3]) - size_a
    return np.asarray(np.maximum(first, second))


def part_bounds(X_WA: Poses, a: Form, X_WB: Poses, b: Form) -> Array:
    """As :func:`ball_bound`, of each part of a from each part of b: (n, parts of a, parts of b)."""
    X_AB = X_WA.inverse() @ X_WB
    low_a, high_a, ball_a, size_a = a.pieces
    low_b, high_b, ball_b, size_b = b.pieces
    b_in_a = X_AB.p[:, None] + ball_b @ X_AB.R.transpose(0, 2, 1)
    a_in_b = (ball_a - X_AB.p[:, None]) @ X_AB.R
    first = _beyond(b_in_a[:, None], low_a[:, None], high_a[:, None]) - size_b
    second = _beyond(a_in_b[:, :, None], low_b, high_b) - size_a[:, None]
    return np.asarray(np.maximum(first, second))


def _beyond(points: Array, low: Array, high: Array) -> Array:
    """How far points lie outside of boxes [m]."""
    off = np.maximum(np.maximum(low - points, points - high), 0.0)
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", off, off)))
