"""Pictures of a scene at rest beside the image from which it was reconstructed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frames.reduced import reduced, reduction
from simfoundry.capture.segment.masks import Labels
from simfoundry.render.montage import Image, overlay, png_bytes, side_by_side
from simfoundry.render.raycast import Raycast, raycast
from simfoundry.scene.model import Scene
from simfoundry.scene.state import SceneState

# Compression of pictures: a quarter of the time that the best one takes, for files that are a fifth larger.
FAST = 3

TINT = 0.45  # Opacity of the colors of objects: half, so that edges in the image remain visible


@dataclass(frozen=True, eq=False)
class RenderedScene:
    """A scene in a state, which is lowered and rendered only if needed, and then once.

    ``lower`` returns the scene, whose first camera is that of the image. ``drawing`` waits for its picture if
    a thread already draws it.
    """

    lower: Callable[[], Scene]
    state: SceneState
    drawing: Callable[[], Image] | None = None

    @cached_property
    def scene(self) -> Scene:
        """The lowered scene."""
        return self.lower()

    @cached_property
    def ray(self) -> Raycast:
        """The scene as its first camera sees it."""
        return raycast(self.scene, self.scene.cameras[0], self.state)

    @cached_property
    def picture(self) -> Image:
        """The picture of the scene from its first camera; see :func:`first_view`."""
        return first_view(self.scene, self.state) if self.drawing is None else self.drawing()


def first_view(scene: Scene, state: SceneState) -> Image:
    """Return a picture of a scene from its first camera; a large one has the resolution of :func:`reduced` images."""
    camera = scene.cameras[0]
    step = reduction((camera.height, camera.width))
    middle = step // 2
    width, height = (len(range(middle, extent, step)) for extent in (camera.width, camera.height))
    fx, fy, cx, cy = camera.fx / step, camera.fy / step, (camera.cx - middle) / step, (camera.cy - middle) / step
    small = replace(camera, width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy)
    return raycast(scene, small, state).color


def comparison_picture(color: NDArray[np.uint8], labels: Labels, rendered: RenderedScene) -> bytes:
    """Return a PNG image with the captured image, the objects found in it, and the scene at rest side by side.

    Large images are shown at a lower resolution.
    """
    step = reduction(labels.shape)
    color, labels = reduced(color, step), reduced(labels, step)
    panels = [("capture", color), ("objects found", overlay(color, labels, TINT)), ("simulated", rendered.picture)]
    return png_bytes(side_by_side(panels), FAST)
