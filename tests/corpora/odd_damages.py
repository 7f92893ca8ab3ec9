"""Damage of a third list: faults of sensors, of filters and of recordings of robots at work."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import Frame
from simfoundry.capture.synthesize import SENSORS, simulate_frame
from simfoundry.geometry.frames import Array, Pose, quat_from_rpy
from simfoundry.render.raycast import raycast
from tests.corpora.damages import Damaged, Rng, visible_count
from tests.corpora.synthetic_tables import SyntheticTable

SIDEWAYS = Pose.of(q=quat_from_rpy(0.0, 0.0, -np.pi / 2))
"""The rotation of a camera whose images were turned by 90 degrees."""


def _with_depth(table: SyntheticTable, depth: Array) -> Damaged:
    return Damaged(replace(table.frame, depth=depth), table.count)


def _constant_error(table: SyntheticTable, rng: Rng) -> Damaged:
    """All depth too large or too small by the same length."""
    return _with_depth(table, table.frame.depth + float(rng.choice([-0.05, -0.03, 0.03, 0.05])))


def _disparity_error(table: SyntheticTable, rng: Rng) -> Damaged:
    """All inverse depth too large or too small by the same amount, as of a stereo camera that was bent."""
    return _with_depth(table, 1 / (1 / table.frame.depth + float(rng.choice([-0.15, -0.08, 0.08, 0.15]))))


def _turned_sideways(table: SyntheticTable, _: Rng) -> Damaged:
    """Both images turned by 90 degrees, and the intrinsics with them, as of a phone that is held upright."""
    h = table.truth.shape[0]
    (fx, cx), (fy, cy) = table.frame.K[0, [0, 2]], table.frame.K[1, [1, 2]]
    K = np.array([[fy, 0, h - 1 - cy], [0, fx, cx], [0, 0, 1.0]])
    color, depth = np.rot90(table.frame.color, -1), np.rot90(table.frame.depth, -1)
    frame = Frame(np.ascontiguousarray(color), np.ascontiguousarray(depth), K)
    return Damaged(frame, table.count, X_camera=SIDEWAYS)


def _rolled_down(table: SyntheticTable, rng: Rng) -> Damaged:
    """Both images rolled by a part of their height, as when a reader loses the start of an image."""
    shift = int(table.truth.shape[0] * rng.uniform(0.25, 0.7))
    color, depth = np.roll(table.frame.color, shift, axis=0), np.roll(table.frame.depth, shift, axis=0)
    return Damaged(replace(table.frame, color=color, depth=depth), table.count)


def _rolled_slightly(table: SyntheticTable, rng: Rng) -> Damaged:
    """Both images rolled by a small part of their width."""
    shift = int(table.truth.shape[1] * rng.uniform(0.08, 0.25)) * int(rng.choice([-1, 1]))
    color, depth = np.roll(table.frame.color, shift, axis=1), np.roll(table.frame.depth, shift, axis=1)
    return Damaged(replace(table.frame, color=color, depth=depth), table.count)


def _view_of(table: SyntheticTable, X_moved: Pose, rng: Rng) -> Damaged:
    """The depth of a camera at a pose in the frame of the table's."""
    camera = replace(table.camera, X_WC=table.camera.X_WC @ X_moved)
    return _with_depth(table, simulate_frame(raycast(table.scene, camera), rng, SENSORS[table.sensor]).depth)


def _late_depth(table: SyntheticTable, rng: Rng) -> Damaged:
    """The depth of a moment later, when the camera has moved on."""
    way = rng.normal(size=3)
    turn = np.radians(rng.uniform(-4, 4, 3))
    return _view_of(table, Pose.of(way / np.linalg.norm(way) * rng.uniform(0.03, 0.1), quat_from_rpy(*turn)), rng)


def _other_view(table: SyntheticTable, rng: Rng) -> Damaged:
    """The depth of a second camera on the same table."""
    around = Pose.of((0.0, 0.0, 0.0), quat_from_rpy(0.0, 0.0, float(rng.choice([-1, 1]) * rng.uniform(0.5, 2.5))))
    camera = replace(table.camera, X_WC=around @ table.camera.X_WC)
    return _with_depth(table, simulate_frame(raycast(table.scene, camera), rng, SENSORS[table.sensor]).depth)


