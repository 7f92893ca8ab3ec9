"""FoundationStereo as a server of `stereo`. For research only; `serve_c_foundation_stereo.py` may be used commercially.

Run it in a checkout of https://github.com/NVlabs/FoundationStereo, with the weights in pretrained_models/23-51-11.
"""

from __future__ import annotations

import sys
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from scaffold import Model, Result, run

CHECKPOINT = Path("pretrained_models/23-51-11/model_best_bp2.pth")
ITERATIONS = 32
LARGE = 1000  # px: wider images are solved hierarchically


@lru_cache(maxsize=1)
def load() -> Any:
    """Return the model."""
    import torch
    from core.foundation_stereo import FoundationStereo
    from omegaconf import OmegaConf

    config = OmegaConf.load(str(CHECKPOINT.parent / "cfg.yaml"))
    if "vit_size" not in config:
        config["vit_size"] = "vitl"
    config["valid_iters"], config["hiera"] = ITERATIONS, 0
    model = FoundationStereo(OmegaConf.create(config))
    model.load_state_dict(torch.load(str(CHECKPOINT), weights_only=False)["model"])
    return model.cuda().eval()


def stereo(request: Any) -> Result:
    """Match a stereo pair."""
    import torch
    from core.utils.utils import InputPadder

    left, right = (request.members[side].pixels for side in ("left", "right"))
    height, width = left.shape[:2]
    pair = [torch.as_tensor(side).cuda().float()[None].permute(0, 3, 1, 2) for side in (left, right)]  # 0 to 255
    padder = InputPadder(pair[0].shape, divis_by=32, force_square=False)
    model, padded = load(), padder.pad(*pair)
    with torch.inference_mode(), torch.cuda.amp.autocast(True):
        if width > LARGE:
            found = model.run_hierachical(*padded, iters=ITERATIONS, test_mode=True, small_ratio=0.5)
        else:
            found = model.forward(*padded, iters=ITERATIONS, test_mode=True)
    disparity = np.asarray(padder.unpad(found.float()).cpu(), np.float32).reshape(height, width)
    return measured(disparity, request.members["K"], float(request.members["baseline"][0]))


def measured(disparity: Any, K: Any, baseline_m: float) -> Result:
    """Return disparity and depth; what the right camera does not see is not valid."""
    valid = (disparity > 0) & (np.arange(disparity.shape[1])[None] - disparity >= 0)
    shift = np.where(valid, disparity, 0).astype(np.float32)
    depth = np.where(valid, K[0, 0] * baseline_m / np.where(valid, disparity, 1), 0).astype(np.float32)
    notes = {"disparity": {"unit": "px"}, "depth": {"unit": "m", "frame": "camera_opencv"}}
    return Result({"disparity": shift, "depth": depth, "valid": valid}, notes)


MODEL = Model(
    {"name": "foundationstereo", "version": "23-51-11", "licence": "NVIDIA source code licence", "commercial": False},
    {"stereo": stereo},
)

if __name__ == "__main__":
    sys.exit(run(MODEL))
