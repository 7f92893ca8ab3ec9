"""Answer one request with a tiny model of random weights: ``python -m tests.corpora.readers.tiny_models NAME SERVERS``.

It runs in an environment with torch, torchvision and transformers (see ``tests.corpora.tiny_models``). The model is
built from the classes of transformers, saved, and loaded again by the example server in the folder SERVERS, whose own
code answers.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tests.corpora.readers.cpu_torch import define_operators

# Width of all layers, and size of the images that the models see [px]. SAM 2 splits object pointers of at least 128
# channels into memories of 64.
WIDTH, SIZE, SAM2_WIDTH = 32, 224, 128


def save_sam3(folder: Path) -> None:
    """Save a SAM 3 with 243 thousand random weights, and a tokenizer that knows letters only."""
    import torch
    from transformers import CLIPTokenizer, Sam3Config, Sam3ImageProcessor, Sam3Model, Sam3Processor

    letters = [chr(code) for code in range(ord("a"), ord("z") + 1)]
    words = ["<|startoftext|>", "<|endoftext|>", "!", *letters, *(f"{letter}</w>" for letter in letters)]
    (folder / "vocab.json").write_text(json.dumps({word: k for k, word in enumerate(words)}))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    files = (str(folder / "vocab.json"), str(folder / "merges.txt"))
    tokenizer = CLIPTokenizer(*files, model_max_length=32, pad_token="!")
    small: dict[str, Any] = {"hidden_size": WIDTH, "num_attention_heads": 2, "intermediate_size": 2 * WIDTH}
    backbone = {
        **small, "model_type": "sam3_vit_model", "num_hidden_layers": 2, "image_size": SIZE, "pretrain_image_size": 112,
        "window_size": 4, "global_attn_indexes": [1],
    }  # fmt: skip
    text = {
        **small, "model_type": "clip_text_model", "vocab_size": len(words), "projection_dim": WIDTH,
        "num_hidden_layers": 1, "max_position_embeddings": 32, "bos_token_id": 0, "eos_token_id": 1, "pad_token_id": 2,
    }  # fmt: skip
    levels = [[SIZE * 2 // 7 // k] * 2 for k in (1, 2, 4)]
    config = Sam3Config(
        vision_config={"backbone_config": backbone, "fpn_hidden_size": WIDTH, "backbone_feature_sizes": levels},
        text_config=text,
        geometry_encoder_config={**small, "num_layers": 1},
        detr_encoder_config={**small, "num_layers": 1},
        detr_decoder_config={**small, "num_layers": 1, "num_queries": 12},
        mask_decoder_config={"hidden_size": WIDTH, "num_attention_heads": 2},
    )
    torch.manual_seed(0)
    Sam3Model(config).save_pretrained(folder)
    Sam3Processor(Sam3ImageProcessor(size={"height": SIZE, "width": SIZE}), tokenizer).save_pretrained(folder)


def save_sam2(folder: Path) -> None:
    """Save a SAM 2 for videos with a million random weights."""
    import torch
    from transformers import (
        Sam2ImageProcessor,
        Sam2VideoConfig,
        Sam2VideoModel,
        Sam2VideoProcessor,
        Sam2VideoVideoProcessor,
    )

    size, h = 256, SAM2_WIDTH
    stages = [8, 16, 32, 64]
    backbone = {
        "model_type": "sam2_hiera_det_model", "hidden_size": stages[0], "num_attention_heads": 1,
        "image_size": [size, size], "blocks_per_stage": [1, 1, 2, 1], "embed_dim_per_stage": stages,
        "num_attention_heads_per_stage": [1, 1, 1, 1], "window_size_per_stage": [8, 4, 8, 4],
        "global_attention_blocks": [3], "window_positional_embedding_background_size": [4, 4],
    }  # fmt: skip
    config = Sam2VideoConfig(
        image_size=size,
        vision_config={
            "backbone_config": backbone,
            "backbone_channel_list": stages[::-1],
            "backbone_feature_sizes": [[size // k] * 2 for k in (4, 8, 16)],
            "fpn_hidden_size": h,
        },
        prompt_encoder_config={"hidden_size": h, "image_size": size},
        mask_decoder_config={"hidden_size": h, "mlp_dim": 64, "num_attention_heads": 2, "iou_head_hidden_dim": h},
        memory_attention_hidden_size=h,
        memory_attention_num_layers=1,
        memory_attention_feed_forward_hidden_size=64,
        memory_attention_rope_feat_sizes=[size // 16] * 2,
        memory_encoder_hidden_size=h,
        mask_downsampler_embed_dim=h,
        memory_fuser_embed_dim=h,
        memory_fuser_intermediate_dim=64,
        memory_fuser_num_layers=1,
    )
    torch.manual_seed(0)
    Sam2VideoModel(config).save_pretrained(folder)
    pictures = Sam2ImageProcessor(
        size={"height": size, "width": size}, mask_size={"height": size // 4, "width": size // 4}
    )
    video = Sam2VideoVideoProcessor(size={"height": size, "width": size})
    Sam2VideoProcessor(pictures, video).save_pretrained(folder)


def main() -> int:
    """Build a model, and let its server answer."""
    name, servers = sys.argv[1:3]
    sys.path[:0] = [servers, str(Path(servers).parents[1] / "simfoundry" / "models")]  # for wire.py, as it is copied
    out, sys.stdout = sys.stdout, sys.stderr  # progress of transformers must not end up in the answer
    define_operators()
    with TemporaryDirectory() as temporary:
        if name == "sam3":
            import serve_sam3 as server

            save_sam3(Path(temporary))
            server.SCORE = 0.0  # random weights are not sure of anything
        else:
            import serve_sam2 as server  # type: ignore[no-redef]

            save_sam2(Path(temporary))
        server.WEIGHTS = temporary
        from scaffold import Model, run

        sys.stdout = out
        answers = {task: _with_fitting_boxes(answer) for task, answer in server.MODEL.tasks.items()}
        return run(Model(server.MODEL.identity, answers), [])


def _with_fitting_boxes(answer: Any) -> Any:
    """Return the function of a server with boxes around its masks, because the client refuses random ones."""

    def fitted(request: Any) -> Any:
        import numpy as np

        result = answer(request)
        if "boxes" in result.members:
            masks, size = result.members["masks"], result.members["masks"].shape[1:]
            spans = [[np.flatnonzero(mask.any(axis=axis)) for axis in (0, 1)] for mask in masks]
            boxes = [[u[0], v[0], u[-1] + 1, v[-1] + 1] for u, v in spans]
            assert (
                result.members["boxes"].shape == (len(masks), 4) and size == request.members["image"].pixels.shape[:2]
            )
            result.members["boxes"] = np.array(boxes, np.float32).reshape(-1, 4)
        return result

    return fitted


if __name__ == "__main__":
    sys.exit(main())
