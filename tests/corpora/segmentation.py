"""Score the decomposition on real tables with instance masks: ``python -m tests.corpora.segmentation``."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import Frame, Segmentation, Support
from simfoundry.capture.segment.decompose import decompose
from simfoundry.capture.segment.ground import find_support
from simfoundry.scene.frames import Array, Pose

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"
Labels = NDArray[np.int32]


@dataclass(frozen=True)
class Score:
    """One scene: how many objects there are and were found, mean IoU of those matched, and the time [s] it took."""

    name: str
    true: int
    found: int
    iou: float
    seconds: float


def available(folder: str) -> bool:
    """Whether the development data holds ``folder``."""
    return (DATA / folder / "capture.json").is_file()


def pictures(folder: str) -> Iterator[tuple[str, Frame, dict[str, Any]]]:
    """Name, frame and index entry of each picture of a capture set, its depth in metres and registered to colour."""
    import cv2

    for entry in json.loads((DATA / folder / "capture.json").read_text())["frames"]:
        color = _image(DATA / folder / entry["rgb"], cv2.IMREAD_COLOR)[..., ::-1].astype(np.uint8)
        raw = _image(DATA / folder / entry["depth"], cv2.IMREAD_UNCHANGED)
        depth = raw.astype(np.float64) * float(entry["depth_scale_to_m"])
        depth[np.isin(raw, entry["depth_invalid"])] = np.nan
        K = np.array(entry["K"], dtype=np.float64)
        if "depth_K" in entry:
            sensor = Frame(np.zeros((*depth.shape, 3), np.uint8), depth, np.array(entry["depth_K"], dtype=np.float64))
            depth = registered(sensor, Pose.from_matrix(np.array(entry["T_color_depth"])), K, color.shape[:2])
        yield entry["rgb"].split("-color")[0].split(".")[0], Frame(np.ascontiguousarray(color), depth, K), entry


def _image(path: Path, mode: int) -> NDArray[np.integer[Any]]:
    import cv2

    picture = cv2.imread(str(path), mode)
    if picture is None:
        raise FileNotFoundError(path)
    return np.asarray(picture)


def registered(sensor: Frame, X_CD: Pose, K: Array, shape: tuple[int, ...]) -> Array:
    """Depth [m] of a separate sensor as the colour camera would see it; each reading covers its pixel's whole area."""
    v, u = np.nonzero(np.isfinite(sensor.depth))
    z, depth_K = sensor.depth[v, u], sensor.K
    out = np.full(shape, np.inf)
    for du in (-0.34, 0.0, 0.34):
        for dv in (-0.34, 0.0, 0.34):
            x, y = (u + du - depth_K[0, 2]) / depth_K[0, 0] * z, (v + dv - depth_K[1, 2]) / depth_K[1, 1] * z
            p = X_CD.apply(np.stack([x, y, z], axis=-1))
            columns = np.round(p[:, 0] / p[:, 2] * K[0, 0] + K[0, 2]).astype(int)
            rows = np.round(p[:, 1] / p[:, 2] * K[1, 1] + K[1, 2]).astype(int)
            ok = (columns >= 0) & (columns < shape[1]) & (rows >= 0) & (rows < shape[0])
            np.minimum.at(out, (rows[ok], columns[ok]), p[ok, 2])
    return np.where(np.isfinite(out), out, np.nan)


def segment(frame: Frame) -> tuple[Support, Segmentation]:
    """Support and objects of one picture."""
    support = find_support(frame)
    return support, decompose(frame, support)


def matched_iou(truth: Labels, labels: Labels) -> Array:
    """IoU of each matched pair of objects, by the assignment that is best in total."""
    from scipy.optimize import linear_sum_assignment

    iou = np.array(
        [
            [np.sum((truth == i) & (labels == j)) / np.sum((truth == i) | (labels == j)) for j in _numbers(labels)]
            for i in _numbers(truth)
        ]
    )
    rows, columns = linear_sum_assignment(-iou)
    return np.asarray(iou[rows, columns])


def _numbers(labels: Labels) -> list[int]:
    return [int(k) for k in np.unique(labels[labels > 0])]


def mosd_scores() -> list[Score]:
    """Scores of all scenes of the modified Object Segmentation Database in the development data."""
    import cv2

    out = []
    for name, frame, entry in pictures("mosd_dev"):
        raw = _image(DATA / "mosd_dev" / str(entry["label_image"]), cv2.IMREAD_UNCHANGED).astype(np.int32)
        truth = np.where(raw >= 20, raw // 10 - 1, 0).astype(np.int32)
        start = time.perf_counter()
        _, found = segment(frame)
        seconds = time.perf_counter() - start
        iou = float(matched_iou(truth, found.labels).mean())
        out.append(Score(name, len(_numbers(truth)), len(_numbers(found.labels)), iou, seconds))
    return out


def main() -> None:
    """Print the table."""
    if not available("mosd_dev"):
        raise SystemExit(f"no data at {DATA / 'mosd_dev'}")
    scores = mosd_scores()
    print(f"{'scene':10} {'true':>5} {'found':>5} {'mIoU':>6} {'s':>6}")
    for s in scores:
        print(f"{s.name:10} {s.true:5d} {s.found:5d} {s.iou:6.3f} {s.seconds:6.2f}")
    off = [abs(s.true - s.found) for s in scores]
    print(
        f"{len(scores)} scenes: exact {sum(d == 0 for d in off)}, within one {sum(d <= 1 for d in off)}, "
        f"mean IoU {np.mean([s.iou for s in scores]):.3f}, slowest {max(s.seconds for s in scores):.2f} s"
    )


if __name__ == "__main__":
    main()
