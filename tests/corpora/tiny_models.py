"""Example servers with real classes of transformers and random weights: ``python -m tests.corpora.tiny_models PYTHON``.

PYTHON is the interpreter of an environment with torch, torchvision and transformers:

    python3.11 -m venv ENV && ENV/bin/pip install torch==2.13.0 torchvision==0.28.0 transformers==5.23.0

The models are built from their configurations, saved, loaded by the servers, and asked by our client over a process,
whose checks their answers must pass. What they find is as random as their weights, so that only shapes, types, prompts
and repeatability count.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from simfoundry.models.client import ModelClient
from simfoundry.models.tasks.masks import BundleMasks, SegmentationPrompt
from simfoundry.models.transports.process import ProcessTransport
from tests.conftest import REPOSITORY

SCRIPT = "tests.corpora.readers.tiny_models"
SERVERS = REPOSITORY / "examples" / "servers"
LIMIT_S = 300.0

SHAPE = (120, 160)


def main(python: str) -> int:
    """Ask both servers twice, and print what they answer."""
    rng = np.random.default_rng(0)
    frames = tuple(rng.integers(0, 255, (*SHAPE, 3), dtype=np.uint8) for _ in range(4))
    mask = np.zeros((2, *SHAPE), bool)
    mask[0, 30:60, 40:90], mask[1, 70:110, 20:60] = True, True

    def masks(name: str) -> BundleMasks:
        return BundleMasks(ModelClient(ProcessTransport((python, "-m", SCRIPT, name, str(SERVERS)), LIMIT_S)))

    def segment() -> np.ndarray:
        prompt = SegmentationPrompt(phrases=("blue mug", "box"))
        found = masks("sam3").segment(frames[0], prompt)
        assert set(found.prompts.tolist()) <= {0, 1} and ((found.scores >= 0) & (found.scores <= 1)).all()
        assert found.made_by.name == "sam3"
        return found.masks

    def box() -> np.ndarray:
        return masks("sam3").segment(frames[0], SegmentationPrompt(boxes=((10.0, 10.0, 60.0, 60.0),))).masks

    def track() -> np.ndarray:
        found = masks("sam2").track(frames, mask, keyframe=1)
        assert (found.masks[1] == mask).all() and found.made_by.name == "sam2.1"
        return found.masks

    for name, ask in (("sam3, two phrases", segment), ("sam3, a box", box), ("sam2.1, two objects", track)):
        start = time.perf_counter()
        first, again = ask(), ask()
        assert (first == again).all(), f"{name} answers differently the second time"
        print(f"{name:<22} masks {first.shape}, the same twice, {time.perf_counter() - start:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
