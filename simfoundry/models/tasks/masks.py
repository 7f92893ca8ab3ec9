"""Masks of objects in an image, and their propagation through a video (V_seg^image, V_seg^video)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from simfoundry.models.client import Members, ModelClient
from simfoundry.models.contract import ConventionError, Member, ModelError, ModelTask
from simfoundry.models.provenance import ModelIdentity
from simfoundry.models.tasks.depth import IMAGE, Mask, Pixels
from simfoundry.models.wire import Bundle, BundleImage

# Minimum overlap (IoU) of a box with the bounding box of its mask. Detectors draw boxes beside their masks, a few
# pixels apart; boxes in another convention overlap far less.
BOX_OVERLAP = 0.5

PROMPT_OVERLAP = 0.3  # Minimum overlap (IoU) of a propagated mask with the given mask of the same frame


class SegmentationPrompt(BaseModel):
    """The objects that are wanted.

    Attributes:
        phrases: Short noun phrases, such as ``mug``.
        points: Pixels [column, row] of one object, with 1 for a pixel on it and 0 for a pixel beside it.
        boxes: Boxes of objects [column, row, column, row] [px].
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    phrases: tuple[Annotated[str, Field(min_length=1, max_length=200)], ...] = Field((), max_length=64)
    points: tuple[tuple[float, float, Annotated[int, Field(ge=0, le=1)]], ...] = Field((), max_length=256)
    boxes: tuple[tuple[float, float, float, float], ...] = Field((), max_length=64)


@dataclass(frozen=True, eq=False)
class MaskEstimate:
    """Masks of objects.

    Attributes:
        masks: One mask per object, shape (N, H, W).
        boxes: Bounding boxes [column, row, column, row] [px], shape (N, 4).
        scores: Confidence, 0 to 1, shape (N,).
        prompts: Number of the phrase or box that each mask belongs to, shape (N,); 0 for points.
        made_by: The model.
    """

    masks: Mask
    boxes: NDArray[np.float32]
    scores: NDArray[np.float32]
    prompts: NDArray[np.int32]
    made_by: ModelIdentity


class SegmentationModel(Protocol):
    """Masks of objects that are named by phrases, points or boxes (V_seg^image)."""

    def segment(self, image: Pixels, prompt: SegmentationPrompt) -> MaskEstimate:
        """Find the objects in an RGB image, shape (H, W, 3). There may be none.

        Raises:
            ModelError: If there is no usable answer.
        """


@dataclass(frozen=True, eq=False)
class TrackEstimate:
    """Masks of objects in a video.

    Attributes:
        masks: Masks by frame and object, shape (T, N, H, W); all False where an object is hidden.
        made_by: The model.
    """

    masks: Mask
    made_by: ModelIdentity


class TrackingModel(Protocol):
    """Masks of one frame, propagated through a video (V_seg^video)."""

    def track(self, frames: Sequence[Pixels], masks: Mask, keyframe: int = 0) -> TrackEstimate:
        """Follow objects through a video.

        Args:
            frames: RGB images of one shape (H, W, 3).
            masks: Masks of the objects in the keyframe, shape (N, H, W).
            keyframe: Number of the frame that the masks belong to, from 0.
        """


