"""Masks of objects from a model that segments images, in place of those that geometry finds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from simfoundry.capture.frame import Frame, Segmentation, SupportSurface
from simfoundry.capture.model_stages.ask import Makers, ModelResult, StageModels
from simfoundry.capture.segment.masks import Labels, Mask
from simfoundry.capture.stages.codec import digest_of
from simfoundry.capture.statements.stated import stated_segmentation
from simfoundry.models.open import open_model
from simfoundry.models.setup import ModelSetup
from simfoundry.models.tasks.masks import MaskEstimate, SegmentationPrompt, bounding_boxes, mask_overlap

# Largest number of phrases or boxes in one question, which is that of the task.
PROMPTS_MAX = 64

# Overlap (IoU) above which two masks show the same object, as two phrases may mean one object; as in the suppression of
# detections that overlap.
SAME_OBJECT = 0.7

# Overlap (IoU) of a mask and the segment whose box was asked about, below which it shows something else, such as the
# table behind the object.
OF_SEGMENT = 0.3

# Least share of a geometric segment that masks must cover for it not to be an object of its own.
COVERED = 0.5

# Least median height above the support [m] of an object, which is above the noise of the support's plane. What is
# beside the support, such as a wall, has none.
FLATTEST = 0.003

# Distance [m] from the visible part of the support within which something may stand on it: an object hides the edge.
AROUND = 0.1

MIN_PIXELS = 50  # fewer pixels are not an object that can be fitted, see `FEW_POINTS`


def model_segmentation(
    frame: Frame,
    support: SupportSurface,
    segmentation: Segmentation,
    phrases: Sequence[str],
    models: StageModels,
) -> ModelResult[Segmentation] | None:
    """Return the segmentation of the model for `segment`, or None if there is none or it fails.

    The model is asked for the phrases, or, without any, for the boxes around the segments that geometry found. An
    object that only geometry found remains, because nothing that was seen may be lost.

    Args:
        frame: The image.
        support: The surface that supports the objects.
        segmentation: The objects that geometry found.
        phrases: Phrases of the objects in the image, as a model reads it.
        models: The models.
    """
    labels = segmentation.labels
    words = tuple(dict.fromkeys(phrases))[:PROMPTS_MAX]
    boxes = bounding_boxes(np.array([labels == k for k in range(1, int(labels.max()) + 1)]))
    prompt = SegmentationPrompt(phrases=words) if words else SegmentationPrompt(boxes=_plain(boxes[:PROMPTS_MAX]))
    inputs = {"color": digest_of(frame.color), "segments": digest_of(labels), "prompt": prompt.model_dump_json()}
    inputs |= {"depth": digest_of(frame.depth), "X_WC": digest_of(support.X_WC)}

    def segment(setup: ModelSetup) -> tuple[Segmentation, Makers]:
        found = open_model(setup, "segment").segment(frame.color, prompt)
        masks = _by_phrase(found, _heights(frame, support)) if words else _by_box(found, labels)
        merged = _merged(masks, labels)
        return stated_segmentation(frame, support, merged), {"segment": found.made_by}

    return models.ask("masks", inputs, segment)


def _plain(boxes: np.ndarray) -> tuple[tuple[float, float, float, float], ...]:
    return tuple((float(a), float(b), float(c), float(d)) for a, b, c, d in boxes)


def _heights(frame: Frame, support: SupportSurface) -> np.ndarray:
    """Return the height [m] above the support at each pixel, shape (h, w), 0 beside it and NaN without depth."""
    import shapely

    points = support.X_WC.apply(frame.points)
    with np.errstate(invalid="ignore"):
        around = shapely.Polygon(support.outline).convex_hull.buffer(AROUND)
        above = shapely.contains_xy(around, points[..., 0], points[..., 1])
    return np.where(np.isfinite(frame.depth), np.where(above, points[..., 2], 0.0), np.nan)


def _by_phrase(found: MaskEstimate, heights: np.ndarray) -> list[Mask]:
    """Return the masks of objects above the support, those of the largest first, each object once."""
    kept: list[Mask] = []
    for k in np.argsort(-found.scores, kind="stable"):
        mask = found.masks[k]
        measured = heights[mask & np.isfinite(heights)]
        is_flat = len(measured) > 0 and float(np.median(measured)) < FLATTEST
        if mask.sum() >= MIN_PIXELS and not is_flat and all(mask_overlap(mask, m) < SAME_OBJECT for m in kept):
            kept.append(mask)
    return sorted(kept, key=lambda mask: -int(mask.sum()))


def _by_box(found: MaskEstimate, labels: Labels) -> list[Mask]:
    """Return the best mask for each segment, if it shows that segment."""
    best: dict[int, Mask] = {}
    for k in np.argsort(found.scores, kind="stable"):
        number = int(found.prompts[k]) + 1
        if mask_overlap(found.masks[k], labels == number) >= OF_SEGMENT:
            best[number] = found.masks[k]
    return sorted(best.values(), key=lambda mask: -int(mask.sum()))


def _merged(masks: Sequence[Mask], labels: Labels) -> Labels:
    """Return object numbers, shape (h, w). Small masks lie on top of large ones; segments without a mask are kept."""
    out = np.zeros(labels.shape, np.int32)
    for number, mask in enumerate(masks, 1):
        out[mask] = number
    for k in range(1, int(labels.max()) + 1):
        own = labels == k
        if own.any() and (out[own] > 0).mean() < COVERED:
            out[own & (out == 0)] = int(out.max()) + 1
    return out
