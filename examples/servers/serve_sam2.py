"""SAM 2.1 of transformers as a server of `track`: masks of one frame, propagated through a video.

pip install "transformers>=5.23" torch torchvision numpy pillow
"""

from __future__ import annotations

import sys
from functools import lru_cache
from typing import Any

import numpy as np
from scaffold import Model, Result, run

WEIGHTS = "facebook/sam2.1-hiera-large"


@lru_cache(maxsize=1)
def load() -> tuple[Any, Any]:
    """Return the processor and the model."""
    from transformers import Sam2VideoModel, Sam2VideoProcessor

    return Sam2VideoProcessor.from_pretrained(WEIGHTS), Sam2VideoModel.from_pretrained(WEIGHTS).eval()


def track(request: Any) -> Result:
    """Follow the objects forward and backward from the keyframe."""
    import torch

    frames = [frame.pixels for frame in request.members["frames"]]
    given = request.members["masks"]
    keyframe = request.head["parameters"].get("keyframe", 0)
    count, height, width = given.shape
    processor, model = load()
    device = "cuda" if torch.cuda.is_available() else "cpu"
    model.to(device)
    masks = np.zeros((len(frames), count, height, width), bool)
    # A session goes through the video in one direction, so the part before the keyframe is a video of its own.
    for order in (range(keyframe, len(frames)), range(keyframe, -1, -1)):
        numbers = list(order)
        session = processor.init_video_session(
            video=[frames[n] for n in numbers], inference_device=device, dtype=torch.float32
        )
        processor.add_inputs_to_inference_session(
            session, frame_idx=0, obj_ids=list(range(1, count + 1)), input_masks=list(given)
        )
        with torch.inference_mode():
            model(inference_session=session, frame_idx=0)  # from here, the masks are propagated
            for output in model.propagate_in_video_iterator(session):
                (logits,) = processor.post_process_masks(
                    [output.pred_masks], original_sizes=[[height, width]], binarize=False
                )
                masks[numbers[output.frame_idx]] = np.asarray(logits.cpu())[:, 0] > 0
    masks[keyframe] = given
    return Result({"masks": np.packbits(masks, axis=-1)})


MODEL = Model({"name": "sam2.1", "version": WEIGHTS, "licence": "Apache-2.0", "commercial": True}, {"track": track})

if __name__ == "__main__":
    sys.exit(run(MODEL))
