"""How fast a path is gone: postures at each control step, from rest to rest."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from simfoundry.evaluate.expert.reach import Path
from simfoundry.geometry.frames import Array, Pose

JOINT, HAND = 1.1, 0.35
"""Greatest speeds of a joint [rad/s] and of the hand [m/s]: half of what a Panda allows."""

AROUND = 0.4
"""Share of both on a path with corners: servos that lag by 0.1 s cut them, by 3 cm at full speed."""

CAREFUL = 0.12
"""Greatest speed of the hand [m/s] near things."""

RAMP = 0.35
"""Seconds from rest to full speed."""


def paced(
    path: Path, hand: Callable[[Array], Pose], hz: float, speed: float = HAND, joint: float = JOINT
) -> list[Array]:
    """Postures at each step of a control of ``hz`` on a path, no faster than ``speed`` [m/s] and ``joint`` [rad/s]."""
    points = _dense(path)
    places = np.array([hand(q).p for q in points])
    joints = np.abs(np.diff(points, axis=0)).max(axis=1, initial=0.0) / joint
    moved = np.linalg.norm(np.diff(places, axis=0), axis=1) / speed
    at = np.concatenate([[0.0], np.cumsum(np.maximum(np.maximum(joints, moved), 1e-9))])
    length = float(at[-1])
    # From rest to rest: a trapezoid of speed, or a triangle where the way is short.
    ramp = min(RAMP, float(np.sqrt(length * RAMP)))
    top = ramp / RAMP
    total = length / top + ramp if ramp == RAMP else 2 * ramp
    count = max(1, int(np.ceil(total * hz)))
    time = np.linspace(0.0, total, count + 1)[1:]
    gone = np.where(
        time < ramp,
        time**2 / (2 * RAMP),
        np.where(time > total - ramp, length - (total - time) ** 2 / (2 * RAMP), top * (time - ramp / 2)),
    )
    return [np.array([np.interp(t, at, points[:, j]) for j in range(points.shape[1])]) for t in gone]


def _dense(path: Path) -> Array:
    """The path with postures close enough for the speed of the hand to be seen, shape (k, n)."""
    found = [path[0]]
    for a, b in pairwise(path):
        count = max(1, int(np.ceil(np.abs(b - a).max() / 0.05)))
        found += [a + (b - a) * k / count for k in range(1, count + 1)]
    return np.array(found)
