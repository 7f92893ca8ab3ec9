"""Train the network that decides which regions are one object: ``python -m tests.capture.train_merging``.

The examples are pairs of regions of synthetic tables (``--tables N``, seeds from 1000) and of one half of the real ones
(``--half A``, where the data is). Writes the weights into the package; equal inputs give equal bytes. It needs NumPy
alone, and an hour on two cores for 400 tables.
"""

from __future__ import annotations

import argparse
import io
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import simfoundry.capture.segment
from simfoundry.capture.frame import CaptureError, Frame
from simfoundry.capture.segment.decompose import RegionSurvey, merged_by_rules, survey_regions
from simfoundry.capture.segment.find_support import find_support
from simfoundry.capture.segment.learned_merging import DEEPEST, FEWEST, WEIGHTS, MergeNetwork
from simfoundry.capture.segment.masks import Labels, Mask
from simfoundry.capture.segment.pair_features import lab_image, pair_features
from simfoundry.capture.segment.regions import Crop, adjacent_pairs
from simfoundry.capture.segment.split_candidates import split_candidates
from simfoundry.geometry.frames import Array
from simfoundry.runtime.files import write_atomically
from tests.corpora.segmentation import DATA, half_of, labelled_pictures
from tests.corpora.synthetic_tables import synthetic_table

FIRST_SEED = 1000
"""The first seed that is trained on; proofs use seeds below it."""

PURE = 0.8
"""The share of a region's pixels that must belong to one object, for its pair to be an example."""

HIDDEN, NETWORKS, EPOCHS, BATCH = (24, 12), 5, 200, 256
LEARNING_RATE, DECAY, DROPOUT = 3e-3, 1e-3, 0.1
HEAVIEST = 4.0
"""The largest weight of an example of two objects: of the pairs most are one, and a missed object is worse."""


@dataclass(frozen=True, eq=False)
class Examples:
    """Features of pairs, shape (n, features), and whether each is one object, shape (n,)."""

    features: Array
    same: Array


def examples_of(frame: Frame, truth: NDArray[np.int32]) -> Iterator[tuple[Array, bool]]:
    """Features of the pairs of regions of a picture, and whether they are one object.

    The pairs are those that a perfect network would be asked about: regions are divided where a division separates two
    objects, the halves are judged again, and so are the regions that remain.
    """
    frame = frame.cleaned()
    support = find_support(frame)
    survey = survey_regions(frame, support.X_WC.apply(frame.points), support)
    if survey is None:
        return
    crop = survey.crop
    true, lab = truth[:: survey.step, :: survey.step][crop.window], lab_image(crop.color)
    for labels in (survey.regions, _perfect_division(survey, true, lab)):
        for a, b in sorted(adjacent_pairs(labels)):
            yield from _example(labels == a, labels == b, crop, true, lab)
    for mask in _judged_regions(survey, true, lab):
        for pair in split_candidates(mask, crop, lab, survey.initial):
            yield from _example(*pair, crop, true, lab)


def _example(one: Mask, other: Mask, crop: Crop, true: NDArray[np.int32], lab: Array) -> Iterator[tuple[Array, bool]]:
    """Features and truth of one pair, unless it is small or mixed, or shows the background."""
    if min(one.sum(), other.sum()) < FEWEST // 2:
        return
    (a, share_a), (b, share_b) = _owner(true[one]), _owner(true[other])
    if min(share_a, share_b) >= PURE and (a or b):
        yield pair_features(one, other, crop, lab), a == b


def _judged_regions(survey: RegionSurvey, true: NDArray[np.int32], lab: Array) -> list[Mask]:
    """The regions whose divisions are judged, halves of divided regions included."""
    out: list[Mask] = []
    left = [(survey.regions == k, DEEPEST) for k in range(1, int(survey.regions.max()) + 1)]
    while left:
        mask, depth = left.pop()
        if depth == 0 or mask.sum() < 2 * FEWEST:
            continue
        out.append(mask)
        halves = _best_halves(mask, survey, true, lab)
        left += [(half, depth - 1) for half in halves or ()]
    return out


def _perfect_division(survey: RegionSurvey, true: NDArray[np.int32], lab: Array) -> Labels:
    """The regions after every division that separates objects, and the stages up to the joining of regions."""
    labels, number = np.zeros_like(survey.regions), 0
    left = [survey.regions == k for k in range(1, int(survey.regions.max()) + 1)]
    while left:
        mask = left.pop()
        halves = _best_halves(mask, survey, true, lab) if mask.sum() >= 2 * FEWEST else None
        if halves is not None:
            left += halves
            continue
        number += 1
        labels[mask] = number
    return merged_by_rules(labels, survey.crop)


def _best_halves(mask: Mask, survey: RegionSurvey, true: NDArray[np.int32], lab: Array) -> list[Mask] | None:
    """The two halves that separate two objects best, or None if the region shows one object."""
    best, halves = PURE, None
    if _owner(true[mask])[1] > 0.95:
        return None
    for pair in split_candidates(mask, survey.crop, lab, survey.initial):
        (a, share_a), (b, share_b) = (_owner(true[half]) for half in pair)
        if a != b and a and b and min(share_a, share_b) > best:
            best, halves = min(share_a, share_b), list(pair)
    return halves


