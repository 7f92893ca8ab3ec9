"""Support from below: upward contacts, balance, and the objects supported by an object."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array
from simfoundry.geometry.poses import Poses
from simfoundry.predicates.judging.bodies import Entity
from simfoundry.predicates.judging.terms import Context
from simfoundry.predicates.judging.thresholds import CLOSE, FRICTION_SHARE, SUPPORT_DEG, TOUCH
from simfoundry.predicates.judging.view import View, over
from simfoundry.scene.lengths import length


def least_cosine(context: Context, a: Entity, b: Entity) -> float:
    """Least cosine between up and the normal of a contact through which ``b`` supports ``a``."""
    friction = math.sqrt(_friction(context, a) * _friction(context, b))
    return math.cos(math.radians(SUPPORT_DEG) + FRICTION_SHARE * math.atan(friction))


def _friction(context: Context, thing: Entity) -> float:
    """Mean friction coefficient of an entity's colliders; 0 if it has none."""
    links = context.bodies[thing.owner].item.links
    found = [collider.friction for k in thing.links for collider in links[k].colliders]
    return sum(found) / len(found) if found else 0.0


class SupportContact:
    """Distance and push between two entities, measured together in the states that are still undecided."""

    def __init__(self, context: Context, a: Entity, b: Entity) -> None:
        self.context, self.a, self.b = context, a, b
        self.least_cosine = least_cosine(context, a, b)
        self._up: Array = np.zeros(0)
        self._rival: NDArray[np.bool_] = np.zeros(0, bool)

    def gap(self, view: View) -> Array:
        """Return the distance [m], (n,); store the push, and the states in which a closer object supports ``a``."""
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
        """Return the margin [m] of the distances that :meth:`gap` returned, (n,)."""
        return np.asarray(np.where(self._rival, CLOSE, TOUCH) - gap)

    def push(self, _: View) -> Array:
        """Return the cosine between up and the push in the states with a positive margin."""
        return self._up


def balance(context: Context, a: Entity, b: Entity, view: View) -> Array:
    """Distance of the center of mass of ``a`` from the edge of the outline of ``b``, positive inside [m], (n,).

    If the center of mass is beside ``b`` and another object touches ``a`` too, the margin of that contact instead.
    """
    within = over(center_of_mass(view, a), view.boxes(b))
    for other in context.others(a, b):
        left = np.flatnonzero(within <= 0)
        if len(left):
            gap = context.distances.between(view.at(left), a, other, TOUCH)
            within[left] = np.where(gap < TOUCH, TOUCH - gap, within[left])
    return within


def center_of_mass(view: View, a: Entity) -> Array:
    """Center of mass of an entity [m], (n, 3); the middle of its bounding box if it has no mass."""
    links = view.bodies[a.owner].item.links
    masses = [links[k].mass for k in a.links]
    if sum(masses) <= 0:
        return view.boxes(a).middle
    total = np.zeros((view.n, 3))
    for k, mass in zip(a.links, masses, strict=True):
        X_WL: Poses = view.link(a.owner, k)
        total += mass / sum(masses) * (X_WL.p + X_WL.R @ links[k].com)
    return total


def balance_text(a: Entity, b: Entity, value: float) -> str:
    """Explain :func:`balance`."""
    if value > 0:
        return f"it supports `{a.name}`"
    return (
        f"`{a.name}` would fall: its center of mass is {length(-value)} beside `{b.name}`, and nothing else touches it"
    )


def push_text(a: Entity, b: Entity, cosine: float) -> str:
    """Explain why the push of ``b`` does not support ``a``."""
    if cosine < 0:
        return f"`{b.name}` is over `{a.name}`, not under it"
    off = np.degrees(np.arccos(min(cosine, 1.0)))
    return f"`{b.name}` pushes `{a.name}` sideways, {off:.0f} deg from straight up"


def gap_to_others(context: Context, a: Entity, view: View) -> Array:
    """Distance of ``a`` from the nearest object that it does not support [m], (n,)."""
    others = context.others(a)
    gaps = {b: context.distances.between(view, a, b, TOUCH) for b in others}
    load = supported_by(context, view, a, gaps)
    found = [np.where(load[b], np.inf, gap) for b, gap in gaps.items()]
    return np.asarray(np.min([*found, np.full(view.n, np.inf)], axis=0))


def supported_by(context: Context, view: View, a: Entity, gaps: dict[Entity, Array]) -> dict[Entity, NDArray[np.bool_]]:
    """Objects that ``a`` supports, directly or indirectly, (n,) each; ``gaps`` [m] are their distances from it.

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


def _supports(context: Context, view: View, a: Entity, b: Entity, limit: float = TOUCH) -> NDArray[np.bool_]:
    """True if ``a`` is no farther than ``limit`` [m] from ``b`` and ``b`` pushes it up, (n,)."""
    cosine = least_cosine(context, b, a)
    gap, up = context.distances.support(view, b, a, limit, cosine)
    return np.asarray((gap <= limit) & (up >= cosine))
