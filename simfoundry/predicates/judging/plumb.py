"""Objects above and below another along the plumb line through its middle."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from simfoundry.geometry.frames import Array
from simfoundry.geometry.plumb_lines import SEAM, chords_of
from simfoundry.geometry.poses import Index
from simfoundry.predicates.judging.bodies import Entity
from simfoundry.predicates.judging.view import View


class Meeting(NamedTuple):
    """Depths of the plumb lines of one entity in the parts of another over and under it [m], (n,) each.

    Each is the smaller of two values: the depth of the line within the other's outline, and the distance on that line
    by which the other extends beyond the end of the first. Negative if nothing is hit.
    """

    over: Array
    under: Array


def meet(view: View, a: Entity, b: Entity) -> Meeting:
    """Measure the parts of ``b`` that the plumb line through the middle of ``a`` intersects outside of ``a``."""
    points = view.boxes(a).middle
    over, under = np.full(view.n, -np.inf), np.full(view.n, -np.inf)
    found = list(_chords_of(view, points, b))
    for state, within, _, _ in found:
        np.maximum.at(over, state, within)
    met = np.flatnonzero(over > 0)
    over, under = (np.where(np.isfinite(over), over, -_beside(view, points, b)) for _ in range(2))
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
    """Ends of plumb lines through points in the entity itself, over the points [m], (n,); 0 if they miss it."""
    low, high = np.full(view.n, np.inf), np.full(view.n, -np.inf)
    for state, within, bottom, top in _chords_of(view, points, a):
        met = within > 0
        np.minimum.at(low, state[met], bottom[met])
        np.maximum.at(high, state[met], top[met])
    return np.where(low > high, 0.0, low), np.where(low > high, 0.0, high)


def _chords_of(view: View, points: Array, thing: Entity) -> Iterator[tuple[Index, Array, Array, Array]]:
    """Chords of plumb lines in each link of an entity; see :func:`~simfoundry.geometry.plumb_lines.chords_of`."""
    for k, form in view.forms(thing):
        found = chords_of(form, view.link(thing.owner, k), points)
        if len(found[0]):
            yield found


def _beside(view: View, points: Array, b: Entity) -> Array:
    """Distance of points along the ground from the middle of an entity's bounding box [m], (n,)."""
    return np.asarray(np.hypot(*(points - view.boxes(b).middle)[:, :2].T) + SEAM)
