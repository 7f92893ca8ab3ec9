"""FoundationPose as a server of `pose`. For research only; NVIDIA's TAO version may be used commercially.

Run it in a checkout of https://github.com/NVlabs/FoundationPose, with the weights in weights/.
"""

from __future__ import annotations

import io
import sys
from functools import lru_cache
from typing import Any

import numpy as np
from scaffold import Model, RefusedError, Result, run

ITERATIONS = 5
NEAREST = 0.1  # m: depth below it is ignored by the model
FEWEST = 4  # pixels: with fewer, the model returns the identity without a word


@lru_cache(maxsize=1)
def load() -> tuple[Any, Any, Any]:
    """Return the scorer, the refiner and the rasterizer."""
    import nvdiffrast.torch as dr
    from estimater import PoseRefinePredictor, ScorePredictor

    return ScorePredictor(), PoseRefinePredictor(), dr.RasterizeCudaContext()


def pose(request: Any) -> Result:
    """Estimate the pose of the GLB's own axes in the camera. The mesh is in meters; its size is not estimated."""
    import trimesh
    from estimater import FoundationPose

    depth = np.asarray(request.members["depth"], np.float32)
    mask = request.members["mask"]
    if np.count_nonzero(depth[mask] >= NEAREST) < FEWEST:
        raise RefusedError(f"fewer than {FEWEST} pixels of the mask have a depth of {NEAREST} m or more")
    mesh = trimesh.load(io.BytesIO(request.members["mesh"].data), file_type="glb", force="mesh")
    scorer, refiner, context = load()
    estimator = FoundationPose(
        model_pts=mesh.vertices, model_normals=mesh.vertex_normals, mesh=mesh, scorer=scorer, refiner=refiner,
        glctx=context, symmetry_tfs=None,
    )  # fmt: skip
    best = estimator.register(
        K=request.members["K"], rgb=request.members["image"].pixels, depth=depth, ob_mask=mask, iteration=ITERATIONS
    )
    scores = np.asarray([float(score) for score in estimator.scores[:1]] or [0.0], np.float64)
    X_CO = np.asarray(best, np.float64).reshape(1, 4, 4)
    return Result(
        {"object_to_camera": X_CO, "scores": scores}, {"object_to_camera": {"unit": "m", "frame": "camera_opencv"}}
    )


MODEL = Model(
    {"name": "foundationpose", "version": "2024-01", "licence": "NVIDIA source code licence", "commercial": False},
    {"pose": pose},
)

if __name__ == "__main__":
    sys.exit(run(MODEL))
