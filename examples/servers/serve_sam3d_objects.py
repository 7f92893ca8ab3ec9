"""SAM 3D Objects as a server of `mesh`.

Run it in the folder `notebook` of https://github.com/facebookresearch/sam-3d-objects, with 32 GB of GPU memory and the
gated weights in ../checkpoints/hf.
"""

from __future__ import annotations

import sys
from functools import lru_cache
from typing import Any

from scaffold import BundleFile, Model, RefusedError, Result, run

CONFIG = "../checkpoints/hf/pipeline.yaml"


@lru_cache(maxsize=1)
def load() -> Any:
    """Return the pipeline."""
    from inference import Inference

    return Inference(CONFIG, compile=False)


def mesh(request: Any) -> Result:
    """Reconstruct the object in an RGBA image, whose opacity is the mask."""
    pixels = request.members["image"].pixels
    found = load()(pixels[..., :3], pixels[..., 3] > 127, seed=request.head["seed"])
    if found.get("glb") is None:
        raise RefusedError("SAM 3D Objects returned no mesh for this image")
    data = found["glb"].export(file_type="glb")
    return Result({"mesh": BundleFile("glb", data)}, {"mesh": {"frame": "gltf_y_up"}})


MODEL = Model({"name": "sam-3d-objects", "version": "hf", "licence": "SAM License", "commercial": True}, {"mesh": mesh})

if __name__ == "__main__":
    sys.exit(run(MODEL))
