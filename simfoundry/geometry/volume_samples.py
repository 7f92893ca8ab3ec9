"""Deterministic points distributed evenly over the volume of a link."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from simfoundry.geometry.cavity import outside_part
from simfoundry.geometry.form import Form
from simfoundry.geometry.frames import Array

TRIED = 512
"""Number of candidate points in the box of each part."""


def volume_samples(form: Form, count: int) -> Array:
    """About ``count`` points [m] in the link's frame, shape (k, 3); overlapping parts count twice."""
    return _samples(form, count)


@lru_cache(maxsize=256)
def _samples(form: Form, count: int) -> Array:
    unit = _spread_points()
    low, high, _, _ = form.pieces
    inside = []
    volume = np.zeros(len(low))
    for k in range(len(low)):
        points = low[k] + unit * (high[k] - low[k])
        points = points[outside_part(form.parts, k, points) <= 1e-9]
        inside.append(points if len(points) else ((low[k] + high[k]) / 2)[None])
        volume[k] = float(np.prod(high[k] - low[k])) * len(points) / TRIED
    share = volume / volume.sum() if volume.sum() > 0 else np.full(len(low), 1 / len(low))
    ends = np.round(np.cumsum(share) * count).astype(int)
    counts = np.diff(ends, prepend=0)
    return np.concatenate([points[: max(int(n), 0)] for points, n in zip(inside, counts, strict=True)])


@lru_cache(maxsize=1)
def _spread_points() -> Array:
    """Halton sequence in the unit cube, shape (TRIED, 3)."""
    return np.array([[_radical(k, base) for base in (2, 3, 5)] for k in range(1, TRIED + 1)])


def _radical(k: int, base: int) -> float:
    value, share = 0.0, 1.0 / base
    while k:
        k, digit = divmod(k, base)
        value += digit * share
        share /= base
    return value
