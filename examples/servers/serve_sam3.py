"""SAM 3 of transformers as a server of `segment`: phrases and boxes to masks.

pip install "transformers>=5.23" torch torchvision numpy pillow; the weights are gated, so run `hf auth login` first.
"""

from __future__ import annotations

import sys
from functools import lru_cache
from typing import Any

import numpy as np
from scaffold import BundleImage, Model, RefusedError, Result, run

WEIGHTS = "facebook/sam3"
SCORE = (
    0.5  # Least score of an object, as in the documentation's examples; a score is sigmoid(logit) * sigmoid(presence)
)


@lru_cache(maxsize=1)
def load() -> tuple[Any, Any]:
    """Return the processor and the model."""
    from transformers import Sam3Model, Sam3Processor

    return Sam3Processor.from_pretrained(WEIGHTS), Sam3Model.from_pretrained(WEIGHTS).eval()


def segment(request: Any) -> Result:
    """Find the objects of each phrase, or in each box."""
    import torch
    from PIL import Image

    prompt = request.head["parameters"]
    if prompt.get("points"):
        raise RefusedError("this server takes phrases and boxes; points need SAM 3's tracker model")
    assert isinstance(request.members["image"], BundleImage)
    pixels = request.members["image"].pixels
    height, width = pixels.shape[:2]
    processor, model = load()
    queries: list[dict[str, Any]] = [{"text": phrase} for phrase in prompt.get("phrases", [])]
    queries += [{"input_boxes": [[list(box)]], "input_boxes_labels": [[1]]} for box in prompt.get("boxes", [])]
    masks, boxes, scores, prompts = [], [], [], []
    for number, query in enumerate(queries):
        inputs = processor(images=Image.fromarray(pixels), return_tensors="pt", **query)
        with torch.inference_mode():
            outputs = model(**inputs)
        (found,) = processor.post_process_instance_segmentation(
            outputs, threshold=SCORE, mask_threshold=0.5, target_sizes=[(height, width)]
        )
        for mask, box, score in zip(found["masks"], found["boxes"], found["scores"]):
            mask = np.asarray(mask.cpu()).astype(bool)  # 0 and 1 as int64
            if mask.any():
                masks.append(mask)
                boxes.append(np.asarray(box.cpu(), np.float32))
                scores.append(float(score))
                prompts.append(number if number < len(prompt.get("phrases", [])) or not prompt.get("phrases") else 0)
    return Result({
        "masks": np.array(masks, bool).reshape(-1, height, width),
        "boxes": np.array(boxes, np.float32).reshape(-1, 4),
        "scores": np.array(scores, np.float32),
        "prompts": np.array(prompts, np.int32),
    })  # fmt: skip


MODEL = Model({"name": "sam3", "version": WEIGHTS, "licence": "SAM License", "commercial": True}, {"segment": segment})

if __name__ == "__main__":
    sys.exit(run(MODEL))
