"""Support from below: contacts that push an object up, balance on them, and what rests on an object."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array
from simfoundry.predicates.judging.bodies import Thing
from simfoundry.predicates.judging.plumb import centre_of_mass
from simfoundry.predicates.judging.terms import Context
from simfoundry.predicates.judging.thresholds import SUPPORT_DEG, TOUCH
from simfoundry.predicates.judging.view import View, over
from simfoundry.scene.lengths import length

STEEPEST = math.cos(math.radians(SUPPORT_DEG))
"""The cosine of :data:`~simfoundry.predicates.judging.thresholds.SUPPORT_DEG`."""


class Contact:
    """Distance and push between two things, measured together in the states that are still open."""

    def __init__(self, context: Context, a: Thing, b: Thing) -> None:
        self.context, self.a, self.b = context, a, b
        self._up: Array = np.zeros(0)

    def gap(self, view: View) -> Array:
        """The distance [m], (n,); remembers the push of the states in which the two touch."""
        gap, up = self.context.distances.support(view, self.a, self.b, TOUCH, STEEPEST)
        self._up = up[gap < TOUCH]
        return gap

    def push(self, _: View) -> Array:
        """The cosine between up and the push in the states in which :meth:`gap` has found the two to touch."""
        return self._up


def balance(context: Context, a: Thing, b: Thing, view: View) -> Array:
    """Distance of the centre of mass of ``a`` from the edge of the outline of ``b``, inwards [m], (n,).

    If the centre of mass is beside ``b`` and another object touches ``a`` too, the spare of that contact instead.
    """
    within = over(centre_of_mass(view, a), view.boxes(b))
    for other in context.others(a, b):
        left = np.flatnonzero(within <= 0)
        if len(left):
            gap = context.distances.between(view.at(left), a, other, TOUCH)
            within[left] = np.where(gap < TOUCH, TOUCH - gap, within[left])
    return within


def balance_text(a: Thing, b: Thing, value: float) -> str:
    """The explanation of :func:`balance`."""
    if value > 0:
        return f"it carries `{a.name}`"
    return (
        f"`{a.name}` would fall: its centre of mass is {length(-value)} beside `{b.name}`, and nothing else touches it"
    )


def push_text(a: Thing, b: Thing, cosine: float) -> str:
    """The reason why the push of ``b`` does not support ``a``."""
    if cosine < 0:
        return f"`{b.name}` is over `{a.name}`, not under it"
    off = np.degrees(np.arccos(min(cosine, 1.0)))
    return f"`{b.name}` pushes `{a.name}` to the side, {off:.0f} deg off straight up"


def gap_to_others(context: Context, a: Thing, view: View) -> Array:
    """The distance of ``a`` from the nearest object that it does not support [m], (n,)."""
    others = context.others(a)
    gaps = {b: context.distances.between(view, a, b, TOUCH) for b in others}
    load = supported_by(context, view, a, gaps)
    found = [np.where(load[b], np.inf, gap) for b, gap in gaps.items()]
    return np.asarray(np.min([*found, np.full(view.n, np.inf)], axis=0))


def supported_by(context: Context, view: View, a: Thing, gaps: dict[Thing, Array]) -> dict[Thing, NDArray[np.bool_]]:
    """The others that ``a`` supports, directly or through others, (n,) each; ``gaps`` [m] are their distances from it.

    Measured only in the states in which something touches ``a``.
    """
    load = {b: np.zeros(view.n, bool) for b in gaps}
    touched = np.flatnonzero(np.any([gap <= TOUCH for gap in gaps.values()], axis=0)) if gaps else np.zeros(0, np.int64)
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


def _supports(context: Context, view: View, a: Thing, b: Thing) -> NDArray[np.bool_]:
    """True where ``a`` touches ``b`` and pushes it up, (n,)."""
    gap, up = context.distances.support(view, b, a, TOUCH, STEEPEST)
    return np.asarray((gap <= TOUCH) & (up >= STEEPEST))
