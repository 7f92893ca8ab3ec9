"""Quantiles: the same whatever else is drawn, uniform, and disjoint between splits."""

from __future__ import annotations

import pytest

from simfoundry.cousins.randomization.quantiles import QuantileSource, shares
from simfoundry.spec.models.vary import SplitSpec

SPLITS = {"train": SplitSpec.model_validate({"until": 0.9}), "held_out": SplitSpec.model_validate({"from": 0.9})}


def test_a_quantile_depends_only_on_seed_index_and_name() -> None:
    one = QuantileSource.of(7, 3, {})
    assert one.quantile("light.key.intensity") == QuantileSource.of(7, 3, {}).quantile("light.key.intensity")
    others = [QuantileSource.of(8, 3, {}), QuantileSource.of(7, 4, {})]
    found = {source.quantile("light.key.intensity") for source in (one, *others)}
    assert len(found | {one.quantile("light.sky.intensity"), one.quantile("light.key.intensity", "x")}) == 5
    # The value is part of the format: it must not change between versions or machines.
    assert one.quantile("light.key.intensity") == pytest.approx(0.3609449, abs=1e-7)


def test_quantiles_are_uniform() -> None:
    found = [QuantileSource.of(0, k, {}).quantile("a.b") for k in range(2000)]
    assert all(0 <= q < 1 for q in found)
    for tenth in range(10):
        assert 150 < sum(tenth <= 10 * q < tenth + 1 for q in found) < 250


def test_splits_share_no_quantile() -> None:
    for name, (low, high) in {"train": (0.0, 0.9), "held_out": (0.9, 1.0)}.items():
        found = [QuantileSource.of(0, k, SPLITS, name).quantile("a.b") for k in range(500)]
        assert low <= min(found) < low + 0.02 * (high - low) < high - 0.02 * (high - low) < max(found) < high
    drawn = [QuantileSource.of(0, k, SPLITS).split for k in range(1000)]
    assert 60 < drawn.count("held_out") < 140 and set(drawn) == {"train", "held_out"}


@pytest.mark.parametrize("count", range(2, 40))
def test_each_choice_belongs_to_one_split(count: int) -> None:
    ends = {name: split.ends for name, split in SPLITS.items()}
    found = shares(count, ends)
    assert found["train"] == (0, found["held_out"][0]) and found["held_out"][1] == count
    assert found["held_out"][0] == min(round(0.9 * count), count - 1)
    chosen = {name: {QuantileSource.of(0, k, SPLITS, name).choice("a.b", count) for k in range(300)} for name in ends}
    assert not chosen["train"] & chosen["held_out"]


def test_many_splits_of_few_choices() -> None:
    ends = {"a": (0.0, 0.01), "b": (0.01, 0.02), "c": (0.02, 1.0)}
    assert shares(3, ends) == {"a": (0, 1), "b": (1, 2), "c": (2, 3)}
    assert shares(3, {"z": (0.98, 1.0), "y": (0.96, 0.98), "x": (0.0, 0.96)}) == {"x": (0, 1), "y": (1, 2), "z": (2, 3)}
    assert shares(10, {"a": (0.0, 0.3), "b": (0.7, 1.0)}) == {"a": (0, 3), "b": (7, 10)}
