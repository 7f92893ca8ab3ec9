"""Depth in the holes of a depth image, from a model that completes depth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import Frame, in_range
from simfoundry.capture.model_stages.ask import Makers, ModelResult, StageModels
from simfoundry.capture.segment.masks import Mask
from simfoundry.capture.stages.codec import digest_of
from simfoundry.geometry.frames import Array
from simfoundry.models.open import open_model
from simfoundry.models.setup import ModelSetup


def completed_frame(frame: Frame, models: StageModels) -> tuple[Frame, ModelResult[Array] | None]:
    """Return a frame whose holes are filled by the model for `complete_depth`, and the model's result.

    Measured depth stays as it is. Without a model, the holes stay open: a hole says that something was not measured,
    such as glass, which a continuation of the surfaces around it would hide.
    """
    hole = ~np.isfinite(frame.depth)
    if not models.asks("depth") or not hole.any():
        return frame, None
    inputs = {"color": digest_of(frame.color), "depth": digest_of(frame.depth)}

    def complete(setup: ModelSetup) -> tuple[Array, Makers]:
        return filled_depth(setup, frame, frame.color, hole, frame.depth)

    result = models.ask("depth", inputs, complete)
    return (frame if result is None else replace(frame, depth=result.value)), result


def filled_depth(
    setup: ModelSetup, frame: Frame, color: NDArray[np.uint8], hole: Mask, otherwise: Array
) -> tuple[Array, Makers]:
    """Ask the model for `complete_depth` for the depth in a hole.

    Args:
        setup: The models.
        frame: The image with the measured depth.
        color: The RGB image that the model sees, shape (h, w, 3).
        hole: Pixels whose depth is wanted, shape (h, w).
        otherwise: Depth [m], shape (h, w), elsewhere and where the answer is out of the range of sensors.
    """
    known = np.nan_to_num(np.where(hole, 0, frame.depth)).astype(np.float32)
    found = open_model(setup, "complete_depth").complete_depth(color, known, hole)
    usable = hole & in_range(found.depth)
    filled = np.where(usable, found.depth, otherwise).astype(np.float64)
    return filled, {"complete_depth": found.made_by}
