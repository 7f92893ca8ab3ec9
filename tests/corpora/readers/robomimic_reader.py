"""Load a dataset with the real robomimic: observations of every kind, next observations, splits, windows, batches."""

from __future__ import annotations

import json
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from tests.corpora.readers.comparison import Expected, Report, main
from tests.corpora.readers.cpu_torch import define_operators


def check(folder: Path, expected: Expected, report: Report) -> str:
    """Load every frame, each split, windows, batches, and the environment of the dataset."""
    define_operators()
    import robomimic.utils.file_utils as files
    import robomimic.utils.obs_utils as observations

    path = folder / "dataset.hdf5"
    observed = [n for n in expected.names("array", "video", "image", "depth", "mask") if is_observed(expected, n)]
    images = [name for name in observed if expected.features[name]["kind"] in ("video", "image")]
    depth = [name for name in observed if expected.features[name]["kind"] == "depth"]
    numbers = [name for name in observed if name not in images + depth]
    modalities = {"low_dim": numbers, "rgb": images, "depth": depth}
    observations.initialize_obs_utils_with_obs_specs([{"obs": modalities, "goal": {key: [] for key in modalities}}])
    about = files.get_env_metadata_from_dataset(str(path))
    report.equal("environment", (about["env_type"], "env_kwargs" in about), (2, True))
    for split, (first, end) in [("", (0, len(expected.episodes))), *expected.splits.items()]:
        frames(open_dataset(path, observed, split), expected, report, range(first, end), observed, split)
    windows(path, expected, report, numbers[0])
    batches(open_dataset(path, observed, ""), expected, report)
    generation(path, expected, report)
    return f"robomimic {version('robomimic')}"


def is_observed(expected: Expected, name: str) -> bool:
    return bool(expected.features[name]["role"] == "observation")


def open_dataset(path: Path, observed: list[str], split: str, length: int = 1) -> Any:
    """Open a dataset as robomimic's training script does."""
    from robomimic.utils.dataset import SequenceDataset

    return SequenceDataset(
        hdf5_path=str(path),
        obs_keys=observed,
        dataset_keys=("actions", "rewards", "dones", "states"),
        seq_length=length,
        hdf5_cache_mode=None,
        hdf5_use_swmr=True,
        load_next_obs=True,
        filter_by_attribute=split or None,
    )


def frames(dataset: Any, expected: Expected, report: Report, episodes: range, observed: list[str], split: str) -> None:
    """Compare every frame of a split, with the observations after it."""
    report.equal(f"frames {split}".strip(), len(dataset), sum(expected.episodes[k]["length"] for k in episodes))
    index = 0
    for k in episodes:
        values, length = expected.values(k), expected.episodes[k]["length"]
        joined = np.concatenate([values[n] for n in expected.names("array") if not is_observed(expected, n)], axis=1)
        for t in range(length):
            item = dataset[index]
            report.equal("actions", item["actions"][0], joined[t])
            report.equal("states", item["states"][0], values["states"][t])
            report.equal("rewards", float(item["rewards"][0]), float(values["rewards"][t]))
            report.equal("dones", bool(item["dones"][0]), bool(values["dones"][t]))
            for name in observed:
                after = values[name][t + 1] if t + 1 < length else values[f"final/{name}"]
                report.equal(name, np.asarray(item["obs"][name][0]), values[name][t])
                report.equal(f"next {name}", np.asarray(item["next_obs"][name][0]), after)
            index += 1


def windows(path: Path, expected: Expected, report: Report, name: str) -> None:
    """Compare windows of three frames, which repeat the last frame at the end of an episode."""
    dataset, index = open_dataset(path, [name], "", length=3), 0
    for k, about in enumerate(expected.episodes):
        values = expected.values(k)[name]
        for t in range(about["length"]):
            times = np.minimum(np.arange(t, t + 3), about["length"] - 1)
            report.equal("windows", np.asarray(dataset[index]["obs"][name]), values[times])
            index += 1


def batches(dataset: Any, expected: Expected, report: Report) -> None:
    """Load everything in batches."""
    import torch

    loader = torch.utils.data.DataLoader(dataset, batch_size=8, num_workers=2)
    count = sum(len(batch["actions"]) for batch in loader)
    report.equal("batches: frames", count, sum(one["length"] for one in expected.episodes))


def generation(path: Path, expected: Expected, report: Report) -> None:
    """Compare the data that MimicGen needs, as its own reader looks them up."""
    import h5py

    with h5py.File(path, "r") as file:
        report.equal("total", int(file["data"].attrs["total"]), sum(one["length"] for one in expected.episodes))
        report.equal("env_args", "env_name" in json.loads(file["data"].attrs["env_args"]), True)
        for k in range(len(expected.episodes)):
            values = expected.values(k)
            group = file[f"data/demo_{k}/datagen_info"]
            for key, wanted in values.items():
                kind, _, name = key.removeprefix("generation/").partition("/")
                places = {"eef": "eef_pose", "target": "target_pose", "object": f"object_poses/{name}"}
                place = places.get(kind, f"subtask_term_signals/{name}")
                if key.startswith("generation/"):
                    report.equal("datagen_info", group[place][:], wanted)


if __name__ == "__main__":
    main(check)