class TrackPrompt(BaseModel):
    """The frame that the given masks belong to."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    keyframe: int = Field(0, ge=0)


def bounding_boxes(masks: Mask) -> NDArray[np.float32]:
    """Return the bounding boxes [column, row, column, row] [px] of masks, shape (N, 4). The ends are exclusive."""
    boxes = np.zeros((len(masks), 4), dtype=np.float32)
    for k, mask in enumerate(masks):
        rows, columns = np.nonzero(mask.any(axis=1))[0], np.nonzero(mask.any(axis=0))[0]
        if len(rows):
            boxes[k] = columns[0], rows[0], columns[-1] + 1, rows[-1] + 1
    return boxes


def mask_overlap(a: Mask, b: Mask) -> float:
    """Return the intersection over the union of two masks; 1 if both are empty."""
    union = np.logical_or(a, b).sum()
    return float(np.logical_and(a, b).sum() / union) if union else 1.0


def _box_overlap(a: Any, b: Any) -> float:
    low, high = np.maximum(a[:2], b[:2]), np.minimum(a[2:], b[2:])
    inner = float(np.prod(np.maximum(high - low, 0)))
    outer = float(np.prod(np.maximum(a[2:] - a[:2], 0)) + np.prod(np.maximum(b[2:] - b[:2], 0))) - inner
    return inner / outer if outer > 0 else 0.0


def _check_masks(request: Bundle, answer: Bundle) -> None:
    masks, boxes, prompts = (answer.members[name] for name in ("masks", "boxes", "prompts"))
    assert isinstance(masks, np.ndarray) and isinstance(boxes, np.ndarray) and isinstance(prompts, np.ndarray)
    if not len(masks):
        return
    empty = np.nonzero(~masks.any(axis=(1, 2)))[0]
    if len(empty):
        raise ConventionError(f"has an empty mask, number {empty[0]}; objects that are not found are left out")
    prompt = SegmentationPrompt.model_validate(request.head.get("parameters", {}))
    count = max(len(prompt.phrases), len(prompt.boxes), 1)
    if prompts.min() < 0 or prompts.max() >= count:
        raise ConventionError(f"has `prompts` from {prompts.min()} to {prompts.max()}; they count {count} from 0")
    height, width = masks.shape[1:]
    tight = bounding_boxes(masks)
    readings = {
        "": boxes,
        "x, y, width, height": np.hstack([boxes[:, :2], boxes[:, :2] + boxes[:, 2:]]),
        "centers and sizes": np.hstack([boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2]),
        "fractions of the image": boxes * [width, height, width, height],
        "rows before columns": boxes[:, [1, 0, 3, 2]],
    }
    fit = {name: min(map(_box_overlap, reading, tight)) for name, reading in readings.items()}
    if fit[""] < BOX_OVERLAP:
        best = max(fit, key=lambda name: fit[name])
        hint = f"; they fit as {best}" if fit[best] >= BOX_OVERLAP else ""
        raise ConventionError(f"has `boxes` that do not enclose their masks as [column, row, column, row]{hint}")


def _check_track(request: Bundle, answer: Bundle) -> None:
    given, bits = request.members["masks"], answer.members["masks"]
    assert isinstance(given, np.ndarray) and isinstance(bits, np.ndarray)
    keyframe = TrackPrompt.model_validate(request.head.get("parameters", {})).keyframe
    found = unpacked(bits[keyframe], given.shape[2])
    for k in range(len(given)):
        if mask_overlap(given[k], found[k]) < PROMPT_OVERLAP:
            other = next((j for j in range(len(given)) if mask_overlap(given[k], found[j]) > 0.5), None)
            hint = f"; it equals the mask of object {other}" if other is not None else ""
            raise ConventionError(f"has a mask of object {k} in frame {keyframe} that is not the given mask{hint}")


def unpacked(bits: NDArray[np.uint8], width: int) -> Mask:
    """Return masks from packed bits; the last axis grows to ``width``."""
    return np.unpackbits(bits, axis=-1, count=width).astype(np.bool_)


SEGMENT = ModelTask(
    "segment", "V_seg^image", "masks of objects named by phrases, points or boxes", (IMAGE,),
    (
        Member("masks", "array", "one mask per object", ("N", "H", "W"), "bool"),
        Member("boxes", "array", "boxes [column, row, column, row]", ("N", 4), unit="px"),
        Member("scores", "array", "confidence", ("N",), low=0, high=1),
        Member("prompts", "array", "number of the phrase or box", ("N",), "int32"),
    ),
    parameters=SegmentationPrompt, checks=(_check_masks,),
)  # fmt: skip

TRACK = ModelTask(
    "track", "V_seg^video", "masks of one frame, propagated through a video",
    (
        Member("frames", "images", "RGB frames of one size", ("T", "H", "W")),
        Member("masks", "array", "masks in the keyframe", ("N", "H", "W"), "bool"),
    ),
    (Member("masks", "array", "masks as numpy.packbits along the rows", ("T", "N", "H", "W/8"), "uint8"),),
    parameters=TrackPrompt, checks=(_check_track,),
)  # fmt: skip


@dataclass(frozen=True)
class BundleMasks:
    """The tasks about masks, solved by servers that speak ``bundle/1``."""

    client: ModelClient

    def segment(self, image: Pixels, prompt: SegmentationPrompt) -> MaskEstimate:
        """Find objects; see :class:`SegmentationModel`."""
        if not (prompt.phrases or prompt.points or prompt.boxes):
            raise ModelError("a segmentation needs phrases, points or boxes that say what is wanted")
        got = self.client.ask(SEGMENT, {"image": BundleImage(image)}, prompt)
        masks, boxes, scores, prompts = (got.array(name) for name in ("masks", "boxes", "scores", "prompts"))
        return MaskEstimate(masks, boxes, scores, prompts, got.made_by)

    def track(self, frames: Sequence[Pixels], masks: Mask, keyframe: int = 0) -> TrackEstimate:
        """Follow objects; see :class:`TrackingModel`."""
        if not 0 <= keyframe < len(frames):
            raise ModelError(f"the keyframe {keyframe} is not one of {len(frames)} frames")
        members: Members = {"frames": tuple(map(BundleImage, frames)), "masks": masks.astype(np.bool_)}
        got = self.client.ask(TRACK, members, TrackPrompt(keyframe=keyframe))
        return TrackEstimate(unpacked(got.array("masks"), frames[0].shape[1]), got.made_by)
