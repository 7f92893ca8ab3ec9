"""Reset grid: a cell for each object, drawn without replacement, and a random position within it."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import numpy as np

from simfoundry.spec.models.task import Reset, ResetRegion

GridCell = tuple[int, int]
"""A cell of a grid, by its indices along x and y from 0."""


def deal(reset: Reset, seed: int, block: int) -> dict[str, list[GridCell]]:
    """Deal the cells of each object for a block of starts, one start per cell of the grid: a permutation of all cells.

    The cells of one object do not depend on the other objects.
    """
    along_x, along_y = reset.grid
    cells = [(i, j) for i in range(along_x) for j in range(along_y)]
    return {name: [cells[k] for k in _generator(seed, name, block).permutation(len(cells))] for name in reset.objects}


def draws(name: str, seed: int, start: int) -> np.random.Generator:
    """Return the generator of an object's positions in its cell for one start, used for successive tries."""
    return _generator(seed, name, start, 1)


def sample(
    region: ResetRegion, grid: Sequence[int], cell: GridCell, rng: np.random.Generator
) -> tuple[float, float, float]:
    """Sample a position x, y [m] in a cell and a rotation [deg] in its range, all uniform."""
    (low_x, high_x), (low_y, high_y) = bounds(region, grid, cell)
    share = rng.random(3)
    low_yaw, high_yaw = region.yaw_deg
    x, y, yaw = low_x + share[0] * (high_x - low_x), low_y + share[1] * (high_y - low_y), share[2]
    return float(x), float(y), float(low_yaw + yaw * (high_yaw - low_yaw))


def bounds(region: ResetRegion, grid: Sequence[int], cell: GridCell) -> tuple[tuple[float, float], tuple[float, float]]:
    """Ranges of x and y of a cell [m]."""
    spans = []
    for (low, high), count, k in zip((region.x, region.y), grid, cell, strict=True):
        width = (high - low) / count
        spans.append((low + k * width, low + (k + 1) * width))
    return spans[0], spans[1]


def _generator(seed: int, name: str, *more: int) -> np.random.Generator:
    # A checksum of the name, because Python's own hash differs between processes.
    return np.random.default_rng([seed, zlib.crc32(name.encode()), *more])
