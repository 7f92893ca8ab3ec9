"""Load a dataset with the real LeRobot: 0.3 for v2.1, later ones for v3."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from tests.corpora.readers.comparison import Expected, Report, main, psnr
from tests.corpora.readers.cpu_torch import define_operators

# Smallest quality of a frame in a video [dB]. Colors at half the resolution cost most of it: without any encoding, the
# frames of 64 x 48 pixels with saturated edges in tests/data/synthetic.py have 28 dB. A wrong color matrix costs 6 dB.
MIN_PSNR = 26.0


def pixels(image: Any) -> Any:
    """Return an image of LeRobot, float (3, height, width) from 0 to 1, as (height, width, 3) from 0 to 255."""
    return np.asarray(image).transpose(1, 2, 0) * 255


def check(folder: Path, expected: Expected, report: Report) -> str:
    """Load every frame, windows of frames, batches, and the statistics."""
    define_operators()
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset("local/dataset", root=folder)
    # First, because LeRobot keeps open videos, and processes forked from this one would share their positions.
    batches(dataset, expected, report)
    frames(dataset, expected, report)
    windows(LeRobotDataset, folder, expected, report)
    subset(LeRobotDataset, folder, expected, report)
    statistics(dataset, expected, report)
    return f"lerobot {version('lerobot')}"


def frames(dataset: Any, expected: Expected, report: Report) -> None:
    """Compare every frame of every episode."""
    report.equal("frames", len(dataset), sum(one["length"] for one in expected.episodes))
    report.equal("episodes", int(dataset.num_episodes), len(expected.episodes))
    report.equal("fps", dataset.fps, expected.fps)
    index = 0
    for number, about in enumerate(expected.episodes):
        values = expected.values(number)
        for t in range(about["length"]):
            item = dataset[index]
            report.equal("task", item["task"], about["instruction"])
            if isinstance(dataset.meta.tasks, dict):  # openpi looks up the prompt itself (`PromptFromLeRobotTask`)
                report.equal("openpi: prompt", dataset.meta.tasks[int(item["task_index"])], about["instruction"])
            found = [int(item[key]) for key in ("index", "episode_index", "frame_index")]
            report.equal("indices", found, [index, number, t])
            report.close("timestamp", item["timestamp"], t / expected.fps, 1e-6)
            report.close("next.reward", item["next.reward"], values["rewards"][t], 0)
            report.equal("next.done", bool(item["next.done"]), bool(values["dones"][t]))
            for name in expected.names("array"):
                wanted = values[name][t]
                report.equal(name, np.asarray(item[name]), wanted[0] if wanted.shape == (1,) else wanted)
            for name in expected.names("depth", "mask"):
                report.equal(name, np.asarray(item[name]), values[name][t][..., 0])
            for name in expected.names("image"):
                report.close(name, pixels(item[name]), values[name][t], 1e-4)
            for name in expected.names("video"):
                report.at_least(f"{name} [dB]", psnr(pixels(item[name]), values[name][t]), MIN_PSNR)
            index += 1


def windows(kind: Any, folder: Path, expected: Expected, report: Report) -> None:
    """Compare windows of several times, which are padded at the ends of an episode."""
    offsets = [-1, 0, 2]
    names = [*expected.names("video")[:1], *expected.names("array")]
    deltas = {name: [k / expected.fps for k in offsets] for name in names}
    dataset, index = kind("local/dataset", root=folder, delta_timestamps=deltas), 0
    for number, about in enumerate(expected.episodes):
        values = expected.values(number)
        for t in range(about["length"]):
            item, times = dataset[index], np.clip([t + k for k in offsets], 0, about["length"] - 1)
            for name in names:
                padded = [not 0 <= t + k < about["length"] for k in offsets]
                report.equal("windows: padding", np.asarray(item[f"{name}_is_pad"]).tolist(), padded)
                if name in expected.names("array"):
                    wanted = values[name][times]
                    report.equal("windows: arrays", np.asarray(item[name]).reshape(wanted.shape), wanted)
                else:
                    worst = min(psnr(pixels(one), values[name][k]) for one, k in zip(item[name], times, strict=True))
                    report.at_least("windows: video [dB]", worst, MIN_PSNR)
            index += 1


def subset(kind: Any, folder: Path, expected: Expected, report: Report) -> None:
    """Load the last episode alone."""
    last = len(expected.episodes) - 1
    dataset, about = kind("local/dataset", root=folder, episodes=[last]), expected.episodes[last]
    report.equal("one episode", len(dataset), about["length"])
    item, values = dataset[about["length"] - 1], expected.values(last)
    report.equal("one episode: task", item["task"], about["instruction"])
    for name in expected.names("video"):
        report.at_least("one episode: video [dB]", psnr(pixels(item[name]), values[name][-1]), MIN_PSNR)


def batches(dataset: Any, expected: Expected, report: Report) -> None:
    """Load everything in batches, in two processes."""
    import torch

    count, texts = 0, set()
    for batch in torch.utils.data.DataLoader(dataset, batch_size=8, num_workers=2, shuffle=True):
        count += len(batch["index"])
        texts |= set(batch["task"])
        for name in expected.names("video", "image"):
            report.equal("batches: image", str(batch[name].dtype), "torch.float32")
    report.equal("batches: frames", count, len(dataset))
    report.equal("batches: tasks", sorted(texts), sorted({one["instruction"] for one in expected.episodes}))


def statistics(dataset: Any, expected: Expected, report: Report) -> None:
    """Compare the statistics that LeRobot normalizes with."""
    found = dataset.meta.stats
    for name, wanted in expected.statistics.items():
        if expected.features[name]["kind"] == "depth" or name not in found:
            continue
        scale = 255.0 if expected.features[name]["kind"] in ("video", "image") else 1.0
        for key in [key for key in wanted if key in found[name]]:
            one = np.asarray(found[name][key], np.float64).reshape(-1)
            bound = 0.0 if key == "count" else 1e-6
            target = np.asarray(wanted[key], np.float64).reshape(-1) / (1.0 if key == "count" else scale)
            report.close(f"statistics: {key}", one, target, bound)
        if scale != 1.0:
            report.equal("statistics: image shape", np.asarray(found[name]["mean"]).shape, (3, 1, 1))


if __name__ == "__main__":
    main(check)
