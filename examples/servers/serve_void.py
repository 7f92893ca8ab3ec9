"""VOID as a server of `inpaint_video`: objects removed from a video, by the first pass of its command line.

Run it in a checkout of https://github.com/netflix/void-model with 40 GB of GPU memory; VOID_BASE and VOID_PASS1 name
the weights. pip install imageio[ffmpeg].
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
from scaffold import BundleImage, Model, RefusedError, Result, run

WIDTH, HEIGHT, LONGEST = 672, 384, 197  # size of the model's frames [px], and their largest number
REMOVE, KEEP = 0, 255  # gray levels of its mask; 63 and 127 are for regions that the objects affect
RATE = 12  # frames per second, which the result does not depend on


def inpaint_video(request: Any) -> Result:
    """Remove what the masks cover."""
    import imageio.v3 as imageio
    from PIL import Image

    frames, masks = [frame.pixels for frame in request.members["frames"]], request.members["masks"]
    height, width = frames[0].shape[:2]
    if len(frames) > LONGEST:
        raise RefusedError(f"VOID takes at most {LONGEST} frames at a time, not {len(frames)}; send them in chunks")
    gray = np.where(masks, REMOVE, KEEP).astype(np.uint8)
    with tempfile.TemporaryDirectory() as folder:
        scene, out = Path(folder) / "data" / "scene", Path(folder) / "out"
        scene.mkdir(parents=True)
        small = [np.asarray(Image.fromarray(frame).resize((WIDTH, HEIGHT))) for frame in frames]
        quad = [np.asarray(Image.fromarray(one).resize((WIDTH, HEIGHT), Image.Resampling.NEAREST)) for one in gray]
        imageio.imwrite(scene / "input_video.mp4", np.array(small), fps=RATE)
        imageio.imwrite(scene / "quadmask_0.mp4", np.repeat(np.array(quad)[..., None], 3, axis=3), fps=RATE)
        words = request.head["parameters"].get("prompt") or "an empty scene"
        (scene / "prompt.json").write_text(json.dumps({"bg": words}))
        command = [
            sys.executable, "inference/cogvideox_fun/predict_v2v.py", "--config", "config/quadmask_cogvideox.py",
            f"--config.data.data_rootdir={scene.parent}", f"--config.data.sample_size={HEIGHT}x{WIDTH}",
            f"--config.data.max_video_length={LONGEST}", "--config.experiment.run_seqs=scene",
            f"--config.experiment.save_path={out}",
            f"--config.video_model.model_name={os.environ.get('VOID_BASE', 'CogVideoX-Fun-V1.5-5b-InP')}",
            f"--config.video_model.transformer_path={os.environ.get('VOID_PASS1', 'void_pass1.safetensors')}",
        ]  # fmt: skip
        subprocess.run(command, check=True, stdout=sys.stderr)
        videos = sorted(path for path in out.rglob("*.mp4") if "tuple" not in path.name)  # tuples show all side by side
        found = list(imageio.imread(videos[0]))
    if len(found) < len(frames):
        raise RuntimeError(f"VOID returned {len(found)} of {len(frames)} frames")
    sized = [Image.fromarray(frame[..., :3]).resize((width, height)) for frame in found[: len(frames)]]
    return Result({"frames": tuple(BundleImage(np.asarray(one)) for one in sized)})


MODEL = Model(
    {"name": "void", "version": "pass1", "licence": "CogVideoX licence", "commercial": None},
    {"inpaint_video": inpaint_video},
)

if __name__ == "__main__":
    sys.exit(run(MODEL))
