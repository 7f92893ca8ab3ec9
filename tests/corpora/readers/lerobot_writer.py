"""Write a dataset with the real LeRobot, so that SimFoundry can read it: python -m … EXPECTED OUT."""

from __future__ import annotations

import json
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

from tests.corpora.readers.comparison import Expected
from tests.corpora.readers.cpu_torch import define_operators


def main() -> None:
    """Write the arrays, images and videos that LeRobot supports."""
    define_operators()
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    expected, out = Expected(Path(sys.argv[1])), Path(sys.argv[2])
    names = expected.names("array", "video", "image")
    features: dict[str, dict[str, Any]] = {}
    for name in names:
        one = expected.features[name]
        axes = ["height", "width", "channels"] if one["kind"] != "array" else [f"v{k}" for k in range(one["shape"][0])]
        dtype = "float32" if one["kind"] == "array" else one["kind"]
        features[name] = {"dtype": dtype, "shape": tuple(one["shape"]), "names": axes}
    dataset = LeRobotDataset.create("local/written", fps=int(expected.fps), features=features, root=out)
    for number, about in enumerate(expected.episodes):
        values = expected.values(number)
        for t in range(about["length"]):
            add(dataset, {name: values[name][t] for name in names}, about["instruction"])
        dataset.save_episode()
    if hasattr(dataset, "finalize"):
        dataset.finalize()
    print(json.dumps({"reader": f"lerobot {version('lerobot')}", "checks": {}}))


def add(dataset: Any, frame: dict[str, Any], task: str) -> None:
    """Add a frame: the sentence is an argument before LeRobot 0.4, and a key afterward."""
    try:
        dataset.add_frame(frame, task=task)
    except TypeError:
        dataset.add_frame({**frame, "task": task})


if __name__ == "__main__":
    main()
