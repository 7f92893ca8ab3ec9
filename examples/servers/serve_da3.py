"""Depth Anything 3 as a server of `depth` (metric large) and `multiview` (nested giant large).

pip install depth-anything-3, which needs numpy < 2. The nested model may not be used commercially.
"""

from __future__ import annotations

import sys
from functools import lru_cache
from typing import Any

import numpy as np
from scaffold import Model, RefusedError, Result, run

METRIC, NESTED = "depth-anything/DA3METRIC-LARGE", "depth-anything/DA3NESTED-GIANT-LARGE"
CANONICAL_FOCAL = 300.0  # px: meters = depth * focal length / 300, with the focal length of the processed image
DEPTH = {"unit": "m", "frame": "camera_opencv"}


@lru_cache(maxsize=1)
def load(weights: str) -> Any:
    """Return the model."""
    import torch
    from depth_anything_3.api import DepthAnything3

    return DepthAnything3.from_pretrained(weights).to("cuda" if torch.cuda.is_available() else "cpu")


def resized(values: Any, width: int, height: int) -> Any:
    """Return an array at the size of the image. Depth is not blended across edges."""
    from PIL import Image

    image = Image.fromarray(np.ascontiguousarray(values, dtype=np.float32))
    return np.asarray(image.resize((width, height), Image.Resampling.NEAREST), np.float32)


def depth(request: Any) -> Result:
    """Estimate the depth of one image, whose focal length must be known."""
    image, K = request.members["image"].pixels, request.members.get("K")
    if K is None:
        raise RefusedError("DA3METRIC-LARGE needs the intrinsic matrix `K`, because its depth scales with it")
    height, width = image.shape[:2]
    found = load(METRIC).inference(image=[image], process_res=504, process_res_method="upper_bound_resize")
    raw = np.asarray(found.depth[0], np.float32)
    focal = (K[0, 0] * raw.shape[1] / width + K[1, 1] * raw.shape[0] / height) / 2
    meters = resized(raw * focal / CANONICAL_FOCAL, width, height)
    sky = getattr(found, "sky", None)
    if sky is not None:
        meters = np.where(resized(np.asarray(sky[0], np.float32), width, height) > 0.5, 0, meters)
    return Result({"depth": np.maximum(meters, 0).astype(np.float32), "K": K}, {"depth": DEPTH})


def multiview(request: Any) -> Result:
    """Estimate depth and poses of several images."""
    images = [image.pixels for image in request.members["images"]]
    height, width = images[0].shape[:2]
    found = load(NESTED).inference(image=images, process_res=504, process_res_method="upper_bound_resize")
    rows, columns = np.asarray(found.depth[0]).shape
    poses = np.tile(np.eye(4), (len(images), 1, 1))
    poses[:, :3] = np.asarray(found.extrinsics, np.float64)[:, :3]  # world to camera; (N, 3, 4) or (N, 4, 4)
    scale = np.diag([width / columns, height / rows, 1.0])
    K = np.array([scale @ np.asarray(k, np.float64) for k in found.intrinsics])  # given for the processed size
    depths = np.array([resized(one, width, height) for one in np.asarray(found.depth)])
    members = {"depth": np.maximum(depths, 0), "K": K, "world_to_camera": poses}
    if getattr(found, "conf", None) is not None:
        confidence = np.array([resized(one, width, height) for one in np.asarray(found.conf)])
        members["confidence"] = confidence / max(float(confidence.max()), 1e-6)  # not bounded by 1 in the model
    return Result(members, {"depth": DEPTH, "world_to_camera": DEPTH})


NAMES = {"depth": ("da3metric-large", METRIC, "Apache-2.0", True),
         "multiview": ("da3nested-giant-large", NESTED, "CC-BY-NC-4.0", False)}  # fmt: skip
SOLVERS = {"depth": depth, "multiview": multiview}
MODELS = {
    task: Model(dict(zip(("name", "version", "licence", "commercial"), row)), {task: SOLVERS[task]})
    for task, row in NAMES.items()
}

if __name__ == "__main__":  # the first argument chooses the model: depth or multiview
    sys.exit(run(MODELS[sys.argv[1]], sys.argv[2:]))
