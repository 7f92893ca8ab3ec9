"""The files that GR00T reads in addition to those of LeRobot v2.1: ``modality.json`` and ``stats.json``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from simfoundry.data.dataset.features import DatasetInfo, FeaturePart, FeatureRole
from simfoundry.data.dataset.statistics import FeatureStatistics
from simfoundry.data.formats.lerobot.schema import is_video

# GR00T slices every entry like the values of the feature, so that a count would break its normalization.
_KEYS = ("mean", "std", "min", "max")
_QUANTILES = ("q01", "q99")


def modality(info: DatasetInfo) -> dict[str, Any]:
    """Return the content of ``modality.json``: the quantities in each vector, the videos, and the instruction."""
    return {
        "state": _groups(info, FeatureRole.OBSERVATION),
        "action": _groups(info, FeatureRole.ACTION),
        "video": {_last(f.name): {"original_key": f.name} for f in info.features if is_video(f)},
        "annotation": {"human.task_description": {"original_key": "task_index"}},
    }


def _last(name: str) -> str:
    """Return the part of a name after the last dot, because GR00T separates kinds and names by dots."""
    return name.rpartition(".")[2]


def _groups(info: DatasetInfo, role: FeatureRole) -> dict[str, dict[str, Any]]:
    """Return the quantities with a role, by name, each with its range in its feature."""
    groups: dict[str, dict[str, Any]] = {}
    for feature in (feature for feature in info.arrays if feature.role is role):
        whole = FeaturePart(_last(feature.name), 0, feature.shape[0])
        for part in feature.parts or (whole,):
            name = part.name if part.name not in groups else f"{_last(feature.name)}_{part.name}"
            groups[name] = {"start": part.start, "end": part.stop, "original_key": feature.name}
            if "delta" in part.meaning or ("velocity" in part.meaning and role is FeatureRole.ACTION):
                groups[name]["absolute"] = False
    return groups


def gr00t_statistics(info: DatasetInfo, statistics: Mapping[str, FeatureStatistics]) -> dict[str, dict[str, Any]]:
    """Return the content of ``stats.json``: the statistics of all numbers in ``data/``, without images."""
    images = {feature.name for feature in info.images}
    found = {}
    for name, one in statistics.items():
        if name not in images:
            found[name] = {key: getattr(one, key).tolist() for key in _KEYS}
            found[name] |= {key: one.quantiles[key].tolist() for key in _QUANTILES}
    return found
