"""Measurements for individual predicates, such as support from below, depth in a cavity, and hits by plumb lines."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.cavity import Cavity, cavity_upward, volume_samples
from simfoundry.geometry.frames import Array, Index, rotate
from simfoundry.geometry.plumb_lines import SEAM, chords_of
from simfoundry.predicates.judging.bodies import Entity
from simfoundry.predicates.judging.judge import Context
from simfoundry.predicates.judging.thresholds import CLOSE, ENCLOSED, FRICTION_SHARE, OPENING_DEG, SUPPORT_DEG, TOUCH
from simfoundry.predicates.judging.view import View, over
from simfoundry.scene.lengths import length


class Meeting(NamedTuple):
    """The depths [m] at which plumb lines through one entity hit parts of another entity over and under it.

    The depths are arrays of shape (n,). Each depth is the smaller of two values: the distance from the line to the
    part's outline, and the length by which the part extends beyond the end of the first entity along the line. The
    depth is negative if nothing is hit.
    """

    over: Array
    under: Array


def meet(view: View, a: Entity, b: Entity) -> Meeting:
    """Measure the parts of ``b`` that the plumb line through the middle of ``a`` intersects outside ``a``."""
    points = view.aabb_middle(a)
    over, under = np.full(view.n, -np.inf), np.full(view.n, -np.inf)
    found = list(_chords_of(view, points, b))
    for state, within, _, _ in found:
        np.maximum.at(over, state, within)
    met = np.flatnonzero(over > 0)
    beside = np.hypot(*(points - view.boxes(b).middle)[:, :2].T) + SEAM
    over, under = (np.where(np.isfinite(over), over, -beside) for _ in range(2))
    if len(met):
        low, high = _own_ends(view.at(met), points[met], a)
        row = np.full(view.n, -1)
        row[met] = np.arange(len(met))
        over[met] = under[met] = -np.inf
        for state, within, bottom, top in found:
            some = np.flatnonzero(row[state] >= 0)
            at = row[state[some]]
            np.maximum.at(over, state[some], np.minimum(within[some], top[some] - high[at]))
            np.maximum.at(under, state[some], np.minimum(within[some], low[at] - bottom[some]))
    return Meeting(over, under)


def _own_ends(view: View, points: Array, a: Entity) -> tuple[Array, Array]:
    """Return the ends of plumb lines within the entity itself, relative to the given points.

    The ends [m] have the shape (n,). Both ends are 0 if the line does not hit the entity.
    """
    low, high = np.full(view.n, np.inf), np.full(view.n, -np.inf)
    for state, within, bottom, top in _chords_of(view, points, a):
        met = within > 0
        np.minimum.at(low, state[met], bottom[met])
        np.maximum.at(high, state[met], top[met])
    return np.where(low > high, 0.0, low), np.where(low > high, 0.0, high)


def _chords_of(view: View, points: Array, thing: Entity) -> Iterator[tuple[Index, Array, Array, Array]]:
    """Yield the chords of plumb lines in each link; see :func:`~simfoundry.geometry.plumb_lines.chords_of`."""
    for k, form in view.forms(thing):
        found = chords_of(form, view.link(thing.owner, k), points)
        if len(found[0]):
            yield found


# Number of points sampled in an object to measure its depth in a cavity.
SAMPLES = 64


def held_upward(view: View, b: Entity) -> list[tuple[int, Cavity, Index]]:
    """Return the cavities of an entity's links in their current orientations.

    Each cavity is accompanied by its link index and by the indices of the states in which the link has this
    orientation. The up axis of a cavity is the link axis closest to the vertical.
    """
    found = []
    for k in view.bodies.hollow_links(b):
        form = view.bodies[b.owner].forms[k]
        assert form is not None
        up = view.link(b.owner, k).R[:, 2]
        axes = np.abs(up).argmax(axis=1)
        upward = np.take_along_axis(up, axes[:, None], axis=1)[:, 0] > 0
        for axis, sign in sorted(set(zip(axes.tolist(), np.where(upward, 1, -1).tolist(), strict=True))):
            if (hole := cavity_upward(form, axis, sign)) is not None:
                found.append((k, hole, np.flatnonzero((axes == axis) & (upward == (sign > 0)))))
    return found


def enclosed_depth(view: View, a: Entity, b: Entity) -> Array:
    """Return the depth [m] in a cavity of ``b`` that the fraction :data:`ENCLOSED` of ``a`` reaches.

    The depth is an array of shape (n,). It is -inf if ``b`` is tilted too far to contain anything.
    """
    out = np.full(view.n, -np.inf)
    for k, hole, states in held_upward(view, b):
        some = view if len(states) == view.n else view.at(states)
        depth = depth_in(some, a, k, b.owner, hole)
        if hole.out.any():
            depth = np.minimum(depth, 10 * facing(some, k, b.owner, hole))
        out[states] = np.maximum(out[states], depth)
    return out


def depth_in(view: View, a: Entity, k: int, owner: str, hole: Cavity) -> Array:
    """Return the depth [m] that the fraction :data:`ENCLOSED` of the volume of ``a`` reaches in a cavity.

    The depth is an array of shape (n,). Outside the cavity, it is the negative distance, or a bound on this value if
    all of ``a`` is far outside.
    """
    X_WB = view.link(owner, k)
    out = np.full(view.n, np.inf)
    middle = X_WB.p + X_WB.R @ hole.middle
    forms = view.forms(a)
    for j, form in forms:  # the bounding balls decide most states
        X_WA = view.link(a.owner, j)
        center, radius = form.ball
        gap = np.linalg.norm(X_WA.p + X_WA.R @ center - middle, axis=1) - radius - hole.size
        out = np.minimum(out, gap)
    out = -out
    near = np.arange(view.n) if view.exact else np.flatnonzero(out >= 0)
    if len(near):
        counts = _counts(view, a)
        depths = []
        X_BW = X_WB.at(near).inverse()
        for (j, form), count in zip(forms, counts, strict=True):
            if count:
                X_BA = X_BW @ view.link(a.owner, j).at(near)
                points = volume_samples(form, count) @ X_BA.R.transpose(0, 2, 1) + X_BA.p[:, None]
                depths.append(hole.at(points))
        every = np.concatenate(depths, axis=1)
        rank = every.shape[1] - int(np.ceil(ENCLOSED * every.shape[1]))
        out[near] = np.partition(every, rank, axis=1)[:, rank]
    return out


def _counts(view: View, a: Entity) -> list[int]:
    """Return the number of samples for each link, which is proportional to the mass of the link."""
    forms = view.forms(a)
    if len(forms) == 1:
        return [SAMPLES]
    links = view.bodies[a.owner].item.links
    masses = np.array([links[k].mass for k, _ in forms])
    return [max(1, round(SAMPLES * float(m))) for m in masses / masses.sum()]


def facing(view: View, k: int, owner: str, hole: Cavity) -> Array:
    """Return the margin [m] that remains before the opening of a cavity faces too far down, as an array of shape (n,).

    The margin is scaled by the depth of the cavity.
    """
    X_WB = view.link(owner, k)
    up = rotate(X_WB.R, np.broadcast_to(hole.out, (view.n, 3)))[:, 2]
    return np.asarray(hole.deep * (up - np.cos(np.radians(OPENING_DEG))))


def least_cosine(context: Context, a: Entity, b: Entity) -> float:
    """Return the smallest cosine for which a contact supports ``a``.

    This is the cosine of the angle between the vertical and the normal of the contact between ``a`` and ``b``.
    """
    friction = math.sqrt(_friction(context, a) * _friction(context, b))
    return math.cos(math.radians(SUPPORT_DEG) + FRICTION_SHARE * math.atan(friction))


def _friction(context: Context, thing: Entity) -> float:
    """Return the mean friction coefficient of an entity's colliders, or 0 if it has none."""
    links = context.bodies[thing.owner].item.links
    found = [collider.friction for k in thing.links for collider in links[k].colliders]
    return sum(found) / len(found) if found else 0.0


