"""Score the decomposition on real tables with instance masks: ``python -m tests.corpora.segmentation [--perturb]``."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import Frame, Segmentation, SupportSurface
from simfoundry.capture.load import register
from simfoundry.capture.segment.decompose import decompose
from simfoundry.capture.segment.find_support import find_support
from simfoundry.geometry.frames import Array, Pose

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


def pictures(folder: str, names: Sequence[str] = ()) -> Iterator[tuple[str, Frame, dict[str, Any]]]:
    """Name, frame and index entry of the pictures ``names`` of a capture set, or of all of them.

    Depth is in meters and registered to color.
    """
    import cv2

    for entry in json.loads((DATA / folder / "capture.json").read_text())["frames"]:
        name = entry["rgb"].split("-color")[0].split(".")[0]
        if names and name not in names:
            continue
        color = _image(DATA / folder / entry["rgb"], cv2.IMREAD_COLOR)[..., ::-1].astype(np.uint8)
        raw = _image(DATA / folder / entry["depth"], cv2.IMREAD_UNCHANGED)
        depth = raw.astype(np.float64) * float(entry["depth_scale_to_m"])
        depth[np.isin(raw, entry["depth_invalid"])] = np.nan
        K = np.array(entry["K"], dtype=np.float64)
        if "depth_K" in entry:
            depth_K = np.array(entry["depth_K"], dtype=np.float64)
            X_color_depth = Pose.from_matrix(np.array(entry["T_color_depth"]))
            depth = register(depth, depth_K, X_color_depth, K, (color.shape[0], color.shape[1]))
        yield name, Frame(np.ascontiguousarray(color), depth, K), entry


def _image(path: Path, mode: int) -> NDArray[np.integer[Any]]:
    import cv2

    picture = cv2.imread(str(path), mode)
    if picture is None:
        raise FileNotFoundError(path)
    return np.asarray(picture)


def segment(frame: Frame) -> tuple[SupportSurface, Segmentation]:
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


def mirrored(frame: Frame) -> Frame:
    """The picture as a mirror shows it, left and right exchanged."""
    K = frame.K.copy()
    K[0, 2] = frame.depth.shape[1] - 1 - K[0, 2]
    instances = None if frame.instances is None else np.ascontiguousarray(frame.instances[:, ::-1])
    return Frame(np.ascontiguousarray(frame.color[:, ::-1]), np.ascontiguousarray(frame.depth[:, ::-1]), K, instances)


def noisier(frame: Frame) -> Frame:
    """With 1 mm times the squared depth [m] of noise added to every reading."""
    noise = np.random.default_rng(11).normal(size=frame.depth.shape) * 0.001 * frame.depth**2
    return replace(frame, depth=frame.depth + noise)


def sparser(frame: Frame) -> Frame:
    """With a fifth of the readings lost."""
    lost = np.random.default_rng(12).random(frame.depth.shape) < 0.2
    return replace(frame, depth=np.where(lost, np.nan, frame.depth))


def cropped(frame: Frame, by: int = 20) -> Frame:
    """Without a border of ``by`` pixels."""
    K = frame.K.copy()
    K[:2, 2] -= by
    inner = np.s_[by:-by, by:-by]
    instances = None if frame.instances is None else frame.instances[inner]
    return Frame(np.ascontiguousarray(frame.color[inner]), frame.depth[inner], K, instances)


PERTURBATIONS: dict[str, Callable[[Frame], Frame]] = {
    "none": lambda frame: frame,
    "mirrored": mirrored,
    "noisier": noisier,
    "sparser": sparser,
    "cropped": cropped,
}


def mosd_pictures(names: Sequence[str] = ()) -> Iterator[tuple[str, Frame]]:
    """Name and frame, its ``instances`` the true ones, of the scenes ``names``, or of all."""
    import cv2

    for name, frame, entry in pictures("mosd_dev", names):
        raw = _image(DATA / "mosd_dev" / str(entry["label_image"]), cv2.IMREAD_UNCHANGED).astype(np.int32)
        yield name, replace(frame, instances=np.where(raw >= 20, raw // 10 - 1, 0).astype(np.int32))


def mosd_scores(names: Sequence[str] = (), perturbation: str = "none") -> list[Score]:
    """Scores of scenes of the modified Object Segmentation Database in the development data."""
    out = []
    for name, frame in mosd_pictures(names):
        changed = PERTURBATIONS[perturbation](frame)
        truth = changed.instances
        assert truth is not None
        start = time.perf_counter()
        _, found = segment(replace(changed, instances=None))
        seconds = time.perf_counter() - start
        iou = float(matched_iou(truth, found.labels).mean())
        out.append(Score(name, len(_numbers(truth)), len(_numbers(found.labels)), iou, seconds))
    return out


def report(scores: list[Score]) -> str:
    """One line: counts exact and within one, mean IoU, and the slowest."""
    off = [abs(s.true - s.found) for s in scores]
    return (
        f"{len(scores)} scenes: exact {sum(d == 0 for d in off)}, within one {sum(d <= 1 for d in off)}, "
        f"mean IoU {np.mean([s.iou for s in scores]):.3f}, slowest {max(s.seconds for s in scores):.2f} s"
    )


def main() -> None:
    """Print the table; with ``--perturb``, a line for each perturbation too."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--perturb", action="store_true", help="score changed pictures as well")
    options = parser.parse_args()
    if not available("mosd_dev"):
        raise SystemExit(f"no data at {DATA / 'mosd_dev'}")
    for perturbation in PERTURBATIONS if options.perturb else ("none",):
        scores = mosd_scores(perturbation=perturbation)
        print(f"{perturbation:10} {'true':>5} {'found':>5} {'mIoU':>6} {'s':>6}")
        for s in scores:
            print(f"{s.name:10} {s.true:5d} {s.found:5d} {s.iou:6.3f} {s.seconds:6.2f}")
        print(report(scores), flush=True)


if __name__ == "__main__":
    main()
