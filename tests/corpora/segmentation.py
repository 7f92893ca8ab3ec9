"""Score the decomposition on tables with instance masks: ``python -m tests.corpora.segmentation``.

Real tables (mosd_dev and mosd_more) are in two halves by a digest of their names. Thresholds are chosen, and the
network of `train_merging` is trained, on one half and reported on the other: ``--weights FILE`` judges with other
weights than those of the package. ``--tables N`` scores N synthetic tables of seeds that nothing was trained on, per
sensor, and ``--perturb`` changed pictures of mosd_dev. Only frame, support and segmentation run.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import CaptureError, Frame, Segmentation, SupportSurface
from simfoundry.capture.frames.sensors import register
from simfoundry.capture.segment import learned_merging
from simfoundry.capture.segment.decompose import decompose
from simfoundry.capture.segment.find_support import find_support
from simfoundry.geometry.frames import Array, Pose

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"
UNORGANIZED = frozenset({"test56"})
"""Clouds that are no pictures: 165114 points in a row, without intrinsics."""

REAL = ("mosd_dev", "mosd_more")
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


def pictures(folder: str, names: Sequence[str] = (), data: Path = DATA) -> Iterator[tuple[str, Frame, dict[str, Any]]]:
    """Name, frame and index entry of the pictures ``names`` of a capture set, or of all of them.

    Depth is in meters and registered to color.
    """
    import cv2

    for entry in json.loads((data / folder / "capture.json").read_text())["frames"]:
        name = entry["rgb"].split("-color")[0].split(".")[0]
        if names and name not in names:
            continue
        color = _image(data / folder / entry["rgb"], cv2.IMREAD_COLOR)[..., ::-1].astype(np.uint8)
        raw = _image(data / folder / entry["depth"], cv2.IMREAD_UNCHANGED)
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


def half_of(name: str) -> str:
    """The half, A or B, that a real table belongs to."""
    return "AB"[hashlib.sha256(name.encode()).digest()[0] % 2]


def labelled_pictures(data: Path = DATA, names: Sequence[str] = ()) -> Iterator[tuple[str, Frame, Labels]]:
    """Name, frame and the numbers that people drew, 0 where there is no object, of all real tables or of ``names``."""
    import cv2

    for folder in REAL:
        for name, frame, entry in pictures(folder, names, data):
            if name not in UNORGANIZED:
                raw = _image(data / folder / str(entry["label_image"]), cv2.IMREAD_UNCHANGED).astype(np.int32)
                yield name, frame, np.where(raw >= 20, raw // 10 - 1, 0).astype(np.int32)


def mosd_pictures(names: Sequence[str] = ()) -> Iterator[tuple[str, Frame]]:
    """Name and frame, its ``instances`` the true ones, of the scenes ``names`` of mosd_dev, or of all."""
    known = [name for name, _, _ in pictures("mosd_dev", names)]
    for name, frame, truth in labelled_pictures(names=known):
        yield name, replace(frame, instances=truth)


def mosd_scores(names: Sequence[str] = (), perturbation: str = "none") -> list[Score]:
    """Scores of scenes of the modified Object Segmentation Database in the development data."""
    out = []
    for name, frame in mosd_pictures(names):
        changed = PERTURBATIONS[perturbation](frame)
        assert changed.instances is not None
        out.append(scored(name, replace(changed, instances=None), changed.instances))
    return out


def scored(name: str, frame: Frame, truth: Labels) -> Score:
    """The score of one picture; one in which nothing is found has an IoU of 0."""
    start = time.perf_counter()
    try:
        labels = segment(frame)[1].labels
    except CaptureError:
        labels = np.zeros(truth.shape, np.int32)
    seconds = time.perf_counter() - start
    true, found = len(_numbers(truth)), len(_numbers(labels))
    # An object that was not found has an IoU of 0.
    iou = float(matched_iou(truth, labels).sum()) / true if found and true else float(found == true)
    return Score(name, true, found, iou, seconds)


def report(scores: list[Score]) -> str:
    """One line: counts exact and within one, mean IoU, and the slowest."""
    off = [abs(s.true - s.found) for s in scores]
    return (
        f"{len(scores)} scenes: exact {sum(d == 0 for d in off)}, within one {sum(d <= 1 for d in off)}, "
        f"mean IoU {np.mean([s.iou for s in scores]):.3f}, slowest {max(s.seconds for s in scores):.2f} s"
    )


def print_scores(group: str, scores: list[Score], verbose: bool = True) -> None:
    """Print a line for each scene that is counted wrong, or for all, and the report."""
    for s in scores:
        if verbose or s.true != s.found:
            print(f"  {s.name:12} {s.true:3d} true {s.found:3d} found  IoU {s.iou:5.3f} {s.seconds:6.2f} s")
    print(f"{group}: {report(scores)}" if scores else f"{group}: none", flush=True)


def print_real(data: Path) -> None:
    """Score the real tables, half by half."""
    halves: dict[str, list[Score]] = {"A": [], "B": []}
    for name, frame, truth in labelled_pictures(data):
        halves[half_of(name)].append(scored(name, frame, truth))
    for half, scores in halves.items():
        print_scores(f"real tables, half {half}", scores, verbose=False)


def print_synthetic(first: int, count: int) -> None:
    """Score synthetic tables, sensor by sensor."""
    from tests.corpora.synthetic_tables import synthetic_table

    found: dict[str, list[Score]] = {}
    for seed in range(first, first + count):
        table = synthetic_table(seed)
        found.setdefault(table.sensor, []).append(scored(f"seed {seed}", table.frame, table.truth))
    for sensor, scores in sorted(found.items()):
        print_scores(f"synthetic, {sensor}", scores, verbose=False)
    print_scores("synthetic, all sensors", [s for scores in found.values() for s in scores], verbose=False)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--perturb", action="store_true", help="score changed pictures of mosd_dev instead")
    parser.add_argument("--tables", type=int, default=0, metavar="N", help="score N synthetic tables instead")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="the first of their seeds")
    parser.add_argument("--weights", type=Path, help="judge pairs of regions with these weights")
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the real tables")
    options = parser.parse_args()
    if options.weights is not None:
        learned_merging.merge_network = lambda: learned_merging.read_network(options.weights.read_bytes())  # type: ignore[assignment]
    if options.tables:
        print_synthetic(options.first, options.tables)
        return
    if not (options.data / "mosd_dev" / "capture.json").is_file():
        raise SystemExit(f"no data at {options.data / 'mosd_dev'}")
    if options.perturb:
        for perturbation in PERTURBATIONS:
            print_scores(perturbation, mosd_scores(perturbation=perturbation))
    else:
        print_real(options.data)


if __name__ == "__main__":
    main()
