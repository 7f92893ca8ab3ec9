"""Names, materials and masses of objects, as a model that sees the image (`read_scene`) states them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from simfoundry.capture.segment.masks import Labels
from simfoundry.frontends.names import plain_name
from simfoundry.models.provenance import ModelIdentity, model_use
from simfoundry.models.tasks.depth import Pixels
from simfoundry.models.tasks.scenes import SceneEstimate, SceneModel, SceneReading, SeenObject
from simfoundry.spec.models.origin import ModelUse

# Smallest overlap (intersection over union) of an object's box and the box around a segment. Models draw boxes loosely,
# and segments lack what has no depth, so that the two boxes of one object often overlap by half only.
OVERLAP = 0.3


@dataclass(frozen=True)
class ReadObjects:
    """What a model states about the objects of an image.

    Attributes:
        objects: What it states, by the number of the object in the segmentation.
        unmatched: Phrases of objects at which nothing was found.
        use: The model, for `origin`.
    """

    objects: Mapping[int, SeenObject]
    unmatched: tuple[str, ...]
    use: ModelUse

    def name(self, number: int) -> str | None:
        """Return a name for an object, or None if the model does not state one."""
        seen = self.objects.get(number)
        return None if seen is None else plain_name(seen.phrase)


def read_objects(model: SceneModel, image: Pixels) -> str:
    """Return what a model states about an RGB image, shape (h, w, 3), as JSON text.

    Raises:
        ModelError: If the model gives no usable answer.
    """
    found = model.read_scene(image)
    reading = found.reading.model_dump_json()
    return f'{{"reading": {reading}, "model": {found.made_by.model_dump_json()}}}'


def match_objects(estimate: SceneEstimate, labels: Labels) -> ReadObjects:
    """Assign what a model states to segments, by the overlap of boxes.

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
    missed = tuple(each.phrase for each in seen if not any(each is other for other in found.values()))
    return ReadObjects(found, missed, model_use("read_scene", estimate.made_by))


def parse_reading(text: str) -> SceneEstimate:
    """Return the estimate that :func:`read_objects` returned as text."""
    import json

    data = json.loads(text)
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
