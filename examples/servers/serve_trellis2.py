"""TRELLIS.2 as a server of `mesh`.

Run it in the environment of https://github.com/microsoft/TRELLIS.2, with 24 GB of GPU memory. The model is MIT, but the
export runs nvdiffrast and nvdiffrec, which are for research only.
"""

from __future__ import annotations

import sys
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

from scaffold import BundleFile, Model, Result, run

WEIGHTS = "microsoft/TRELLIS.2-4B"
TEXTURE = 2048  # px
RASTERIZER_FACES = 16_777_216  # limit of nvdiffrast


@lru_cache(maxsize=1)
def load() -> Any:
    """Return the pipeline."""
    from trellis2.pipelines import Trellis2ImageTo3DPipeline

    pipeline = Trellis2ImageTo3DPipeline.from_pretrained(WEIGHTS)
    pipeline.cuda()
    return pipeline


def mesh(request: Any) -> Result:
    """Reconstruct the object in an RGBA image; without a transparent background, the result is bad."""
    import o_voxel
    from PIL import Image

    wanted = request.head["parameters"]
    image = Image.fromarray(request.members["image"].pixels)
    found = load().run(image, seed=request.head["seed"])[0]
    found.simplify(RASTERIZER_FACES)
    made = o_voxel.postprocess.to_glb(
        vertices=found.vertices, faces=found.faces, attr_volume=found.attrs, coords=found.coords,
        attr_layout=found.layout, voxel_size=found.voxel_size, aabb=[[-0.5, -0.5, -0.5], [0.5, 0.5, 0.5]],
        decimation_target=wanted.get("faces", 20_000), texture_size=TEXTURE, remesh=True, remesh_band=1,
        remesh_project=0, verbose=False,
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mesh.glb"
        made.export(str(path))  # without WebP, which not every reader knows
        return Result({"mesh": BundleFile("glb", path.read_bytes())}, {"mesh": {"frame": "gltf_y_up"}})


MODEL = Model({"name": "trellis.2-4b", "version": WEIGHTS, "licence": "MIT", "commercial": None}, {"mesh": mesh})

if __name__ == "__main__":
    sys.exit(run(MODEL))
