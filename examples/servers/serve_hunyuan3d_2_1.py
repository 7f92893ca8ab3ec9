"""Hunyuan3D-2.1 as a server of `mesh`: shape, and a texture if it is wanted.

Run it in a checkout of https://github.com/Tencent-Hunyuan/Hunyuan3D-2.1. Shape and texture take 29 GiB of GPU memory.
The licence grants no rights in the European Union, the United Kingdom and South Korea.
"""

from __future__ import annotations

import sys
import tempfile
from functools import lru_cache
from pathlib import Path
from typing import Any

from scaffold import BundleFile, Model, Result, run

WEIGHTS = "tencent/Hunyuan3D-2.1"
sys.path[:0] = ["hy3dshape", "hy3dpaint"]  # the folders of the checkout


@lru_cache(maxsize=1)
def load_shape() -> Any:
    """Return the pipeline that makes shapes."""
    from hy3dshape.pipelines import Hunyuan3DDiTFlowMatchingPipeline

    return Hunyuan3DDiTFlowMatchingPipeline.from_pretrained(WEIGHTS)


@lru_cache(maxsize=1)
def load_paint() -> Any:
    """Return the pipeline that makes textures."""
    from textureGenPipeline import Hunyuan3DPaintConfig, Hunyuan3DPaintPipeline

    return Hunyuan3DPaintPipeline(Hunyuan3DPaintConfig(max_num_view=6, resolution=512))


def mesh(request: Any) -> Result:
    """Reconstruct the object in an RGBA image."""
    import torch
    from PIL import Image

    wanted = request.head["parameters"]
    image = Image.fromarray(request.members["image"].pixels)
    (shape,) = load_shape()(
        image=image, num_inference_steps=50, guidance_scale=5.0, octree_resolution=384, num_chunks=8000,
        generator=torch.manual_seed(request.head["seed"]), output_type="trimesh",
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        bare, picture, painted = (Path(folder) / name for name in ("bare.glb", "image.png", "painted.obj"))
        shape.export(bare)
        if not wanted.get("texture", True):
            return answer(bare)
        image.save(picture)
        load_paint()(mesh_path=str(bare), image_path=str(picture), output_mesh_path=str(painted))
        return answer(painted.with_suffix(".glb"))  # written beside the OBJ file


def answer(path: Path) -> Result:
    """Return a GLB file. Its axes are those of glTF, viewed by the image from +z."""
    return Result({"mesh": BundleFile("glb", path.read_bytes())}, {"mesh": {"frame": "gltf_y_up"}})


MODEL = Model(
    {
        "name": "hunyuan3d-2.1",
        "version": WEIGHTS,
        "licence": "Tencent Hunyuan 3D community licence",
        "commercial": None,
    },
    {"mesh": mesh},
)

if __name__ == "__main__":
    sys.exit(run(MODEL))
