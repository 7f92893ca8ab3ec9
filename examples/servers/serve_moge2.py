"""MoGe-2 as a server of `depth`.

pip install git+https://github.com/microsoft/MoGe.git
"""

from __future__ import annotations

import sys
from functools import lru_cache
from typing import Any

import numpy as np
from scaffold import Model, Result, run

WEIGHTS = "Ruicheng/moge-2-vitl-normal"


@lru_cache(maxsize=1)
def load() -> Any:
    """Return the model."""
    import torch
    from moge.model.v2 import MoGeModel

    return MoGeModel.from_pretrained(WEIGHTS).to("cuda" if torch.cuda.is_available() else "cpu").eval()


def depth(request: Any) -> Result:
    """Estimate depth, and the focal length if it is not known."""
    import torch

    image, K = request.members["image"].pixels, request.members.get("K")
    height, width = image.shape[:2]
    model = load()
    planes = torch.as_tensor(np.ascontiguousarray(image.transpose(2, 0, 1)) / np.float32(255))
    fov_x = None if K is None else float(np.degrees(2 * np.arctan(width / 2 / K[0, 0])))
    found = model.infer(planes.to(model.device), fov_x=fov_x)
    z = np.asarray(found["depth"].cpu(), np.float32)  # infinite where the mask is False
    meters = np.where(np.asarray(found["mask"].cpu(), bool) & np.isfinite(z), z, 0).astype(np.float32)
    if K is None:  # its intrinsics are fractions of the width and height
        K = np.diag([width, height, 1.0]) @ np.asarray(found["intrinsics"].cpu(), np.float64)
    return Result({"depth": meters, "K": K}, {"depth": {"unit": "m", "frame": "camera_opencv"}})


MODEL = Model(
    {"name": "moge-2-vitl-normal", "version": WEIGHTS, "licence": "MIT", "commercial": True}, {"depth": depth}
)

if __name__ == "__main__":
    sys.exit(run(MODEL))
