"""The operators of torchvision whose wheel does not load them with the CPU build of torch."""

from __future__ import annotations


def define_operators() -> None:
    """Declare the operators that importing torchvision requires. The readers do not call them."""
    import torch

    if torch.version.cuda is not None:
        return
    for name in ("nms", "qnms"):
        torch.library.define(f"torchvision::{name}", "(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
