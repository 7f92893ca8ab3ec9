"""Stand-ins for foundation models: simple methods, and annotations of a picture, behind the protocol of the models.

They answer honestly, but none of them is a foundation model, and their identity says so. What they prove is that the
stages of a reconstruction ask for each task, check the answer and use it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scaffold import Model, Result

from simfoundry.models.offline import OfflineDepth, OfflineImages
from simfoundry.models.setup import ModelSetup
from simfoundry.models.tasks.masks import bounding_boxes
from simfoundry.models.wire import Bundle, BundleImage
from simfoundry.spec.models.model_sources import ModelSource
from tests.models.test_tasks import serving

IDENTITY = {"name": "stand-in", "version": "1", "licence": "Apache-2.0 (no foundation model)", "commercial": True}

Labels = Any


@dataclass
class StandIns:
    """Answers about one picture.

    Attributes:
        labels: Number of the object at each pixel, shape (h, w), as a person or a renderer annotated it.
        names: Phrases of the objects, by number.
        moving: Numbers of the objects with parts that move.
        glb: A mesh for each object that has one, by number; others get their extruded silhouette.
        asked: The tasks that were asked for, in order.
        spoil: Changes the answer for a task, for tests of faults.
    """

    labels: Labels
    names: Mapping[int, str]
    moving: tuple[int, ...] = ()
    glb: Mapping[int, bytes] = field(default_factory=dict)
    asked: list[str] = field(default_factory=list)
    spoil: Mapping[str, Callable[[Result], None]] = field(default_factory=dict)

    def model(self) -> Model:
        """Return a server of all tasks."""
        solvers = {name: getattr(self, name) for name in SOLVED}
        return Model(IDENTITY, {name: self._noted(name, solve) for name, solve in solvers.items()})

    def _noted(self, name: str, solve: Callable[[Bundle], Result]) -> Callable[[Bundle], Result]:
        def noted(request: Bundle) -> Result:
            self.asked.append(name)
            result = solve(request)
            if name in self.spoil:
                self.spoil[name](result)
            return result

        return noted

    def read_scene(self, request: Bundle) -> Result:
        """List what is annotated."""
        numbers = list(self.names)
        boxes = bounding_boxes(np.array([self.labels == k for k in numbers]))
        objects = [
            {"phrase": self.names[k], "category": self.names[k].split()[-1], "box": box.tolist(),
             "is_articulated": k in self.moving}
            for k, box in zip(numbers, boxes, strict=True)
        ]  # fmt: skip
        return Result(values={"objects": objects, "support": "table"})

    def segment(self, request: Bundle) -> Result:
        """Return the annotated masks with the asked phrases, or those that fit the asked boxes best."""
        asked = request.head["parameters"]
        by_name = {name: k for k, name in self.names.items()}
        found = [(k, by_name[p]) for k, p in enumerate(asked.get("phrases", [])) if p in by_name]
        for k, (left, top, right, bottom) in enumerate(asked.get("boxes", [])):
            inside = self.labels[int(top) : int(bottom), int(left) : int(right)]
            counts = np.bincount(inside[inside > 0].ravel(), minlength=1)
            found += [(k, int(counts.argmax()))] if counts.sum() else []
        masks = np.array([self.labels == number for _, number in found], bool).reshape(-1, *self.labels.shape)
        scores, prompts = np.full(len(found), 0.9, np.float32), np.array([k for k, _ in found], np.int32)
        return Result({"masks": masks, "boxes": bounding_boxes(masks), "scores": scores, "prompts": prompts})

    def complete_depth(self, request: Bundle) -> Result:
        """Continue the surfaces around holes."""
        image, depth, mask = (request.members[name] for name in ("image", "depth", "mask"))
        assert isinstance(image, BundleImage) and isinstance(depth, np.ndarray) and isinstance(mask, np.ndarray)
        return Result({"depth": OfflineDepth().complete_depth(image.pixels, depth, mask).depth})

    def inpaint(self, request: Bundle) -> Result:
        """Fill a hole from its rim."""
        image, mask = request.members["image"], request.members["mask"]
        assert isinstance(image, BundleImage) and isinstance(mask, np.ndarray)
        return Result({"image": BundleImage(OfflineImages().inpaint(image.pixels, mask).image)})


SOLVED = ("read_scene", "segment", "complete_depth", "inpaint")


@contextmanager
def configured(stand_ins: StandIns, root: Path, *tasks: str, record: str | None = None) -> Iterator[ModelSetup]:
    """Serve stand-ins, and yield a setup in which the given tasks, or all, are configured to use them."""
    with serving(stand_ins.model()) as url:
        source = ModelSource(url=url, record=record, timeout_s=20)
        yield ModelSetup(root, dict.fromkeys(tasks or SOLVED, (source, "a test")))
