"""Damage of a second list: faults of drivers, recorders and people."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from simfoundry.capture.frame import Frame
from simfoundry.geometry.frames import Array, Pose
from tests.corpora.damages import Damaged, Rng
from tests.corpora.synthetic_tables import SyntheticTable, synthetic_table

HALF_TURN = Pose.of(q=(0.0, 0.0, 0.0, 1.0))
"""The rotation of a camera by 180 degrees about its optical axis, as wxyz."""

OTHER = 500_000
"""Distance between the seed of a table and of the one whose depth it gets, larger than any series of seeds."""


def _depth_mirrored(table: SyntheticTable, _: Rng) -> Damaged:
    """The depth mirrored, and the color image not."""
    return Damaged(replace(table.frame, depth=np.ascontiguousarray(table.frame.depth[:, ::-1])), table.count)


def _channels_swapped(table: SyntheticTable, _: Rng) -> Damaged:
    """Blue, green and red instead of red, green and blue."""
    return Damaged(replace(table.frame, color=np.ascontiguousarray(table.frame.color[..., ::-1])), table.count)


def _coarse_steps(table: SyntheticTable, _: Rng) -> Damaged:
    """Depth in steps of 2 cm."""
    return Damaged(replace(table.frame, depth=np.round(table.frame.depth / 0.02) * 0.02), table.count)


def _depth_of_another(table: SyntheticTable, _: Rng) -> Damaged:
    """The depth of another table."""
    return Damaged(replace(table.frame, depth=synthetic_table(table.seed + OTHER).frame.depth), table.count)


def _rolled(table: SyntheticTable, rng: Rng) -> Damaged:
    """Both images rolled by half of their width, as when a reader loses the start of a row."""
    shift = table.truth.shape[1] // 2 + int(rng.integers(-40, 40))
    color, depth = np.roll(table.frame.color, shift, axis=1), np.roll(table.frame.depth, shift, axis=1)
    return Damaged(replace(table.frame, color=color, depth=depth), table.count)


def _saturated(table: SyntheticTable, rng: Rng) -> Damaged:
    """An overexposed color image."""
    bright = np.clip(table.frame.color * rng.uniform(2.5, 6), 0, 255).astype(np.uint8)
    return Damaged(replace(table.frame, color=bright), table.count)


def _blurred(table: SyntheticTable, rng: Rng) -> Damaged:
    """Both images of a camera that moves sideways during the exposure."""
    import cv2

    length = int(rng.integers(9, 30))
    color = np.asarray(cv2.blur(table.frame.color, (length, 1)), np.uint8)
    known = np.isfinite(table.frame.depth)
    weight = cv2.blur(known.astype(np.float64), (length, 1))
    total = cv2.blur(np.where(known, table.frame.depth, 0.0), (length, 1))
    depth = np.where(known & (weight > 0), total / np.maximum(weight, 1e-9), np.nan)
    return Damaged(replace(table.frame, color=color, depth=depth), table.count)


def _banded(table: SyntheticTable, rng: Rng) -> Damaged:
    """Vertical bands without depth, as beside a lamp or below a projector that is partly covered."""
    depth: Array = table.frame.depth.copy()
    for left in rng.integers(0, depth.shape[1] - 24, 8):
        depth[:, left : left + int(rng.integers(6, 24))] = np.nan
    return Damaged(replace(table.frame, depth=depth), table.count)


def _turned(table: SyntheticTable, _: Rng) -> Damaged:
    """Both images of a camera that hangs upside down."""
    h, w = table.truth.shape
    K = table.frame.K.copy()
    K[:2, 2] = w - 1 - K[0, 2], h - 1 - K[1, 2]
    color = np.ascontiguousarray(table.frame.color[::-1, ::-1])
    return Damaged(Frame(color, table.frame.depth[::-1, ::-1].copy(), K), table.count, X_camera=HALF_TURN)


def _unusual_unit(table: SyntheticTable, rng: Rng) -> Damaged:
    """Depth in a unit that no camera has, by which everything is 1.5 times too large or small."""
    return Damaged(table.frame, table.count, 1e-4 * float(rng.choice([1.5, 1 / 1.5])))


def _unequal_pixels(table: SyntheticTable, rng: Rng) -> Damaged:
    """Intrinsics of an image that was stretched in one direction only."""
    K = table.frame.K.copy()
    K[int(rng.integers(2))] *= float(rng.choice([0.75, 1.33]))
    return Damaged(replace(table.frame, K=K), table.count)


def _slightly_wrong_intrinsics(table: SyntheticTable, rng: Rng) -> Damaged:
    """The focal length of another camera."""
    K = table.frame.K.copy()
    K[:2, :2] *= float(rng.choice([0.8, 1.25]))
    return Damaged(replace(table.frame, K=K), table.count)


ATTACKS: dict[str, Callable[[SyntheticTable, Rng], Damaged]] = {
    "depth mirrored": _depth_mirrored,
    "channels swapped": _channels_swapped,
    "coarse steps": _coarse_steps,
    "other depth": _depth_of_another,
    "rolled": _rolled,
    "saturated": _saturated,
    "blurred": _blurred,
    "banded": _banded,
    "turned": _turned,
    "unusual unit": _unusual_unit,
    "unequal pixels": _unequal_pixels,
    "focal length": _slightly_wrong_intrinsics,
}
