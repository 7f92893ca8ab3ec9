"""NVIDIA's commercial FoundationStereo (`nvidia/c-foundationstereo-s`) from its ONNX file, as a server of `stereo`.

pip install onnxruntime-gpu numpy pillow; set SIMFOUNDRY_STEREO_ONNX to the file. The names and the size of the inputs
are read from the file. Images are normalized by ImageNet's mean and deviation, which is an assumption: check the card
of the file that you use.
"""

from __future__ import annotations

import os
import sys
from functools import lru_cache
from typing import Any

import numpy as np
from scaffold import Model, RefusedError, Result, run
from serve_foundation_stereo import measured

MEAN, DEVIATION = np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225])


@lru_cache(maxsize=1)
def load() -> Any:
    """Return the session."""
    import onnxruntime

    path = os.environ.get("SIMFOUNDRY_STEREO_ONNX", "")
    if not path:
        raise RefusedError("set SIMFOUNDRY_STEREO_ONNX on the server to the ONNX file of c-foundationstereo-s")
    return onnxruntime.InferenceSession(path, providers=onnxruntime.get_available_providers())


def stereo(request: Any) -> Result:
    """Match a stereo pair at the size of the network."""
    from PIL import Image

    session = load()
    inputs = sorted(session.get_inputs(), key=lambda one: "right" in one.name)  # left_image, right_image
    if len(inputs) != 2 or "right" not in inputs[1].name:
        raise RefusedError(f"the ONNX file has the inputs {[one.name for one in inputs]}, not a left and a right image")
    images = [request.members[side].pixels for side in ("left", "right")]
    height, width = images[0].shape[:2]
    rows, columns = (size if isinstance(size, int) else side // 32 * 32
                     for size, side in zip(inputs[0].shape[-2:], (height, width)))  # fmt: skip
    planes = []
    for image in images:
        small = np.asarray(Image.fromarray(image).resize((columns, rows)), np.float64) / 255
        planes.append(((small - MEAN) / DEVIATION).transpose(2, 0, 1)[None].astype(np.float32))
    found = session.run(None, {one.name: plane for one, plane in zip(inputs, planes)})[0]
    small = Image.fromarray(np.asarray(found, np.float32).reshape(rows, columns))
    disparity = np.asarray(small.resize((width, height)), np.float32) * (width / columns)
    return measured(disparity, request.members["K"], float(request.members["baseline"][0]))


MODEL = Model(
    {"name": "c-foundationstereo-s", "version": "1", "licence": "NVIDIA Open Model Agreement", "commercial": True},
    {"stereo": stereo},
)

if __name__ == "__main__":
    sys.exit(run(MODEL))