def _unit_of_a_half(table: SyntheticTable, rng: Rng) -> Damaged:
    """One half of the image in another unit."""
    depth = table.frame.depth.copy()
    h, w = depth.shape
    halves = (np.s_[: h // 2], np.s_[h // 2 :], np.s_[:, : w // 2], np.s_[:, w // 2 :])
    depth[halves[int(rng.integers(4))]] *= float(rng.choice([0.1, 0.5, 0.9, 1.1, 2.0, 10.0]))
    return _with_depth(table, depth)


def _filtered(table: SyntheticTable, rng: Rng) -> Damaged:
    """Depth after a median over a large window, which rounds and merges objects."""
    from scipy.ndimage import median_filter

    size = int(rng.choice([15, 25, 41]))
    return _with_depth(table, median_filter(np.nan_to_num(table.frame.depth, nan=9.0), size))


def _widened(table: SyntheticTable, rng: Rng) -> Damaged:
    """Depth in which what is near has grown, as after filling gaps with the nearest reading."""
    from scipy.ndimage import minimum_filter

    size = int(rng.choice([9, 15, 25]))
    depth = minimum_filter(np.where(np.isfinite(table.frame.depth), table.frame.depth, 9.0), size)
    return _with_depth(table, depth)


def _enlarged(table: SyntheticTable, rng: Rng) -> Damaged:
    """Depth of a small image that was enlarged smoothly, so that silhouettes become slopes."""
    import cv2

    factor = int(rng.choice([8, 12, 20]))
    full = np.where(np.isfinite(table.frame.depth), table.frame.depth, np.nanmedian(table.frame.depth))
    h, w = full.shape
    small = cv2.resize(full, (w // factor, h // factor), interpolation=cv2.INTER_AREA)
    return _with_depth(table, np.asarray(cv2.resize(small, (w, h), interpolation=cv2.INTER_LINEAR), np.float64))


def _arm(table: SyntheticTable, rng: Rng) -> Damaged:
    """A robot's arm or a person's in front of the table, from a border of the image to an object."""
    near = _arm_mask(table, rng)
    depth = np.where(near, np.nanmedian(table.frame.depth) - 0.25 + rng.normal(0, 0.002, near.shape), table.frame.depth)
    color = np.where(near[..., None], rng.integers(40, 220, 3), table.frame.color).astype(np.uint8)
    count = visible_count(np.where(near, 0, table.truth))
    return Damaged(replace(table.frame, color=color, depth=depth), count)


def _arm_erased(table: SyntheticTable, rng: Rng) -> Damaged:
    """A robot's arm that was masked out: black and without depth."""
    near = _arm_mask(table, rng)
    color = np.where(near[..., None], 0, table.frame.color).astype(np.uint8)
    count = visible_count(np.where(near, 0, table.truth))
    return Damaged(replace(table.frame, color=color, depth=np.where(near, np.nan, table.frame.depth)), count)


def _arm_mask(table: SyntheticTable, rng: Rng) -> NDArray[np.bool_]:
    import cv2

    h, w = table.truth.shape
    rows, columns = np.nonzero(table.truth == int(rng.integers(1, int(table.truth.max()) + 1)))
    end = int(columns.mean()), int(rows.mean())
    start = [(0, int(rng.integers(h))), (w - 1, int(rng.integers(h))), (int(rng.integers(w)), 0)][int(rng.integers(3))]
    mask = np.zeros((h, w), np.uint8)
    cv2.line(mask, start, end, 1, thickness=int(rng.integers(40, 90)))
    return mask > 0


def _striped(table: SyntheticTable, rng: Rng) -> Damaged:
    """Horizontal bands nearer and farther, as a flickering light leaves in a time-of-flight camera."""
    rows = np.arange(table.truth.shape[0])
    wave = np.sign(np.sin(rows * 2 * np.pi / float(rng.uniform(30, 120)))) * float(rng.uniform(0.008, 0.03))
    return _with_depth(table, table.frame.depth + wave[:, None])


def _wavy(table: SyntheticTable, rng: Rng) -> Damaged:
    """Rows of the depth shifted to and fro, as of a rolling shutter that shakes."""
    depth: Array = table.frame.depth.copy()
    period, size, phase = rng.uniform(80, 300), rng.uniform(10, 30), rng.uniform(0, 2 * np.pi)
    for row in range(len(depth)):
        depth[row] = np.roll(depth[row], round(size * np.sin(2 * np.pi * row / period + phase)))
    return _with_depth(table, depth)


def _wrapped(table: SyntheticTable, rng: Rng) -> Damaged:
    """Depth that begins again at a limit, as the phase of a time-of-flight camera or a counter does."""
    limit = float(rng.uniform(0.7, 1.1)) * float(np.nanmedian(table.frame.depth))
    return _with_depth(table, np.mod(table.frame.depth, limit))


def _clipped(table: SyntheticTable, rng: Rng) -> Damaged:
    """Depth that is lost, or is the limit, where it is nearer than a limit."""
    low = float(np.nanquantile(table.frame.depth[table.truth > 0], rng.uniform(0.3, 0.7)))
    lost = np.nan if rng.random() < 0.5 else low
    return _with_depth(table, np.where(table.frame.depth < low, lost, table.frame.depth))


def _resized(table: SyntheticTable, rng: Rng) -> Damaged:
    """Depth with a wider or narrower field of view than the color image."""
    import cv2

    factor = float(rng.choice([0.8, 0.9, 1.1, 1.25]))
    h, w = table.truth.shape
    to = np.array([[factor, 0, (1 - factor) * w / 2], [0, factor, (1 - factor) * h / 2]])
    depth = cv2.warpAffine(table.frame.depth, to, (w, h), flags=cv2.INTER_NEAREST, borderValue=float("nan"))
    return _with_depth(table, np.asarray(depth))


def _rotated(table: SyntheticTable, rng: Rng) -> Damaged:
    """Depth that is rotated in the image against the color image."""
    import cv2

    h, w = table.truth.shape
    to = cv2.getRotationMatrix2D((w / 2, h / 2), float(rng.choice([-1, 1]) * rng.uniform(4, 15)), 1.0)
    depth = cv2.warpAffine(table.frame.depth, to, (w, h), flags=cv2.INTER_NEAREST, borderValue=float("nan"))
    return _with_depth(table, np.asarray(depth))


def _flattened(table: SyntheticTable, rng: Rng) -> Damaged:
    """Up to three objects that the depth camera does not see: the readings are of the table behind them."""
    numbers = np.unique(table.truth[table.truth > 0])
    chosen = rng.permutation(numbers)[: min(3, len(numbers) - 1)]
    X_WC = table.camera.X_WC
    rays = X_WC.apply(table.frame.points) - X_WC.p
    ground = X_WC.inverse().apply(X_WC.p + rays * (-X_WC.p[2] / np.minimum(rays[..., 2:], -1e-6)))[..., 2]
    noise = rng.normal(0, 0.0015, ground.shape)
    return _with_depth(table, np.where(np.isin(table.truth, chosen), ground + noise, table.frame.depth))


def _salted(table: SyntheticTable, rng: Rng) -> Damaged:
    """A part of the readings is anything."""
    wrong = rng.random(table.truth.shape) < float(rng.uniform(0.03, 0.25))
    return _with_depth(table, np.where(wrong, rng.uniform(0.3, 2.0, wrong.shape), table.frame.depth))


def _sparse(table: SyntheticTable, rng: Rng) -> Damaged:
    """Most readings are lost, or every other row."""
    lost = rng.random(table.truth.shape) < float(rng.choice([0.5, 0.8, 0.95]))
    if rng.random() < 0.4:
        lost = np.broadcast_to(np.arange(len(lost))[:, None] % int(rng.choice([2, 4])) > 0, lost.shape)
    return _with_depth(table, np.where(lost, np.nan, table.frame.depth))


def _compressed(table: SyntheticTable, rng: Rng) -> Damaged:
    """Depth of 8 bits over two meters, compressed as a photograph."""
    import cv2

    raw = np.clip(np.nan_to_num(table.frame.depth) / 2 * 255, 0, 255).astype(np.uint8)
    _, data = cv2.imencode(".jpg", raw, [cv2.IMWRITE_JPEG_QUALITY, int(rng.choice([30, 60, 90]))])
    found = np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), np.float64)
    return _with_depth(table, np.where(np.isnan(table.frame.depth), np.nan, found / 255 * 2))


def _tilted(table: SyntheticTable, rng: Rng) -> Damaged:
    """Depth that grows too fast from one side of the image to the other."""
    w = table.truth.shape[1]
    gain = 1 + float(rng.choice([-1, 1]) * rng.uniform(0.08, 0.2)) * (np.arange(w) / w - 0.5)
    return _with_depth(table, table.frame.depth * gain)


ODD: dict[str, Callable[[SyntheticTable, Rng], Damaged]] = {
    "constant error": _constant_error,
    "disparity error": _disparity_error,
    "turned sideways": _turned_sideways,
    "rolled down": _rolled_down,
    "rolled slightly": _rolled_slightly,
    "late depth": _late_depth,
    "other view": _other_view,
    "unit of a half": _unit_of_a_half,
    "filtered": _filtered,
    "widened": _widened,
    "enlarged": _enlarged,
    "arm": _arm,
    "arm erased": _arm_erased,
    "striped": _striped,
    "wavy": _wavy,
    "wrapped": _wrapped,
    "clipped": _clipped,
    "resized": _resized,
    "rotated": _rotated,
    "flattened": _flattened,
    "salted": _salted,
    "sparse": _sparse,
    "compressed": _compressed,
    "tilted": _tilted,
}
