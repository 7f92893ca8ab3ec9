"""Upper bound on the share of an object that fits into a cavity in any orientation, without physics."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from simfoundry.geometry.cavity import Cavity
from simfoundry.geometry.form import Form
from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.volume_samples import volume_samples
from simfoundry.predicates.judging.thresholds import ENCLOSED

TURNS = 240
"""Number of sampled orientations, about 25 degrees apart."""

SAMPLES = 64
"""Points of the thing, as many as the predicate ``Inside`` asks about."""

SURE = 0.4
"""An object whose best share is no larger cannot reach :data:`ENCLOSED` in an orientation between two samples."""
assert SURE < ENCLOSED


def cavity_extents(hole: Cavity) -> Array:
    """The sides [m] of the box around a cavity, walls included, shape (3,)."""
    cells = np.argwhere(hole.depth > 0)
    return np.asarray((np.ptp(cells, axis=0) + 1) * hole.cell)


def largest_share(forms: Iterable[Form], extents: Array) -> float:
    """Largest share of an object's volume that fits into a box of the given extents [m], in any sampled orientation."""
    found = [volume_samples(form, SAMPLES) for form in forms]
    points = np.concatenate(found)
    points = points[:: max(1, len(points) // SAMPLES)]
    if (np.sort(np.ptp(points, axis=0)) <= np.sort(extents)).all():
        return 1.0
    best = 0
    for quaternion in _orientations():
        turned = Pose.of(q=quaternion).apply(points)
        within = [_covered(turned[:, k], float(extents[k])) for k in range(3)]
        for row in within[0]:  # windows that begin at each point along x; those along y and z together
            if row.sum() > best:
                some = row.nonzero()[0]
                best = max(best, int((within[1][:, some].astype(float) @ within[2][:, some].T.astype(float)).max()))
        if best == len(points):
            break
    return best / len(points)


def _covered(values: Array, length: float) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Mask of the values covered by a window that starts at each value, shape (n, n)."""
    away = values[None, :] - values[:, None]
    return np.asarray((away >= 0) & (away <= length))


def _orientations() -> Array:
    """Unit quaternions (w, x, y, z) spread evenly over all rotations, shape (TURNS, 4): a super-Fibonacci spiral.

    After Alexa, "Super-Fibonacci Spirals: Fast, Low-Discrepancy Sampling of SO(3)", CVPR 2022.
    """
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(TURNS) + 0.5
    r, big = np.sqrt(s / TURNS), np.sqrt(1 - s / TURNS)
    alpha, beta = 2 * np.pi * s / phi, 2 * np.pi * s / psi
    return np.column_stack([r * np.sin(alpha), r * np.cos(alpha), big * np.sin(beta), big * np.cos(beta)])
