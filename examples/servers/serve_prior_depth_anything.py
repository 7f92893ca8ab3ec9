"""PriorDepthAnything as a server of `complete_depth`. It contains weights that may not be used commercially.

pip install prior-depth-anything torch-cluster; a CUDA device is needed.
"""

from __future__ import annotations

import sys
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from scaffold import Model, Result, run

SIZE = "vitb"


@lru_cache(maxsize=1)
def load() -> Any:
    """Return the model."""
    from prior_depth_anything import PriorDepthAnything

    return PriorDepthAnything(device="cuda:0", frozen_model_size=SIZE, conditioned_model_size=SIZE, coarse_only=False)


def complete_depth(request: Any) -> Result:
    """Fill the holes of a depth map. The model reads files: PNG, and NPY in meters with 0 for missing values."""
    from PIL import Image

    depth = np.where(request.members["mask"], 0, request.members["depth"]).astype(np.float32)
    with tempfile.TemporaryDirectory() as folder:
        image, prior = Path(folder) / "rgb.png", Path(folder) / "prior.npy"
        Image.fromarray(request.members["image"].pixels).save(image)
        np.save(prior, depth)
        found = load().infer_one_sample(image=str(image), prior=str(prior), geometric=None, pattern=None)
    filled = np.asarray(found.cpu() if hasattr(found, "cpu") else found, np.float32).reshape(depth.shape)
    filled = np.where(np.isfinite(filled) & (filled > 0), filled, 0)
    return Result({"depth": filled.astype(np.float32)}, {"depth": {"unit": "m", "frame": "camera_opencv"}})


MODEL = Model(
    {
        "name": "prior-depth-anything",
        "version": f"1.1-{SIZE}",
        "licence": "Apache-2.0, CC-BY-NC-4.0",
        "commercial": False,
    },
    {"complete_depth": complete_depth},
)

if __name__ == "__main__":
    sys.exit(run(MODEL))
