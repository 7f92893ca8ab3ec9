"""Depth in the holes of a depth image, from a model that completes depth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from simfoundry.capture.frame import FARTHEST, NEAREST, Frame
from simfoundry.capture.model_stages.ask import Makers, ModelResult, StageModels
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
        known = np.where(hole, 0, frame.depth).astype(np.float32)
        found = open_model(setup, "complete_depth").complete_depth(frame.color, known, hole)
        usable = hole & (found.depth >= NEAREST) & (found.depth <= FARTHEST)
        filled = np.where(usable, found.depth, frame.depth)
        return np.asarray(filled, dtype=np.float64), {"complete_depth": found.made_by}

    result = models.ask("depth", inputs, complete)
    return (frame if result is None else replace(frame, depth=result.value)), result
