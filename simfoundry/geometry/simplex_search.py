"""Minimization without derivatives, by the simplex search of Nelder and Mead (1965)."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from simfoundry.geometry.frames import Array

# Factors by which a simplex is stretched and shrunk, from the paper; a reflection keeps its size.
STRETCH, SHRINK = 2.0, 0.5


class _SpentError(Exception):
    """Raised if there are no evaluations left."""


def minimize_simplex(
    cost: Callable[[Array], float], simplex: Array, evaluations: int, near: float, flat: float
) -> tuple[float, Array]:
    """Minimize ``cost``, starting from the corners of a simplex. The result is deterministic.

    It is that of ``scipy.optimize.minimize`` with the method Nelder-Mead, to the last bit. That function takes half
    as long again between evaluations, of which a fit makes thousands, and 0.1 s to import.

    Args:
        cost: The function of n parameters.
        simplex: The corners, shape (n + 1, n).
        evaluations: The maximum number of evaluations.
        near: The search ends if no parameter of another corner differs by more than this from those of the best one.
        flat: In addition, no cost may differ by more than this.

    Returns:
        The minimum cost and its parameters, shape (n,).
    """
    corners = np.array(simplex, dtype=np.float64)
    costs = np.full(len(corners), np.inf)
    left = evaluations

    def value(x: Array) -> float:
        nonlocal left
        if left <= 0:
            raise _SpentError
        left -= 1
        return float(cost(x.copy()))

    with suppress(_SpentError):
        for k, corner in enumerate(corners):
            costs[k] = value(corner)
    corners, costs = _sorted(*_sorted(corners, costs))
    while left > 0:
        if np.abs(corners[1:] - corners[0]).max() <= near and np.abs(costs[0] - costs[1:]).max() <= flat:
            break
        with suppress(_SpentError):
            _replace_worst(value, corners, costs)
        corners, costs = _sorted(corners, costs)
    return float(costs.min()), corners[0]


def _replace_worst(value: Callable[[Array], float], corners: Array, costs: Array) -> None:
    """Replace the worst corner of a sorted simplex in place by a better one, or else shrink the simplex to the best.

    Raises:
        _SpentError: There are no evaluations left.
    """
    middle, worst = np.add.reduce(corners[:-1], 0) / (len(corners) - 1), corners[-1]
    mirrored = 2 * middle - worst
    cost = value(mirrored)
    if cost < costs[0]:
        farther = (1 + STRETCH) * middle - STRETCH * worst
        other = value(farther)
        corners[-1], costs[-1] = (farther, other) if other < cost else (mirrored, cost)
        return
    if cost < costs[-2]:
        corners[-1], costs[-1] = mirrored, cost
        return
    if cost < costs[-1]:
        nearer = (1 + SHRINK) * middle - SHRINK * worst
        other = value(nearer)
        is_better = other <= cost
    else:
        nearer = (1 - SHRINK) * middle + SHRINK * worst
        other = value(nearer)
        is_better = other < costs[-1]
    if is_better:
        corners[-1], costs[-1] = nearer, other
        return
    for k in range(1, len(corners)):
        corners[k] = corners[0] + SHRINK * (corners[k] - corners[0])
        costs[k] = value(corners[k])


def _sorted(corners: Array, costs: Array) -> tuple[Array, Array]:
    """Return corners and their costs in the order of the costs."""
    order = np.argsort(costs)
    return corners[order], costs[order]
