"""Depth of an object inside the cavity of another."""

from __future__ import annotations

import numpy as np

from simfoundry.geometry.cavity import Cavity, cavity_upward
from simfoundry.geometry.frames import Array
from simfoundry.geometry.poses import Index, rotate
from simfoundry.geometry.volume_samples import volume_samples
from simfoundry.predicates.judging.bodies import Entity
from simfoundry.predicates.judging.thresholds import ENCLOSED, FACING_DOWN_DEG
from simfoundry.predicates.judging.view import View

SAMPLES = 64
"""Number of sample points of an object whose depth is measured."""


def held_upward(view: View, b: Entity) -> list[tuple[int, Cavity, Index]]:
    """Cavities of an entity's links in their current orientations: the index of the link, and its states.

    The up axis of a cavity is the link axis nearest to up.
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
    """Depth [m] of the share :data:`ENCLOSED` of ``a`` in a cavity of ``b`` that is not turned down, (n,).

    -inf if ``b`` is turned so that it cannot contain anything.
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
    """Depth [m] that the share :data:`ENCLOSED` of the volume of ``a`` reaches in a cavity, (n,).

    Negative outside the cavity: the distance, or a bound of it if all of ``a`` is far outside.
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
    near = np.flatnonzero(out >= 0)
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
    """Number of samples of each link, in proportion to its mass."""
    forms = view.forms(a)
    if len(forms) == 1:
        return [SAMPLES]
    links = view.bodies[a.owner].item.links
    masses = np.array([links[k].mass for k, _ in forms])
    return [max(1, round(SAMPLES * float(m))) for m in masses / masses.sum()]


def facing(view: View, k: int, owner: str, hole: Cavity) -> Array:
    """Margin before the opening of a cavity is turned down too far [m], (n,), scaled by its depth."""
    X_WB = view.link(owner, k)
    up = rotate(X_WB.R, np.broadcast_to(hole.out, (view.n, 3)))[:, 2]
    return np.asarray(hole.deep * (up - np.cos(np.radians(FACING_DOWN_DEG))))
