"""Reset grid: a cell for each object, drawn without replacement, and a random position in it."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import numpy as np

from simfoundry.spec.models.task import Reset, ResetRegion

GridCell = tuple[int, int]
"""A cell of a grid, counted from 0 along x and along y."""


def deal(reset: Reset, seed: int, block: int) -> dict[str, list[GridCell]]:
    """The cells of each object in a block of starts, one start for each cell of the grid: a permutation of them all.

    What one object gets does not depend on which others there are.
    """
    along_x, along_y = reset.grid
    cells = [(i, j) for i in range(along_x) for j in range(along_y)]
    return {name: [cells[k] for k in _generator(seed, name, block).permutation(len(cells))] for name in reset.objects}


def draws(name: str, seed: int, start: int) -> np.random.Generator:
    """The generator of where in its cell an object starts in one start, try after try."""
    return _generator(seed, name, start, 1)


def sample(
    region: ResetRegion, grid: Sequence[int], cell: GridCell, rng: np.random.Generator
) -> tuple[float, float, float]:
    """A position x, y [m] in a cell and a turn [deg] in its range, all uniform."""
    (low_x, high_x), (low_y, high_y) = bounds(region, grid, cell)
    share = rng.random(3)
    low_yaw, high_yaw = region.yaw_deg
    x, y, yaw = low_x + share[0] * (high_x - low_x), low_y + share[1] * (high_y - low_y), share[2]
    return float(x), float(y), float(low_yaw + yaw * (high_yaw - low_yaw))


def bounds(region: ResetRegion, grid: Sequence[int], cell: GridCell) -> tuple[tuple[float, float], tuple[float, float]]:
    """The lowest and the highest x and y of a cell [m]."""
    spans = []
    for (low, high), count, k in zip((region.x, region.y), grid, cell, strict=True):
        width = (high - low) / count
        spans.append((low + k * width, low + (k + 1) * width))
    return spans[0], spans[1]


def _generator(seed: int, name: str, *more: int) -> np.random.Generator:
    # A checksum of the name, because Python's own hash differs from process to process.
    return np.random.default_rng([seed, zlib.crc32(name.encode()), *more])
