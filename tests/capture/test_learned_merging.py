"""The network that judges pairs of regions matches their features, and training it gives equal bytes."""

from __future__ import annotations

import numpy as np

from simfoundry.capture.segment.learned_merging import merge_network, read_network
from simfoundry.capture.segment.pair_features import COUNT
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
