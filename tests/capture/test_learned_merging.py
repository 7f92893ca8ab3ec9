"""The network that judges pairs of regions matches their features, and training it gives equal bytes."""

from __future__ import annotations

import numpy as np

from simfoundry.capture.segment.learned_merging import merge_network, read_network
from simfoundry.capture.segment.pair_features import COUNT, lab_image, pair_features
from simfoundry.capture.segment.regions import Crop
from tests.capture.train_merging import Examples, packed, trained


def test_the_network_of_the_package_judges_all_features() -> None:
    network = merge_network()
    assert len(network.mean) == len(network.scale) == network.layers[0][0].shape[1] == COUNT
    same = network.probability(np.random.default_rng(0).normal(size=(50, COUNT)) * 3)
    assert ((same >= 0) & (same <= 1)).all() and np.ptp(same) > 0.5


def test_training_separates_and_is_deterministic() -> None:
    rng = np.random.default_rng(1)
    features = rng.normal(size=(400, 3))
    same = (features[:, 0] * features[:, 1] > 0).astype(np.float64)  # no single threshold separates them
    data = packed(trained(Examples(features, same)))
    assert data == packed(trained(Examples(features, same)))
    judged = read_network(data).probability(features) > 0.5
    assert (judged == same).mean() > 0.8


def test_a_pair_smaller_than_the_reach_of_edges_has_features() -> None:
    h, w = 8, 60
    v, u = np.indices((h, w))
    depth = np.asarray(0.8 + 0.001 * u, np.float64)
    points = np.stack([u * 0.002, v * 0.002, 0.02 + 0.001 * v], axis=-1)
    crop = Crop(
        window=(slice(0, h), slice(0, w)),
        whole=(480, 640),
        color=np.full((h, w, 3), 90, np.uint8),
        depth=depth,
        pixel_area=np.full((h, w), 2e-6),
        points_W=points,
        mask=np.ones((h, w), np.bool_),
        edge=np.zeros((h, w)),
        step=np.zeros((h, w)),
        reach=6,
        down=(0.0, 1.0),
    )
    features = pair_features(u < 30, u >= 30, crop, lab_image(crop.color))
    assert features.shape == (COUNT,) and np.isfinite(features).all()
