"""How far fingers must open to take a thing from above, measured on its real shape."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.cavity import distances
from simfoundry.geometry.frames import Pose, quat_from_rpy
from simfoundry.scene.model import SceneObject
from simfoundry.scene.object_shapes import hulls

TURNS = 6
"""Ways in which fingers close, over half a turn."""

CELLS, FINEST = 48, 0.0015
"""Cells along the longest side of a thing, and the side of one at least [m]."""

DEEP = 0.04
"""How far down from its top fingers take a thing [m], or at its middle where it is lower."""

FINGER = 0.012
"""How thick a finger is [m]: so much must be free on either side, all the way from above."""

PAD = 0.016
"""How wide a finger is [m]; of a small thing it meets a quarter."""

EVEN = 0.004
"""Over a finger's width the side of what it takes may recede by so much [m]: off its middle, a ball slips away."""

Mask = NDArray[np.bool_]


def grip_width(item: SceneObject) -> float:
    """The narrowest that fingers from above can take of a thing where it stands [m]; inf where there is no such place.

    Fingers go straight down on both sides of what is between them, into a bowl if need be: of a bowl they take the
    wall, of a ball its equator. It is measured on cells, so it may be off by one of them: 1 mm for a cup.
    """
    return min((_along(item, math.pi * k / TURNS) for k in range(TURNS)), default=math.inf)


def _along(item: SceneObject, yaw: float) -> float:
    turned = Pose.of(q=quat_from_rpy(0.0, 0.0, -yaw)) @ item.X_WO
    parts = hulls(replace(item, X_WO=turned))
    if not len(parts.corners):
        return math.inf
    spans = np.array([parts.extent(axis) for axis in np.eye(3)])
    size = spans[:, 1] - spans[:, 0]
    cell = max(float(size.max()) / CELLS, FINEST)
    rim = max(2, math.ceil(FINGER / cell) + 1)
    low = spans[:, 0] + np.array([0.0, -rim * cell, 0.5 * cell])
    shape = np.ceil(size / cell).astype(int) + np.array([1, 2 * rim + 1, 0])
    depth = min(DEEP, float(size[2]) / 2)
    first = min(max(round((float(size[2]) - depth) / cell - 0.5), 0), int(shape[2]) - 1)
    filled = distances(parts, low, cell, np.maximum(shape, 1)) <= 0.0
    seen = np.asarray(filled[:, :, first:].any(axis=2))
    wide = min(PAD, float(size[0]) / 4) / cell
    return _narrowest(seen, math.ceil(FINGER / cell), max(1, round(wide)), max(1, math.floor(EVEN / cell))) * cell


def _narrowest(seen: Mask, finger: int, pad: int, even: int) -> float:
    """Cells of the shortest run along the second axis that fingers can take; inf where there is none.

    Within a pad's width the run is everywhere, its ends are off by ``even`` cells at most, and beside it ``finger``
    cells are free.
    """
    best = math.inf
    for k in range(len(seen) - pad + 1):
        some, every = (np.asarray(found(seen[k : k + pad], axis=0)) for found in (np.any, np.all))
        runs = _runs(some)
        for n, (start, end) in enumerate(runs):
            before = start - (runs[n - 1][1] if n else 0)
            after = (runs[n + 1][0] if n + 1 < len(runs) else len(some)) - end
            if before < finger or after < finger or end - start >= best:
                continue
            solid = _runs(every[start:end])
            if len(solid) == 1 and solid[0][0] <= even and end - start - solid[0][1] <= even:
                best = end - start
    return best


def _runs(row: Mask) -> list[tuple[int, int]]:
    """Where a row is true: first, and one beyond the last."""
    edges: NDArray[Any] = np.flatnonzero(np.diff(np.pad(row, 1).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
