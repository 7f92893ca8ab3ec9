"""Images of the scenes for the report, by MuJoCo if a GL driver is available, otherwise by the ray caster."""

from __future__ import annotations

import math

import numpy as np

from simfoundry.geometry.frames import look_at
from simfoundry.scene.model import Camera, Scene
from simfoundry.scene.object_shapes import world_bounds

WIDTH, HEIGHT = 480, 300
"""Size of an image [px]: two columns of a report on a laptop."""

_FIELD_DEG = 40.0
"""Vertical field of view, narrow enough to show objects without distortion."""


def picture(scene: Scene) -> bytes:
    """Return a PNG of the scene: its first camera scaled down, or a view from a corner above all movable objects."""
    from simfoundry.render.gl import choose_engine
    from simfoundry.render.montage import png_bytes
    from simfoundry.worlds.render import render

    return png_bytes(render(scene, overview(scene), engine=choose_engine("auto")))


def overview(scene: Scene) -> Camera:
    """Return a camera that sees all movable objects, or all objects if none can move."""
    free = [o for o in scene.objects if not o.fixed] or list(scene.objects)
    corners = [np.stack(world_bounds(o, o.X_WO)) for o in free]
    low = np.min([c[0] for c in corners], axis=0) if corners else np.zeros(3)
    high = np.max([c[1] for c in corners], axis=0) if corners else np.ones(3)
    center, radius = (low + high) / 2, max(0.1, float(np.linalg.norm(high - low)) / 2)
    distance = radius / math.sin(math.radians(_FIELD_DEG) / 2)
    eye = center + distance * np.array([-0.62, -0.42, 0.66])
    f = HEIGHT / 2 / math.tan(math.radians(_FIELD_DEG) / 2)
    return Camera("overview", WIDTH, HEIGHT, f, f, WIDTH / 2 - 0.5, HEIGHT / 2 - 0.5, look_at(eye, center))
