"""Load a dataset in the steps of GR00T's `LeRobotEpisodeLoader`, whose package is not on PyPI.

The steps are those of gr00t/data/dataset/lerobot_episode_loader.py: pandas reads the table of an episode, and its
columns are sliced as ``modality.json`` says; the instruction is looked up by index; torchcodec decodes the frames.
"""

from __future__ import annotations

import json
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from tests.corpora.readers.comparison import Expected, Report, main, psnr
from tests.corpora.readers.lerobot_reader import MIN_PSNR


def check(folder: Path, expected: Expected, report: Report) -> str:
    """Load every episode, and slice the statistics."""
    meta = {name: json.loads((folder / f"meta/{name}.json").read_text()) for name in ("info", "modality", "stats")}
    tasks = {row["task_index"]: row["task"] for row in lines(folder / "meta/tasks.jsonl")}
    for row in lines(folder / "meta/episodes.jsonl"):
        episode(folder, meta, tasks, row, expected, report)
    for modality in ("state", "action"):
        for group in meta["modality"][modality].values():
            column, name = slice(group["start"], group["end"]), group["original_key"]
            for key, values in meta["stats"][name].items():
                wanted = np.asarray(expected.statistics[name][key])[column]
                report.close(f"statistics: {key}", np.asarray(values)[column], wanted, 1e-6)
    return f"steps of GR00T, pandas {version('pandas')}, torchcodec {version('torchcodec')}"


def episode(
    folder: Path, meta: dict[str, Any], tasks: dict[int, str], row: dict[str, Any], expected: Expected, report: Report
) -> None:
    """Compare one episode."""
    import pandas
    from torchcodec.decoders import VideoDecoder

    info, modality, number = meta["info"], meta["modality"], row["episode_index"]
    place = {"episode_chunk": number // info["chunks_size"], "episode_index": number}
    table = pandas.read_parquet(folder / info["data_path"].format(**place))
    values, about = expected.values(number), expected.episodes[number]
    report.equal("frames", len(table), min(about["length"], row["length"]))
    key = modality["annotation"]["human.task_description"]["original_key"]
    report.equal("instruction", set(table[key].map(tasks)), {about["instruction"]})
    for kind in ("state", "action"):
        covered = 0
        for group in modality[kind].values():
            name, start, end = group["original_key"], group["start"], group["end"]
            found = np.stack([one[start:end] if isinstance(one, np.ndarray) else [one] for one in table[name]])
            report.equal(f"{kind}: slices", found, values[name][:, start:end])
            covered += end - start
        role = {"state": "observation", "action": "action"}[kind]
        vectors = [one for one in expected.features.values() if one["kind"] == "array" and one["role"] == role]
        report.equal(f"{kind}: everything", covered, sum(one["shape"][0] for one in vectors))
    report.equal("videos", len(modality["video"]), len(expected.names("video")))
    for group in modality["video"].values():
        name = group["original_key"]
        video = VideoDecoder(str(folder / info["video_path"].format(**place, video_key=name)))
        frames = video.get_frames_at(list(range(about["length"]))).data.numpy().transpose(0, 2, 3, 1)
        report.equal("video: frames", len(video), about["length"])
        for frame, wanted in zip(frames, values[name], strict=True):
            report.at_least("video [dB]", psnr(frame, wanted), MIN_PSNR)


def lines(path: Path) -> list[Any]:
    """Return the values of a file with one JSON value per line."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


if __name__ == "__main__":
    main(check)