class SupportContact:
    """The distance and push direction between two entities, measured together in states that are still undecided."""

    def __init__(self, context: Context, a: Entity, b: Entity) -> None:
        self.context, self.a, self.b = context, a, b
        self.least_cosine = least_cosine(context, a, b)
        self._up: Array = np.zeros(0)
        self._rival: NDArray[np.bool_] = np.zeros(0, bool)

    def gap(self, view: View) -> Array:
        """Return the distance [m] between the entities, as an array of shape (n,).

        The push and the states in which a closer object supports ``a`` are stored.
        """
        support = self.context.distances.support
        gap, up = support(view, self.a, self.b, CLOSE, self.least_cosine)
        self._rival = np.zeros(view.n, bool)
        loose = np.flatnonzero(gap > CLOSE)
        if len(loose):
            some = view.at(loose)
            gap[loose], up[loose] = support(some, self.a, self.b, TOUCH, self.least_cosine)
            near = loose[gap[loose] < TOUCH]
            for other in self.context.others(self.a, self.b) if len(near) else ():
                self._rival[near] |= _supports(self.context, view.at(near), other, self.a, CLOSE)
        self._up = up[self.margin(gap) > 0]
        return gap

    def margin(self, gap: Array) -> Array:
        """Return the margin [m] for distances returned by :meth:`gap`, as an array of shape (n,)."""
        return np.asarray(np.where(self._rival, CLOSE, TOUCH) - gap)

    def push(self, _: View) -> Array:
        """Return the cosine of the angle between the push and the vertical in the states with a positive margin."""
        return self._up