def _owner(numbers: NDArray[np.int32]) -> tuple[int, float]:
    counts = np.bincount(numbers)
    k = int(np.argmax(counts))
    return k, float(counts[k] / counts.sum())


def collected(tables: int, half: str | None, data: Path) -> Examples:
    """The examples of synthetic tables and of one half of the real ones."""
    out: list[tuple[Array, bool]] = []
    for name, frame, truth in labelled_pictures(data) if half else ():
        if half in ("AB", half_of(name)):
            out += examples_of(frame, truth)
    for seed in range(FIRST_SEED, FIRST_SEED + tables):
        table = synthetic_table(seed)
        try:
            out += examples_of(table.frame, table.truth)
        except CaptureError:
            continue
    return Examples(np.array([f for f, _ in out]), np.array([float(s) for _, s in out]))


def trained(examples: Examples) -> MergeNetwork:
    """The ensemble for the examples."""
    mean, scale = examples.features.mean(axis=0), examples.features.std(axis=0) + 1e-6
    x = np.clip((examples.features - mean) / scale, -4, 4)
    different = max(1.0, float((examples.same == 0).sum()))
    weight = np.where(examples.same > 0, 1.0, min(HEAVIEST, float(examples.same.sum()) / different))
    nets = [_perceptron(x, examples.same, weight, seed) for seed in range(NETWORKS)]
    count = len(HIDDEN) + 1
    layers = tuple(
        (np.stack([net[k] for net in nets]), np.stack([net[count + k] for net in nets])) for k in range(count)
    )
    return MergeNetwork(mean, scale, layers)


def _perceptron(x: Array, same: Array, weight: Array, seed: int) -> list[Array]:
    """Weights, then biases, of each layer, by Adam on the weighted cross entropy with a falling rate."""
    rng = np.random.default_rng(seed)
    sizes = (x.shape[1], *HIDDEN, 1)
    count = len(sizes) - 1
    parameters: list[Array] = [rng.normal(0, np.sqrt(2 / a), (a, b)) for a, b in pairwise(sizes)]
    parameters += [np.zeros(b) for b in sizes[1:]]
    first, second = [np.zeros_like(p) for p in parameters], [np.zeros_like(p) for p in parameters]
    steps = 0
    for epoch in range(EPOCHS):
        rate = LEARNING_RATE * 0.5 * (1 + np.cos(np.pi * epoch / EPOCHS))
        order = rng.permutation(len(x))
        for start in range(0, len(x), BATCH):
            rows = order[start : start + BATCH]
            inputs = x[rows] * (rng.random((len(rows), x.shape[1])) > DROPOUT)
            steps += 1
            for k, slope in enumerate(_slopes(parameters, count, inputs, same[rows], weight[rows])):
                first[k] = 0.9 * first[k] + 0.1 * slope
                second[k] = 0.999 * second[k] + 0.001 * slope**2
                step = first[k] / (1 - 0.9**steps) / (np.sqrt(second[k] / (1 - 0.999**steps)) + 1e-8)
                parameters[k] = parameters[k] - rate * step
    return parameters


def _slopes(parameters: list[Array], count: int, x: Array, same: Array, weight: Array) -> list[Array]:
    """The gradient of the loss by each parameter."""
    outputs = [x]
    for k in range(count):
        z = outputs[-1] @ parameters[k] + parameters[count + k]
        outputs.append(np.maximum(z, 0) if k < count - 1 else z)
    delta = ((1 / (1 + np.exp(-outputs[-1][:, 0])) - same) * weight)[:, None] / len(x)
    slopes: list[Array] = [np.zeros(0)] * (2 * count)
    for k in reversed(range(count)):
        slopes[k] = outputs[k].T @ delta + DECAY * parameters[k]
        slopes[count + k] = delta.sum(axis=0)
        if k:
            delta = (delta @ parameters[k].T) * (outputs[k] > 0)
    return slopes


def packed(network: MergeNetwork) -> bytes:
    """The bytes of a NumPy archive without times."""
    arrays: dict[str, Array] = {"mean": network.mean, "scale": network.scale}
    for k, (weights, biases) in enumerate(network.layers):
        arrays |= {f"weights_{k}": weights, f"biases_{k}": biases}
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in sorted(arrays.items()):
            data = io.BytesIO()
            np.save(data, array.astype(np.float32))
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), data.getvalue())
    return stream.getvalue()


def main() -> None:
    """Collect, train and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tables", type=int, default=200, help="synthetic tables to learn from")
    parser.add_argument("--half", choices=("A", "B", "AB"), help="half of the real tables to learn from as well")
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the real tables")
    parser.add_argument("--out", type=Path, default=Path(next(iter(simfoundry.capture.segment.__path__))) / WEIGHTS)
    options = parser.parse_args()
    examples = collected(options.tables, options.half, options.data)
    write_atomically(options.out, packed(trained(examples)))
    print(f"{len(examples.same)} pairs, {int((examples.same == 0).sum())} of them of two objects; {options.out}")


if __name__ == "__main__":
    main()
