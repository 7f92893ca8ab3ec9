"""How much of a thing is in the picture of a camera."""

from __future__ import annotations

import numpy as np

from simfoundry.scene.frames import Array
from simfoundry.scene.model import Camera

SEEN = 0.6
"""At least this share of a thing is in the picture of one camera."""

CLOSEST = 0.01
"""What is nearer to a camera than this along its axis [m] is not seen."""


def share_in_view(camera: Camera, points: Array) -> float:
    """The share of points in the world [m], shape (n, 3), that are in a camera's picture, were nothing before them."""
    local = (points - camera.X_WC.p) @ camera.X_WC.rotation
    z = local[:, 2]
    ahead = z > CLOSEST
    depth = np.where(ahead, z, 1.0)
    u, v = camera.fx * local[:, 0] / depth + camera.cx, camera.fy * local[:, 1] / depth + camera.cy
    inside = ahead & (u >= -0.5) & (u < camera.width - 0.5) & (v >= -0.5) & (v < camera.height - 0.5)
    return float(inside.mean())


def best_view(cameras: tuple[Camera, ...], points: Array) -> tuple[str, float]:
    """The camera that has most of some points in its picture, and the share."""
    shares = [(share_in_view(camera, points), camera.name) for camera in cameras]
    share, name = max(shares, key=lambda pair: pair[0])
    return name, share