def balance(context: Context, a: Entity, b: Entity, view: View) -> Array:
    """Return the distance [m] between the center of mass of ``a`` and the edge of the outline of ``b``.

    The distance is an array of shape (n,), which is positive inside the outline. If the center of mass is outside and
    another object also touches ``a``, the margin of that contact is returned instead.
    """
    within = over(center_of_mass(view, a), view.boxes(b))
    for other in context.others(a, b) if (within <= 0).any() else ():
        left = np.flatnonzero(within <= 0)
        if len(left):
            gap = context.distances.between(view.at(left), a, other, TOUCH)
            within[left] = np.where(gap < TOUCH, TOUCH - gap, within[left])
    return within


def center_of_mass(view: View, a: Entity) -> Array:
    """Return an entity's center of mass [m], or the middle of its bounding box if it has no mass.

    The result is an array of shape (n, 3).
    """
    links = view.bodies[a.owner].item.links
    mass = sum(links[k].mass for k in a.links)
    if mass <= 0:
        return view.boxes(a).middle
    total = np.zeros((view.n, 3))
    for k in a.links:
        X_WL = view.link(a.owner, k)
        total += links[k].mass / mass * (X_WL.p + X_WL.R @ links[k].com)
    return total


def balance_text(a: Entity, b: Entity, value: float) -> str:
    """Return an explanation of the result of :func:`balance`."""
    if value > 0:
        return f"it supports `{a.name}`"
    return f"the center of mass of `{a.name}` is {length(-value)} to the side of `{b.name}`, so `{a.name}` would fall"


def push_text(a: Entity, b: Entity, cosine: float) -> str:
    """Explain why the push of ``b`` does not support ``a``."""
    if cosine < 0:
        return f"`{b.name}` is above `{a.name}`, not below it"
    off = np.degrees(np.arccos(min(cosine, 1.0)))
    return f"`{b.name}` pushes `{a.name}` sideways, {off:.0f} deg from straight up"


def gap_to_others(context: Context, a: Entity, view: View) -> Array:
    """Return the distance [m] between ``a`` and the nearest object that it does not support.

    The distance is an array of shape (n,).
    """
    gaps = {b: context.distances.between(view, a, b, TOUCH) for b in context.others(a)}
    load = supported_by(context, view, a, gaps)
    found = [np.where(load[b], np.inf, gap) for b, gap in gaps.items()]
    return np.asarray(np.min([*found, np.full(view.n, np.inf)], axis=0))


def supported_by(context: Context, view: View, a: Entity, gaps: dict[Entity, Array]) -> dict[Entity, NDArray[np.bool_]]:
    """Return, for each object, a mask of the states in which ``a`` supports it directly or indirectly.

    ``gaps`` contains the distances [m] between the objects and ``a``. Support is only measured in states in which
    something touches ``a``.
    """
    load = {b: np.zeros(view.n, bool) for b in gaps}
    touched = np.flatnonzero(np.any([gap <= TOUCH for gap in gaps.values()], axis=0))
    if not len(touched):
        return load
    some = view.at(touched)
    found = {b: np.zeros(some.n, bool) for b in gaps}
    for b, gap in gaps.items():
        met = np.flatnonzero(gap[touched] <= TOUCH)
        if len(met):
            found[b][met] = _supports(context, some.at(met), a, b)
    pending = [b for b, values in found.items() if values.any()]
    while pending:
        below = pending.pop()
        for b in gaps:
            left = np.flatnonzero(found[below] & ~found[b])
            if b != below and len(left):
                new = left[_supports(context, some.at(left), below, b)]
                found[b][new] = True
                pending += [b] if len(new) else []
    for b, values in found.items():
        load[b][touched] = values
    return load


def _supports(context: Context, view: View, a: Entity, b: Entity, limit: float = TOUCH) -> NDArray[np.bool_]:
    """Return a mask of the states in which ``a`` is within ``limit`` [m] of ``b`` and pushes it up."""
    cosine = least_cosine(context, b, a)
    gap, up = context.distances.support(view, b, a, limit, cosine)
    return np.asarray((gap <= limit) & (up >= cosine))
