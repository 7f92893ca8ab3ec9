"""How narrow a thing is where fingers can close on it from above: lines across it, as a gripper's would be."""

from __future__ import annotations

import math

import numpy as np

from simfoundry.geometry.crossings import Span, bounds, crossings
from simfoundry.geometry.frames import Array
from simfoundry.scene.model import SceneObject
from simfoundry.scene.object_shapes import solid
from simfoundry.scene.state import SceneState

YAWS = 12
"""Directions of closing over half a turn."""

ACROSS, ALONG = 15, 10
"""Lines across a thing, and along its height."""

FACING = 0.9
"""Fingers meet surfaces that face them at least this much: the cosine, within the cone of friction."""

FINGER, CLEARANCE = 0.012, 0.004
"""How thick a finger is, and the room that it leaves beside the thing when it comes [m]."""

THINNEST = 0.001
"""What is thinner is not felt between fingers [m]."""


def grip_width(item: SceneObject) -> float:
    """The smallest width [m] of the thing, as it stands, that two fingers from above can hold; inf where there is none.

    A wall counts where a finger has room within: what lies in the way of the fingers is part of the span.
    """
    state = SceneState.of({item.name: item.X_WO}, {})
    shape = solid(item, state)
    best = math.inf
    for k in range(YAWS):
        angle = k * math.pi / YAWS
        closing = np.array([math.cos(angle), math.sin(angle), 0.0])
        axes = np.column_stack([np.array([-closing[1], closing[0], 0.0]), closing, [0.0, 0.0, 1.0]])
        low, high = bounds(shape, axes)
        starts = _grid(low, high) @ axes.T
        best = min(best, *(_narrowest(spans) for spans in crossings(shape, starts, closing)), best)
    return best


def _grid(low: Array, high: Array) -> Array:
    """Starts of the lines in the axes of the hand, shape (n, 3); the lowest part of a thing is out of reach."""
    across = low[0] + (np.arange(ACROSS) + 0.5) * (high[0] - low[0]) / ACROSS
    up = low[2] + (np.arange(ALONG) + 0.5) * (high[2] - low[2]) / ALONG
    a, h = np.meshgrid(across, up[ALONG // 3 :], indexing="ij")
    return np.column_stack([a.ravel(), np.full(a.size, (low[1] + high[1]) / 2), h.ravel()])


def _narrowest(spans: list[Span]) -> float:
    """The least width on one line between a first and a last piece that have room for a finger on both sides."""
    room = 2 * CLEARANCE + FINGER
    best = math.inf
    for i, first in enumerate(spans):
        if i and first.start - spans[i - 1].end < room:
            continue
        for j in range(i, len(spans)):
            last = spans[j]
            if j + 1 < len(spans) and spans[j + 1].start - last.end < room:
                continue
            width = last.end - first.start
            if width >= THINNEST and min(first.facing, last.facing) >= FACING:
                best = min(best, width)
    return best
