"""Compare the confidence in solids with their accuracy: ``python -m tests.corpora.confidence [N] [--first SEED]``.

The objects of synthetic tables, or of piles of YCB objects, are segmented and fitted, and each solid is compared with
the true object that most of its pixels show, in the frame of the camera. A calibrated confidence is the F1 score at
1 cm to be expected. Prints the objects by confidence, the mean error, and, with ``--fit``, a map from the confidence to
the expected F1 score, which never falls (isotonic regression).
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from simfoundry.capture.accuracy.scene_accuracy import surface, surface_distance
from simfoundry.capture.frame import CaptureError
from simfoundry.capture.reconstruct import fit_segments
from simfoundry.capture.segment.decompose import decompose
from simfoundry.capture.segment.find_support import find_support
from simfoundry.capture.shapes.fit import FittedShape
from simfoundry.geometry.frames import Array, Pose, frozen_array
from simfoundry.scene.model import Link, SceneObject, Visual
from tests.corpora.synthetic_tables import SyntheticTable, synthetic_table
from tests.corpora.ycb_scenes import pile

BINS = (0.0, 0.2, 0.4, 0.6, 0.8, 1.001)
"""Limits of the bins of confidence; finer ones have too few objects."""


@dataclass(frozen=True)
class Judged:
    """One solid: the seed of its table, its confidence, the true F1 score at 1 cm, and its kind of geometry."""

    seed: int
    confidence: float
    f1: float
    kind: str


def judged_solids(table: SyntheticTable) -> Iterator[Judged]:
    """Each solid of a table; one whose pixels show no object has an F1 score of 0."""
    frame = table.frame.cleaned()
    try:
        support = find_support(frame)
        segmentation = decompose(frame, support)
        shapes, _, _ = fit_segments(frame, support, segmentation, lambda stage, share: None)
    except CaptureError:
        return
    X_CT = table.camera.X_WC.inverse()
    first = len(table.scene.objects) - int(table.truth.max())
    for k, shape in shapes.items():
        seen = np.bincount(table.truth[segmentation.labels == k])
        number, f1 = int(np.argmax(seen)), 0.0
        if number:
            item = table.scene.objects[first + number - 1]
            _, f1 = surface_distance(surface(item, X_CT @ item.X_WO), _solid_points(shape, support.X_WC))
        yield Judged(table.seed, shape.confidence, f1, type(shape.geometry).__name__)


def _solid_points(shape: FittedShape, X_WC: Pose) -> Array:
    """Points on a solid in the frame of the camera [m]."""
    visual = Visual("solid", shape.geometry, frozen_array([1, 1, 1, 1]), Pose.of())
    link = Link(name="body", mass=1.0, com=frozen_array([0, 0, 0]), inertia=frozen_array(np.eye(3)), visuals=(visual,),
                colliders=())  # fmt: skip
    item = SceneObject("solid", category="solid", fixed=False, X_WO=shape.X_WO, links=(link,))
    return surface(item, X_WC.inverse() @ shape.X_WO)


def isotonic(raw: Sequence[float], value: Sequence[float]) -> tuple[Array, Array]:
    """The positions and values of the blocks of the best map that never falls (pool adjacent violators)."""
    order = np.argsort(raw, kind="stable")
    blocks: list[list[float]] = []  # sum of raw values, sum of values, and count
    for k in order:
        blocks.append([float(raw[k]), float(value[k]), 1.0])
        while len(blocks) > 1 and blocks[-2][1] / blocks[-2][2] >= blocks[-1][1] / blocks[-1][2]:
            last = blocks.pop()
            blocks[-1] = [a + b for a, b in zip(blocks[-1], last, strict=True)]
    sums = np.array(blocks)
    return sums[:, 0] / sums[:, 2], sums[:, 1] / sums[:, 2]


def print_table(solids: Sequence[Judged]) -> None:
    """Print a line for each bin of confidence, and the mean error of all."""
    confidence, f1 = np.array([s.confidence for s in solids]), np.array([s.f1 for s in solids])
    print(f"{'confidence':12} {'objects':>7} {'mean confidence':>16} {'mean F1':>8} {'F1 below 0.5':>13}")
    for low, high in pairwise(BINS):
        inside = (confidence >= low) & (confidence < high)
        if inside.any():
            row = f"{inside.sum():7d} {confidence[inside].mean():16.2f} {f1[inside].mean():8.2f}"
            print(f"{low:.1f} to {min(high, 1):.1f}   {row} {(f1[inside] < 0.5).sum():13d}")
    rank = np.corrcoef(np.argsort(np.argsort(confidence)), np.argsort(np.argsort(f1)))[0, 1]
    error, bias = np.abs(confidence - f1).mean(), (confidence - f1).mean()
    print(f"{len(solids)} objects: mean error {error:.3f}, bias {bias:+.3f}, rank correlation {rank:.2f}")


def main() -> None:
    """Fit, compare and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", type=int, nargs="?", default=60, help="number of tables")
    parser.add_argument("--first", type=int, default=0, metavar="SEED", help="seed of the first one")
    parser.add_argument("--piles", action="store_true", help="piles of YCB objects, whose masks are often wrong")
    parser.add_argument("--fit", action="store_true", help="print a map from the confidence to the F1 score as well")
    parser.add_argument("--out", type=Path, help="write the solids as JSON, one a line")
    options = parser.parse_args()
    solids: list[Judged] = []
    for seed in range(options.first, options.first + options.count):
        solids += judged_solids(pile(seed) if options.piles else synthetic_table(seed))
        if options.out is not None:
            options.out.write_text("\n".join(json.dumps(asdict(s)) for s in solids) + "\n")
    print_table(solids)
    if options.fit:
        raw, expected = isotonic([s.confidence for s in solids], [s.f1 for s in solids])
        print("map:", ", ".join(f"{a:.2f}: {b:.2f}" for a, b in zip(raw, expected, strict=True)))


if __name__ == "__main__":
    main()
