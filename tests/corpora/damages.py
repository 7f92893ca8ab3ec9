"""Damage that captures suffer, of which a reconstruction must not pass in silence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import Frame
from simfoundry.geometry.frames import Pose
from tests.corpora.synthetic_tables import PIXELS, SyntheticTable

Rng = np.random.Generator

SAME_CAMERA = Pose.of()


@dataclass(frozen=True, eq=False)
class Damaged:
    """A damaged picture, the unit of its depth as stated [m], and the number of objects in it.

    ``X_camera`` is the pose of the camera that took the picture in the frame of the table's camera.
    """

    frame: Frame
    count: int
    scale: float = 1e-4
    spoil: Callable[[Path], None] = lambda folder: None
    X_camera: Pose = SAME_CAMERA


def _scaled(table: SyntheticTable, rng: Rng) -> Damaged:
    factor = float(rng.choice([0.1, 0.4, 0.5, 2.0, 2.5, 10.0]))
    return Damaged(table.frame, table.count, 1e-4 * factor)


def _noisy(table: SyntheticTable, rng: Rng) -> Damaged:
    noise = rng.normal(size=table.frame.depth.shape) * float(rng.uniform(0.004, 0.03))
    return Damaged(replace(table.frame, depth=table.frame.depth + noise), table.count)


def _offset(table: SyntheticTable, rng: Rng) -> Damaged:
    turn, length = rng.uniform(0, 2 * np.pi), rng.uniform(8, 40)
    shift = round(length * np.sin(turn)), round(length * np.cos(turn))
    return Damaged(replace(table.frame, color=np.roll(table.frame.color, shift, axis=(0, 1))), table.count)


def _cropped(table: SyntheticTable, rng: Rng) -> Damaged:
    h, w = table.truth.shape
    height, width = int(h * rng.uniform(0.4, 0.8)), int(w * rng.uniform(0.4, 0.8))
    top, left = int(rng.integers(h - height)), int(rng.integers(w - width))
    part = np.s_[top : top + height, left : left + width]
    K = table.frame.K - np.array([[0, 0, left], [0, 0, top], [0, 0, 0]])
    frame = Frame(np.ascontiguousarray(table.frame.color[part]), table.frame.depth[part].copy(), K)
    return Damaged(frame, visible_count(table.truth[part]))


def _glass(table: SyntheticTable, rng: Rng) -> Damaged:
    """Without the depth of one object, or with a tenth of it."""
    mask = table.truth == int(rng.integers(1, int(table.truth.max()) + 1))
    lost = mask & (rng.random(mask.shape) < rng.choice([1.0, 0.9]))
    return Damaged(replace(table.frame, depth=np.where(lost, np.nan, table.frame.depth)), table.count)


def _no_table(table: SyntheticTable, _: Rng) -> Damaged:
    """Only the objects have depth."""
    mask = table.truth > 0
    return Damaged(replace(table.frame, depth=np.where(mask, table.frame.depth, np.nan)), table.count)


def _wrong_intrinsics(table: SyntheticTable, rng: Rng) -> Damaged:
    K = table.frame.K.copy()
    if rng.random() < 0.6:
        K[:2, :2] *= float(rng.choice([0.5, 0.7, 1.4, 2.0]))
    else:
        K[:2, 2] += rng.choice([-1, 1], 2) * rng.uniform(100, 220, 2)
    return Damaged(replace(table.frame, K=K), table.count)


def _missing(table: SyntheticTable, rng: Rng) -> Damaged:
    name, kind = str(rng.choice(["color.png", "depth.png"])), int(rng.integers(3))

    def spoil(folder: Path) -> None:
        file = folder / name
        data = file.read_bytes()
        if kind == 0:
            file.unlink()
        else:
            file.write_bytes(data[: len(data) // 2] if kind == 1 else b"")

    return Damaged(table.frame, table.count, spoil=spoil)


def _nothing(table: SyntheticTable, _: Rng) -> Damaged:
    return Damaged(table.frame, table.count)


def _ranges(table: SyntheticTable, _: Rng) -> Damaged:
    """Depth along the rays instead of along the optical axis, as some time-of-flight cameras give it."""
    h, w = table.truth.shape
    K = table.frame.K
    u, v = np.meshgrid((np.arange(w) - K[0, 2]) / K[0, 0], (np.arange(h) - K[1, 2]) / K[1, 1])
    return Damaged(replace(table.frame, depth=table.frame.depth * np.sqrt(1 + u**2 + v**2)), table.count)


def _mirrored(table: SyntheticTable, _: Rng) -> Damaged:
    """The color image mirrored, and the depth not."""
    return Damaged(replace(table.frame, color=np.ascontiguousarray(table.frame.color[:, ::-1])), table.count)


def _quantized(table: SyntheticTable, rng: Rng) -> Damaged:
    """Depth in coarse steps, as after a conversion to 8 bits."""
    step = float(rng.choice([0.008, 0.016, 0.03]))
    return Damaged(replace(table.frame, depth=np.round(table.frame.depth / step) * step), table.count)


def _distorted(table: SyntheticTable, rng: Rng) -> Damaged:
    """Images of a lens whose distortion is not stated."""
    import cv2

    h, w = table.truth.shape
    K = table.frame.K
    u, v = np.meshgrid((np.arange(w) - K[0, 2]) / K[0, 0], (np.arange(h) - K[1, 2]) / K[1, 1])
    bend = 1 + float(rng.choice([-0.35, -0.2, 0.3])) * (u**2 + v**2)
    to = [(x * bend * f + c).astype(np.float32) for x, f, c in ((u, K[0, 0], K[0, 2]), (v, K[1, 1], K[1, 2]))]
    nearest = cv2.INTER_NEAREST
    color = cv2.remap(table.frame.color, to[0], to[1], cv2.INTER_LINEAR)
    depth = cv2.remap(table.frame.depth, to[0], to[1], nearest, borderValue=float("nan"))
    truth = cv2.remap(table.truth.astype(np.float32), to[0], to[1], nearest).astype(np.int32)
    return Damaged(Frame(np.asarray(color, np.uint8), np.asarray(depth, np.float64), K), visible_count(truth))


def _exposed_twice(table: SyntheticTable, rng: Rng) -> Damaged:
    """Two depth images of a moving camera, averaged."""
    shift = int(rng.integers(6, 20))
    moved = np.roll(table.frame.depth, shift, axis=1)
    return Damaged(replace(table.frame, depth=(table.frame.depth + moved) / 2), table.count)


def _torn(table: SyntheticTable, rng: Rng) -> Damaged:
    """Lower rows of an earlier depth image, which a transport error left."""
    row = int(table.truth.shape[0] * rng.uniform(0.3, 0.7))
    depth = table.frame.depth.copy()
    depth[row:] = np.roll(depth, int(rng.integers(30, 90)), axis=1)[row:]
    return Damaged(replace(table.frame, depth=depth), table.count)


def _empty(table: SyntheticTable, _: Rng) -> Damaged:
    """The bare table: nothing is on it."""
    frame = table.frame
    points_W = table.camera.X_WC.apply(frame.points)
    rays = points_W - table.camera.X_WC.p
    ground = table.camera.X_WC.p + rays * (-table.camera.X_WC.p[2] / np.minimum(rays[..., 2:], -1e-6))
    bare = table.camera.X_WC.inverse().apply(ground)[..., 2]
    noise = np.random.default_rng(table.seed).normal(0, 0.0015, bare.shape)
    return Damaged(replace(frame, depth=np.where(table.truth > 0, bare + noise, frame.depth)), 0)


def visible_count(truth: NDArray[np.int32]) -> int:
    """Return the number of objects of which enough pixels are visible to be counted."""
    return int((np.bincount(truth[truth > 0], minlength=1) >= PIXELS).sum())


DAMAGES: dict[str, Callable[[SyntheticTable, Rng], Damaged]] = {
    "scale": _scaled,
    "noise": _noisy,
    "offset": _offset,
    "crop": _cropped,
    "glass": _glass,
    "no table": _no_table,
    "intrinsics": _wrong_intrinsics,
    "missing": _missing,
    "none": _nothing,
}
"""Kinds for which checks were made."""

UNSEEN: dict[str, Callable[[SyntheticTable, Rng], Damaged]] = {
    "ranges": _ranges,
    "mirrored": _mirrored,
    "quantized": _quantized,
    "distorted": _distorted,
    "exposed twice": _exposed_twice,
    "torn": _torn,
    "empty": _empty,
}
"""Kinds that were added when the first checks were complete."""
