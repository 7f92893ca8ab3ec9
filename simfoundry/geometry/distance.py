"""Bounds on the distance between two links in many states, and the candidate pairs of nearest parts."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.box_distance import BoxField, box_field
from simfoundry.geometry.exact_distance import LIFT, UP, Candidates
from simfoundry.geometry.form import Form
from simfoundry.geometry.frames import Array
from simfoundry.geometry.part_bounds import Interval, distance_bounds
from simfoundry.geometry.poses import Index, Poses, rotate


def steepest_together(ways: Array) -> float:
    """Largest cosine with up of any non-negative combination of unit vectors, (k, 3)."""
    from scipy.optimize import nnls

    # The best combination is the projection of up onto the cone that the vectors span: its length is the cosine.
    return float(np.sqrt(max(0.0, 1 - nnls(ways.T, UP)[1] ** 2)))


class LinkPair:
    """Two links, by name and index, in n states."""

    def __init__(
        self, a: tuple[str, int], b: tuple[str, int], one: Form, other: Form, X_WA: Poses, X_WB: Poses
    ) -> None:
        self.a, self.b, self.one, self.other, self.X_WA, self.X_WB = a, b, one, other, X_WA, X_WB

    def at(self, index: Index) -> LinkPair:
        """Select states."""
        return LinkPair(self.a, self.b, self.one, self.other, self.X_WA.at(index), self.X_WB.at(index))


def box_bounds(pair: LinkPair, threshold: float) -> tuple[Array, Index]:
    """Bounds of distances [m], (n,), and the states in which they do not decide the side of the threshold.

    If a link is a single box, the corners of the other link's hull decide nearly all states.
    """
    if (seen := from_box(pair)) is None:
        n = len(pair.X_WA.p)
        return np.full(n, -np.inf), np.arange(n)
    lower, upper = seen.lower(), seen.upper()
    found = np.where(upper <= threshold, upper, lower).astype(np.float64)
    return found, np.flatnonzero((lower <= threshold) & (upper > threshold))


def box_support(pair: LinkPair, limit: float, steepest: float) -> tuple[Array, Array, Index]:
    """Bounds of the distance [m] and of the support cosine, (n,) each, and the undecided states.

    If a link is a single box, the corners of the other link's hull usually decide that it is far away or supported.
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


def decide_distances(pair: LinkPair, threshold: float, found: Array, open_: Index) -> Index:
    """Write bounds of the undecided distances [m] into ``found``, (n,); return the states still undecided."""
    left = []
    for k in open_.tolist():
        bounds = _part_bounds(pair, k, threshold)
        if bounds.upper <= threshold:
            found[k] = bounds.upper
        elif bounds.lower > threshold:
            found[k] = bounds.lower
        else:
            left.append(k)
    return np.array(left, dtype=np.int64)


def decide_support(pair: LinkPair, limit: float, steepest: float, apart: Array, up: Array, open_: Index) -> Index:
    """Decide :func:`box_support` by parts: update ``apart`` and ``up``, (n,) each; return the undecided states."""
    left = []
    for k in open_.tolist():
        bounds = _part_bounds(pair, k, limit)
        if bounds.lower > limit:
            apart[k] = bounds.lower
            continue
        rise = (_part_bounds(pair, k, limit + LIFT, LIFT).lower - bounds.upper) / LIFT
        if bounds.upper <= limit and rise >= steepest:
            apart[k], up[k] = bounds.upper, rise
        else:
            left.append(k)
    return np.array(left, dtype=np.int64)


def _part_bounds(pair: LinkPair, k: int, limit: float, raised: float = 0.0) -> Interval:
    """Bounds of the distance in the k-th state with the first link raised [m]."""
    X_WA, X_WB = (pair.X_WA.p[k] + raised * UP, pair.X_WA.R[k]), (pair.X_WB.p[k], pair.X_WB.R[k])
    return distance_bounds(pair.one, pair.other, X_WA, X_WB, np.nextafter(limit, np.inf))


class FromBox(NamedTuple):
    """Hull of one link of a pair in the frame of the other, which is a single box, in n states.

    ``local`` [m], (n, m, 3), are points with a ``radius`` [m] each, which lie between ``low`` and ``high`` [m], (n, 3);
    ``up`` is the direction of their motion in that frame when the first link of the pair is raised, (n, 3).
    """

    field: BoxField
    local: NDArray[np.float32]
    radius: NDArray[np.float32]
    low: NDArray[np.float32]
    high: NDArray[np.float32]
    up: NDArray[np.float32]

    def lower(self, raised: float = 0.0) -> Array:
        """Lower bound of the distance [m], (n,), with the first link raised [m]."""
        move = np.float32(raised) * self.up
        return self.field.lower(self.low + move, self.high + move)

    def upper(self) -> Array:
        """Upper bound of the distance [m], (n,)."""
        return self.field.upper(self.local, self.radius)


def from_box(pair: LinkPair) -> FromBox | None:
    """Return a pair of links in the frame of the one that is a single box; None if neither is."""
    one, other, X_WA, X_WB, sign = pair.one, pair.other, pair.X_WA, pair.X_WB, 1.0
    if box_field(other) is None:
        one, other, X_WA, X_WB, sign = other, one, X_WB, X_WA, -1.0
    field = box_field(other)
    if field is None:
        return None
    X_BA = X_WB.inverse() @ X_WA
    p, turned = X_BA.p.astype(np.float32), X_BA.R.transpose(0, 2, 1).astype(np.float32)
    corners, radii = one.support(len(p))
    points = corners.astype(np.float32) @ turned + p[:, None]
    up = sign * X_WB.R[:, 2].astype(np.float32) @ field.axes
    local, radius = field.local(points), radii.astype(np.float32)
    low, high = (local - radius[:, None]).min(axis=1), (local + radius[:, None]).max(axis=1)
    return FromBox(field, local, radius, low, high, np.asarray(up, dtype=np.float32))


def ball_bound(X_WA: Poses, a: Form, X_WB: Poses, b: Form) -> Array:
    """Lower bound of the distance of two links [m], (n,): from the bounding ball of each to the box of the other."""
    (ball_a, size_a), (ball_b, size_b) = a.ball, b.ball
    middle_a, middle_b = X_WA.p + X_WA.R @ ball_a, X_WB.p + X_WB.R @ ball_b
    b_in_a = rotate(X_WA.R.transpose(0, 2, 1), middle_b - X_WA.p)
    a_in_b = rotate(X_WB.R.transpose(0, 2, 1), middle_a - X_WB.p)
    first = _beyond(b_in_a, a.low[:3], a.high[:3]) - size_b
    second = _beyond(a_in_b, b.low[:3], b.high[:3]) - size_a
    return np.asarray(np.maximum(first, second))


def candidates(pair: LinkPair, most: Array) -> Candidates:
    """Part pairs of two links that may be closer than ``most`` [m], (n,), by state, nearest first."""
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
    """Distances of points outside of boxes [m]; 0 within."""
    off = np.maximum(np.maximum(low - points, points - high), 0.0)
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", off, off)))
