"""nerfstudio's splatfacto as a server of `splat`: a Gaussian splat from images with poses, by its command line.

pip install nerfstudio==1.1.5. It needs a GPU; SPLATFACTO_STEPS is the number of steps.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from scaffold import BundleFile, Model, Result, run

X_CV_GL = np.diag([1.0, -1.0, -1.0, 1.0])  # from the axes of OpenGL's cameras, which nerfstudio has, to OpenCV's


def splat(request: Any) -> Result:
    """Train a splat in the frame of the poses. nerfstudio would otherwise turn, center and scale them."""
    images, points = [image.pixels for image in request.members["images"]], request.members["points"]
    with tempfile.TemporaryDirectory() as folder:
        data, out = Path(folder) / "data", Path(folder) / "out"
        data.mkdir()
        write_scene(data, images, request.members["K"], request.members["world_to_camera"], points)
        train = [
            "nerfstudio.scripts.train", "splatfacto", "--output-dir", str(out), "--experiment-name", "scene",
            "--timestamp", "run", "--vis", "tensorboard",
            "--max-num-iterations", os.environ.get("SPLATFACTO_STEPS", "30000"),
            "--pipeline.model.camera-optimizer.mode", "SO3xR3",
            "nerfstudio-data", "--data", str(data), "--orientation-method", "none", "--center-method", "none",
            "--auto-scale-poses", "False", "--eval-mode", "all", "--downscale-factor", "1", "--load-3D-points", "True",
        ]  # fmt: skip
        config = out / "scene" / "splatfacto" / "run" / "config.yml"
        export = [
            "nerfstudio.scripts.exporter",
            "gaussian-splat",
            "--load-config",
            str(config),
            "--output-dir",
            str(out),
        ]
        for command in (train, export):
            subprocess.run([sys.executable, "-m", *command], check=True, stdout=sys.stderr)
        made = (out / "splat.ply").read_bytes()
    unused = ("splatfacto does not use the depth",) if request.members.get("depth") is not None else ()
    return Result({"splat": BundleFile("ply", made)}, warnings=unused)


def write_scene(folder: Path, images: list[Any], K: Any, world_to_camera: Any, points: Any) -> None:
    """Write images, poses and seed points as nerfstudio's parser reads them."""
    from PIL import Image

    frames = []
    for k, image in enumerate(images):
        name = f"images/frame_{k:05d}.png"
        (folder / "images").mkdir(exist_ok=True)
        Image.fromarray(image).save(folder / name)
        pose = np.linalg.inv(world_to_camera[k]) @ X_CV_GL
        frames.append({
            "file_path": name, "transform_matrix": pose.tolist(), "h": image.shape[0], "w": image.shape[1],
            "fl_x": float(K[k][0, 0]), "fl_y": float(K[k][1, 1]),
            # The center of the first pixel is (0.5, 0.5) there.
            "cx": float(K[k][0, 2]) + 0.5, "cy": float(K[k][1, 2]) + 0.5,
        })  # fmt: skip
    scene = {"camera_model": "OPENCV", "frames": frames, "ply_file_path": "points.ply"}
    (folder / "transforms.json").write_text(json.dumps(scene))
    head = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
    head += [f"property float {axis}" for axis in "xyz"] + [f"property uchar {c}" for c in ("red", "green", "blue")]
    rows = [f"{x:.6g} {y:.6g} {z:.6g} 128 128 128" for x, y, z in points]
    (folder / "points.ply").write_text("\n".join([*head, "end_header", *rows]) + "\n")


MODEL = Model(
    {"name": "splatfacto", "version": "nerfstudio 1.1.5", "licence": "Apache-2.0", "commercial": True},
    {"splat": splat},
)

if __name__ == "__main__":
    sys.exit(run(MODEL))
