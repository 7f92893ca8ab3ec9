"""Pictures of a scene at rest beside the image from which it was reconstructed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.segment.masks import Labels
from simfoundry.render.montage import overlay, png_bytes, side_by_side
from simfoundry.render.raycast import Raycast, raycast
from simfoundry.scene.model import Scene
from simfoundry.scene.state import SceneState

# Compression of pictures: a quarter of the time that the best one takes, for files that are a fifth larger.
FAST = 3

TINT = 0.45  # Opacity of the colors of objects: half, so that edges in the image remain visible


@dataclass(frozen=True, eq=False)
class RenderedScene:
    """A scene in a state, which is lowered and rendered only if needed, and then once.

    ``lower`` returns the scene, whose first camera is that of the image.
    """

    lower: Callable[[], Scene]
    state: SceneState

    @cached_property
    def scene(self) -> Scene:
        """The lowered scene."""
        return self.lower()

    @cached_property
    def ray(self) -> Raycast:
        """The scene as its first camera sees it."""
        return raycast(self.scene, self.scene.cameras[0], self.state)


def comparison_picture(color: NDArray[np.uint8], labels: Labels, rendered: RenderedScene) -> bytes:
    """Return a PNG image with the captured image, the objects found in it, and the scene at rest side by side."""
    panels = [("capture", color), ("objects found", overlay(color, labels, TINT)), ("simulated", rendered.ray.color)]
    return png_bytes(side_by_side(panels), FAST)
