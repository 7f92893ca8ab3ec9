"""Images without objects, in-painted by a model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from simfoundry.capture.frame import Frame
from simfoundry.capture.model_stages.ask import Makers, ModelResult, StageModels
from simfoundry.capture.model_stages.depth import filled_depth
from simfoundry.capture.removal import ClearedImage
from simfoundry.capture.stages.codec import digest_of
from simfoundry.models.open import open_model
from simfoundry.models.provenance import ModelIdentity
from simfoundry.models.setup import ModelSetup

PROMPT = "the same picture without the masked objects; what they hid is continued"


def inpainted_images(
    frame: Frame, cleared: Sequence[ClearedImage], models: StageModels
) -> ModelResult[tuple[ClearedImage, ...]] | None:
    """Return images without objects whose holes the model for `inpaint` fills, or None without an answer.

    Their depth in the holes is that of the model for `complete_depth`, if one is configured, which sees the filled
    image. Otherwise it stays that of ``cleared``.
    """
    inputs = {"color": digest_of(frame.color), "cleared": digest_of(tuple(cleared))}

    def inpaint(setup: ModelSetup) -> tuple[tuple[ClearedImage, ...], Makers]:
        painter, makers = open_model(setup, "inpaint"), dict[str, ModelIdentity]()
        source, images = setup.source("complete_depth"), []
        for image in cleared:
            painted = painter.inpaint(frame.color, image.hole, PROMPT)
            makers["inpaint"] = painted.made_by
            image = replace(image, color=painted.image)
            if source is not None and not source.offline:
                depth, made_by = filled_depth(setup, frame, image.color, image.hole, image.depth)
                makers |= made_by
                image = replace(image, depth=depth)
            images.append(image)
        return tuple(images), makers

    return models.ask("inpaint", inputs, inpaint)
