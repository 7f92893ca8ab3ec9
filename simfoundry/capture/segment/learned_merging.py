"""Decide with a small trained network which adjacent regions are one object.

Thresholds on a single quantity cannot tell the lid of a jar from a can on a can. The network judges all features of a
pair together (see `pair_features.py`). It is an ensemble of perceptrons with two hidden layers, evaluated in NumPy, and
was trained by `python -m tests.capture.train_merging`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from simfoundry.capture.segment.masks import Labels, Mask
from simfoundry.capture.segment.merge_regions import compact
from simfoundry.capture.segment.pair_features import MEETS, lab_image, pair_features
from simfoundry.capture.segment.regions import Crop, adjacent_pairs
from simfoundry.capture.segment.split_candidates import split_candidates
from simfoundry.geometry.frames import Array

DIVIDE = 0.35  # maximum probability of one object at which a region is divided; chosen on the tuning half
DOUBTED = 0.7  # maximum probability of one object at which that is doubted; 0.78 on 245 regions that were one object
JOIN = 0.95  # minimum probability of one object at which two regions are joined; chosen on the tuning half
# Minimum share of a border along which two regions must meet to be joined. Below it, one merely hides the other, and
# equal colors are no evidence: the network joined two white boxes 10 cm apart.
MEETING = 0.1
DEEPEST = 3  # maximum number of divisions of one region, each into two
FEWEST = 40  # [px] minimum size of a half; smaller ones have too few points for a shape
LARGEST = 40  # maximum number of regions that are judged; more are texture or noise, and would take minutes
WEIGHTS = "merge_weights.npz"


@dataclass(frozen=True, eq=False)
class MergeNetwork:
    """An ensemble of perceptrons that judge a pair of regions.

    ``mean`` and ``scale``, shape (features,), normalize the features. ``layers`` contains the weights, shape
    (networks, inputs, outputs), and biases, shape (networks, outputs), of each layer.
    """

    mean: Array
    scale: Array
    layers: tuple[tuple[Array, Array], ...]

    def probability(self, features: Array) -> Array:
        """Return the probability that each pair is one object, shape (n,), from features of shape (n, features)."""
        hidden = np.clip((features - self.mean) / self.scale, -4, 4)[None]
        for k, (weights, biases) in enumerate(self.layers):
            hidden = hidden @ weights + biases[:, None]
            hidden = np.maximum(hidden, 0) if k < len(self.layers) - 1 else hidden
        return np.asarray(1 / (1 + np.exp(-hidden[..., 0].mean(axis=0))))


@cache
def merge_network() -> MergeNetwork:
    """Return the network that is part of the package."""
    from importlib.resources import files

    return read_network(files("simfoundry.capture.segment").joinpath(WEIGHTS).read_bytes())


def read_network(data: bytes) -> MergeNetwork:
    """Return the network in a NumPy archive of normalization, weights and biases."""
    import io

    with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
        values = {name: np.asarray(arrays[name], np.float64) for name in arrays.files}
    count = sum(name.startswith("weights") for name in values)
    layers = tuple((values[f"weights_{k}"], values[f"biases_{k}"]) for k in range(count))
    return MergeNetwork(values["mean"], values["scale"], layers)


def divide_regions(
    labels: Labels, initial: Labels, crop: Crop, network: MergeNetwork | None = None
) -> tuple[Labels, tuple[int, ...]]:
    """Divide regions that the network takes for several objects.

    ``initial`` are the regions before any merging across creases. They provide some of the divisions that are judged.

    Returns:
        The regions, and the numbers of those that remained one although the network is not certain of it.
    """
    if not 0 < int(labels.max()) <= LARGEST:
        return labels, ()
    network, lab = network or merge_network(), lab_image(crop.color)
    parts: list[tuple[Mask, bool]] = []
    for k in range(1, int(labels.max()) + 1):
        parts += _divided(labels == k, initial, crop, lab, network, DEEPEST)
    out = np.zeros(labels.shape, np.int32)
    for k, (part, _) in enumerate(parts, 1):
        out[part] = k
    return out, tuple(k for k, (_, doubted) in enumerate(parts, 1) if doubted)


def join_regions(labels: Labels, crop: Crop, network: MergeNetwork | None = None) -> Labels:
    """Join adjacent regions that the network takes for one object, starting with the most certain pair."""
    if not 0 < int(labels.max()) <= LARGEST:
        return labels
    return _joined(labels, crop, lab_image(crop.color), network or merge_network())


def _divided(
    mask: Mask, initial: Labels, crop: Crop, lab: Array, network: MergeNetwork, depth: int
) -> list[tuple[Mask, bool]]:
    """Return the objects into which a region is divided, which is the region itself in most cases.

    Each of them is with a flag that tells if it may be several objects.
    """
    if depth == 0 or mask.sum() < 2 * FEWEST:
        return [(mask, False)]
    pairs = [pair for pair in split_candidates(mask, crop, lab, initial) if min(m.sum() for m in pair) >= FEWEST]
    if not pairs:
        return [(mask, False)]
    same = network.probability(np.array([pair_features(a, b, crop, lab) for a, b in pairs]))
    best = int(np.argmin(same))
    if same[best] > DIVIDE:
        return [(mask, bool(same[best] < DOUBTED))]
    one, other = pairs[best]
    rest = mask & ~one & ~other  # disconnected specks stay with the larger half
    halves = (one | rest, other) if one.sum() > other.sum() else (one, other | rest)
    return [part for half in halves for part in _divided(half, initial, crop, lab, network, depth - 1)]


def _joined(labels: Labels, crop: Crop, lab: Array, network: MergeNetwork) -> Labels:
    """Join adjacent regions, starting with the most certain pair, and judge the results again."""
    known: dict[tuple[int, int], float] = {}
    while True:
        for pair in adjacent_pairs(labels) - known.keys():
            masks = [labels == k for k in pair]
            known[pair] = _sameness(masks[0], masks[1], crop, lab, network)
        best = max(known, key=lambda pair: (known[pair], pair), default=None)
        if best is None or known[best] < JOIN:
            return compact(labels)
        keep, gone = best
        labels = np.where(labels == gone, keep, labels).astype(np.int32)
        known = {pair: same for pair, same in known.items() if keep not in pair and gone not in pair}


def _sameness(one: Mask, other: Mask, crop: Crop, lab: Array, network: MergeNetwork) -> float:
    """Return the probability that two regions are one object: 0 if they are tiny, or only overlap in the image."""
    if min(int(one.sum()), int(other.sum())) < FEWEST // 2:
        return 0.0
    features = pair_features(one, other, crop, lab)
    return 0.0 if features[MEETS] < MEETING else float(network.probability(features[None])[0])
