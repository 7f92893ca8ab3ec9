"""Load a dataset with TensorFlow Datasets, and as openpi's loader of DROID does."""

from __future__ import annotations

import os
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from tests.corpora.readers.comparison import Expected, Report, main


def path_of(name: str) -> list[str]:
    """Return the keys under which an observation, or a feature with a path as its name, is in a step."""
    if "/" in name:
        return name.split("/")
    return ["observation", name.removeprefix("observation.").removeprefix("images.").replace(".", "_")]


def found_at(step: Any, keys: list[str]) -> Any:
    """Return the value at nested keys."""
    for key in keys:
        step = step[key]
    return step


def check(folder: Path, expected: Expected, report: Report) -> str:
    """Load every step of every split, a part of a split, and undecoded images."""
    os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"
    import tensorflow_datasets as tfds

    (place,) = folder.glob("*/*/features.json")
    builder = tfds.builder_from_directory(str(place.parent))
    named = tfds.builder(builder.name, data_dir=str(folder))
    report.equal("found by name", named.info.full_name, builder.info.full_name)
    for split, (first, end) in expected.splits.items():
        report.equal("episodes", builder.info.splits[split].num_examples, end - first)
        for k, episode in zip(range(first, end), builder.as_dataset(split=split), strict=True):
            steps(episode, k, expected, report)
    some = next(name for name, (first, end) in expected.splits.items() if end > first)
    part = builder.as_dataset(split=f"{some}[:1]")
    report.equal("part of a split", len(part), 1)
    droid(builder, some, expected, report)
    return f"tensorflow_datasets {version('tensorflow-datasets')}"


def steps(episode: Any, number: int, expected: Expected, report: Report) -> None:
    """Compare the steps of an episode."""
    values, about = expected.values(number), expected.episodes[number]
    report.equal("metadata: index", int(episode["episode_metadata"]["episode_index"]), number)
    actions = [name for name, one in expected.features.items() if one["role"] == "action" and "/" not in name]
    joined = np.concatenate([values[name] for name in actions], axis=1)
    found = list(episode["steps"].as_numpy_iterator())
    report.equal("steps", len(found), about["length"])
    for t, step in enumerate(found):
        report.equal("action", step["action"], joined[t])
        report.equal("reward", float(step["reward"]), float(values["rewards"][t]))
        flags = [bool(step["is_first"]), bool(step["is_last"])]
        report.equal("is_first, is_last", flags, [t == 0, t == about["length"] - 1])
        report.equal("instruction", step["language_instruction"].decode(), about["instruction"])
        for name in expected.features:
            if name not in actions:
                report.equal(name, found_at(step, path_of(name)), values[name][t])
        for path, wanted in parts(expected, actions, joined[t]):
            report.equal(path, found_at(step, path.split("/")), wanted)


def parts(expected: Expected, actions: list[str], joined: Any) -> Any:
    """Yield the quantities in an action, unless features have these paths."""
    column = 0
    for name in actions:
        for part, start, stop in expected.features[name]["parts"]:
            if not any(other.startswith("action_dict/") for other in expected.features):
                yield f"action_dict/{part}", joined[column + start : column + stop]
        column += expected.features[name]["shape"][0]


def droid(builder: Any, split: str, expected: Expected, report: Report) -> None:
    """Read a split as openpi's `DroidRldsDataset` does: images are decoded by TensorFlow, paths contain `success`."""
    import tensorflow as tf
    import tensorflow_datasets as tfds

    name = next(iter(expected.names("video", "image")), None)
    decoders = {"steps": tfds.decode.SkipDecoding()}
    for episode in builder.as_dataset(split=split, decoders=decoders):
        path = episode["episode_metadata"]["file_path"]
        report.equal("openpi: path", bool(tf.strings.regex_full_match(path, ".*success.*")), True)
        number, trajectory = int(episode["episode_metadata"]["episode_index"]), episode["steps"]
        values = expected.values(number)
        texts = [trajectory[key][0].numpy() for key in ("language_instruction_2", "language_instruction_3")]
        report.equal("openpi: instructions", {t.decode() for t in texts}, {expected.episodes[number]["instruction"]})
        if name is not None:
            image = tf.io.decode_image(found_at(trajectory, path_of(name))[0], expand_animations=False, dtype=tf.uint8)
            report.equal("openpi: image", image.numpy(), values[name][0])
        for kind in ("joint_position", "joint_velocity"):
            if f"action_dict/{kind}" in expected.features:
                keys = (kind, "gripper_position")
                joined = tf.concat([trajectory["action_dict"][key] for key in keys], axis=-1)
                wanted = np.concatenate([values[f"action_dict/{key}"] for key in keys], axis=1)
                report.equal(f"openpi: {kind}", joined.numpy(), wanted)


if __name__ == "__main__":
    main(check)
