"""Render splats and objects with MuJoCo Warp on a CPU: ``python warp_splats.py REQUEST.npz ANSWER.npz``.

Runs in an environment of its own. The request has the model in XML with one camera, the size of its image, and the
splat; the answer has the image and the depth of the objects alone, and with the splat, both by one ray a pixel and by
sixteen.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np


def main(request: Path, answer: Path) -> None:
    """Answer a request."""
    import mujoco
    import mujoco_warp
    import warp

    warp.config.quiet = True
    asked = np.load(request)
    model = mujoco.MjModel.from_xml_string(str(asked["xml"]))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    width, height = (int(n) for n in asked["size"])
    splat = {f"splat_{key}": asked[key] for key in ("position", "rotation", "scale", "rgba")}
    found: dict[str, Any] = {}
    with warp.ScopedDevice("cpu"):
        on_device = mujoco_warp.put_model(model), mujoco_warp.put_data(model, data)
        for name, arguments in (("objects", {}), ("composite", splat)):
            for rays in (1, 4):
                context = mujoco_warp.create_render_context(
                    model, cam_res=(width, height), render_rgb=True, render_depth=True, samples_per_pixel=rays,
                    use_fast_math=False, **arguments,
                )  # fmt: skip
                mujoco_warp.refit_bvh(*on_device, context)
                mujoco_warp.render(*on_device, context)
                packed = context.rgb_data.numpy().reshape(height, width).astype(np.uint32)
                channels = [packed >> shift & 255 for shift in (16, 8, 0)]
                found[f"{name}_{rays}"] = np.stack(channels, axis=-1).astype(np.uint8)
                if rays == 1:  # later ones write the depth at the corner of a pixel
                    found[f"{name}_depth"] = context.depth_data.numpy().reshape(height, width)
    np.savez(answer, **found)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
