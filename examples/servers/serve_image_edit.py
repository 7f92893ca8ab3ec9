"""Qwen-Image-Edit of diffusers as a server of `edit` and `inpaint`. Another editor needs only another pipeline.

pip install diffusers transformers accelerate torch numpy pillow
"""

from __future__ import annotations

import sys
from functools import lru_cache
from typing import Any

import numpy as np
from scaffold import BundleImage, Model, Result, run

WEIGHTS = "Qwen/Qwen-Image-Edit"
STEPS, GUIDANCE = 50, 4.0  # as in the model's card


@lru_cache(maxsize=1)
def load() -> Any:
    """Return the pipeline."""
    import torch
    from diffusers import QwenImageEditPipeline

    return QwenImageEditPipeline.from_pretrained(WEIGHTS, torch_dtype=torch.bfloat16).to("cuda")


def drawn(image: Any, prompt: str, seed: int) -> Any:
    """Return an edited image, shape (H, W, 3), at the size that the model chooses."""
    import torch
    from PIL import Image

    found = load()(
        image=Image.fromarray(image), prompt=prompt, negative_prompt=" ", num_inference_steps=STEPS,
        true_cfg_scale=GUIDANCE, generator=torch.manual_seed(seed),
    )  # fmt: skip
    return np.asarray(found.images[0].convert("RGB"), np.uint8)


def edit(request: Any) -> Result:
    """Edit an image. Its transparent part is shown to the model in white, and white is made transparent again."""
    pixels = request.members["image"].pixels
    alpha = pixels[..., 3:] / 255
    shown = np.rint(pixels[..., :3] * alpha + 255 * (1 - alpha)).astype(np.uint8)
    made = drawn(shown, request.head["parameters"].get("prompt", ""), request.head["seed"])
    is_white = (made > 250).all(axis=2)
    opacity = np.where(is_white, 0, 255) if (alpha < 1).any() else np.full(made.shape[:2], 255)
    warning = ("references are not shown to this model",) if "references" in request.members else ()
    return Result({"image": BundleImage(np.dstack([made, opacity]).astype(np.uint8))}, warnings=warning)


def inpaint(request: Any) -> Result:
    """Fill a region, which the model sees in gray, and keep all other pixels."""
    from PIL import Image

    pixels, mask = request.members["image"].pixels, request.members["mask"]
    height, width = mask.shape
    gray = np.where(mask[..., None], 128, pixels).astype(np.uint8)
    words = request.head["parameters"].get("prompt") or "the surface behind it"
    made = drawn(gray, f"Replace the gray region by {words}. Keep everything else.", request.head["seed"])
    sized = np.asarray(Image.fromarray(made).resize((width, height)), np.uint8)
    return Result({"image": BundleImage(np.where(mask[..., None], sized, pixels).astype(np.uint8))})


MODEL = Model(
    {"name": "qwen-image-edit", "version": WEIGHTS, "licence": "Apache-2.0", "commercial": True},
    {"edit": edit, "inpaint": inpaint},
)

if __name__ == "__main__":
    sys.exit(run(MODEL))
