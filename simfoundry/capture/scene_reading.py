"""Names, materials and masses of objects, as a model that sees the image (`read_scene`) states them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from simfoundry.capture.findings import NOT_FOUND, CaptureFinding
from simfoundry.capture.model_stages.ask import Makers, StageModels
from simfoundry.capture.segment.masks import Labels
from simfoundry.capture.stages.codec import digest_of
from simfoundry.frontends.names import plain_name
from simfoundry.models.open import open_model
from simfoundry.models.provenance import ModelIdentity, model_use
from simfoundry.models.setup import ModelSetup
from simfoundry.models.tasks.depth import Pixels
from simfoundry.models.tasks.scenes import SceneEstimate, SceneModel, SceneReading, SeenObject
from simfoundry.spec.models.origin import ModelUse

# Smallest overlap (intersection over union) of an object's box and the box around a segment. Models draw boxes loosely,
# and segments lack what has no depth, so that the two boxes of one object often overlap by half only.
OVERLAP = 0.3


@dataclass(frozen=True)
class MatchedReading:
    """A model's statements about the objects of an image, assigned to segments.

    Attributes:
        objects: Its statements, by the number of the object in the segmentation.
        unmatched: Objects at which nothing was found.
        use: The model, for `origin`.
    """

    objects: Mapping[int, SeenObject]
    unmatched: tuple[SeenObject, ...]
    use: ModelUse

    def name(self, number: int) -> str | None:
        """Return a name for an object, or None if the model does not state one."""
        seen = self.objects.get(number)
        return None if seen is None else plain_name(seen.phrase)


def read_scene(models: StageModels, color: Pixels) -> SceneEstimate | None:
    """Ask the model that is configured for `read_scene` about an RGB image, shape (h, w, 3), if there is one."""

    def read(setup: ModelSetup) -> tuple[dict[str, Any], Makers]:
        data = ask_model(open_model(setup, "read_scene"), color)
        return data, {"read_scene": _estimate(data).made_by}

    result = models.ask("read", {"color": digest_of(color)}, read)
    return None if result is None else _estimate(result.value)


def unmatched_findings(read: MatchedReading | None) -> tuple[CaptureFinding, ...]:
    """Return a finding for each object that a model sees where none was found."""
    return () if read is None else tuple(map(_not_found, read.unmatched))


def _not_found(seen: SeenObject) -> CaptureFinding:
    left, top, right, bottom = (round(value) for value in seen.box or (0, 0, 0, 0))
    hint = "state its pixels under `decomposition`, or give its mask, if it is really there"
    corners = ((left, top), (right, top), (right, bottom), (left, bottom))
    return CaptureFinding(NOT_FOUND, f"a model sees `{seen.phrase}` where no object was found", hint, outline=corners)


def ask_model(model: SceneModel, image: Pixels) -> dict[str, Any]:
    """Return the answer of a model about an RGB image, shape (h, w, 3), as plain data.

    Raises:
        ModelError: If the model gives no usable answer.
    """
    found = model.read_scene(image)
    return {"reading": found.reading.model_dump(mode="json"), "model": found.made_by.model_dump(mode="json")}


def match_objects(estimate: SceneEstimate, labels: Labels) -> MatchedReading:
    """Assign the statements of a model to segments, by the overlap of boxes.

    Args:
        estimate: The reading; objects without a box are not assigned.
        labels: Number of the segment at each pixel, or 0, shape (h, w).
    """
    from scipy.optimize import linear_sum_assignment

    seen = [each for each in estimate.reading.objects if each.box is not None]
    numbers = [int(k) for k in np.unique(labels[labels > 0])]
    overlaps = np.array([[_overlap(each.box or (0, 0, 0, 0), labels == k) for k in numbers] for each in seen])
    found: dict[int, SeenObject] = {}
    if overlaps.size:
        for row, column in zip(*linear_sum_assignment(-overlaps), strict=True):
            if overlaps[row, column] >= OVERLAP:
                found[numbers[column]] = seen[row]
    missed = tuple(each for each in seen if not any(each is other for other in found.values()))
    return MatchedReading(found, missed, model_use("read_scene", estimate.made_by))


def _estimate(data: Mapping[str, Any]) -> SceneEstimate:
    """Return the answer that :func:`ask_model` returned."""
    return SceneEstimate(SceneReading.model_validate(data["reading"]), ModelIdentity.model_validate(data["model"]))


def _overlap(box: tuple[float, float, float, float], mask: np.ndarray) -> float:
    """Return the intersection over union of a box [column, row, column, row] and the box around a mask."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    own = (columns[0], rows[0], columns[-1] + 1, rows[-1] + 1)
    width = min(box[2], own[2]) - max(box[0], own[0])
    height = min(box[3], own[3]) - max(box[1], own[1])
    both = max(0.0, width) * max(0.0, height)
    return float(both / (_area(box) + _area(own) - both))


def _area(box: tuple[float, float, float, float]) -> float:
    return float((box[2] - box[0]) * (box[3] - box[1]))
