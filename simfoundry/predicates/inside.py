"""How deep a thing is in the cavity of another."""

from __future__ import annotations

import numpy as np

from simfoundry.predicates.batch import rotate
from simfoundry.predicates.samples import volume_samples
from simfoundry.predicates.shapes import PredicateError, Thing
from simfoundry.predicates.thresholds import ENCLOSED, FACING_DOWN_DEG
from simfoundry.predicates.view import View
from simfoundry.predicates.voxels import Cavity, cavity
from simfoundry.scene.frames import Array

SAMPLES = 64
"""Points of a thing whose depth is measured."""


def cavities(view: View, b: Thing) -> list[tuple[int, Cavity]]:
    """The cavities of the links of a thing, by index of the link; a :class:`PredicateError` where there is none."""
    found = [(k, hole) for k, form in view.forms(b) if (hole := cavity(form)) is not None]
    if not found:
        raise PredicateError(f"`{b.name}` has no cavity, so nothing can be inside: its colliders enclose no hollow")
    return found


def depth_in(view: View, a: Thing, k: int, owner: str, hole: Cavity) -> Array:
    """How deep [m] the share :data:`ENCLOSED` of the volume of ``a`` is in a cavity at least, (n,).

    Negative by how far it is outside; where all of it is far outside, by a bound of that.
    """
    X_WB = view.link(owner, k)
    out = np.full(view.n, np.inf)
    middle = X_WB.p + X_WB.R @ hole.middle
    forms = view.forms(a)
    for j, form in forms:  # the balls around both tell most
        X_WA = view.link(a.owner, j)
        centre, radius = form.ball
        gap = np.linalg.norm(X_WA.p + X_WA.R @ centre - middle, axis=1) - radius - hole.size
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


def _counts(view: View, a: Thing) -> list[int]:
    """How many samples each link of a thing gets: by its mass."""
    forms = view.forms(a)
    if len(forms) == 1:
        return [SAMPLES]
    masses = np.array([form.link.mass for _, form in forms])
    return [max(1, round(SAMPLES * float(m))) for m in masses / masses.sum()]


def facing(view: View, k: int, owner: str, hole: Cavity) -> Array:
    """How far the way out of a cavity is from being turned down too far [m], (n,), measured on its depth."""
    X_WB = view.link(owner, k)
    up = rotate(X_WB.R, np.broadcast_to(hole.up, (view.n, 3)))[:, 2]
    return np.asarray(hole.deep * (up - np.cos(np.radians(FACING_DOWN_DEG))))
