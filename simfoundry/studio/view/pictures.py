"""Small pictures of the cameras' views, shown in their frusta."""

from __future__ import annotations

import io
from collections.abc import Callable
from itertools import islice

from simfoundry.render.raycast import quick_image
from simfoundry.render.views import shrunk
from simfoundry.scene.model import Scene
from simfoundry.studio.view.nodes import posed_cameras

# Size [px] of the pictures, which are as wide as a thumb on the screen, and the number of cameras that get one.
WIDTH, HEIGHT, MAX_CAMERAS = 192, 144, 8


def camera_pictures(scene: Scene, checkpoint: Callable[[], None]) -> dict[str, bytes]:
    """Return the PNG image that each camera sees. ``checkpoint`` can raise an exception to stop."""
    from PIL import Image

    found: dict[str, bytes] = {}
    for camera in islice(posed_cameras(scene), MAX_CAMERAS):
        image = quick_image(scene, shrunk(camera, WIDTH, HEIGHT), checkpoint=checkpoint)
        out = io.BytesIO()
        Image.fromarray(image).save(out, format="PNG", compress_level=1)
        found[camera.name] = out.getvalue()
    return found
