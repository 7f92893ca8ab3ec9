"""Cameras and lights as the arguments of PyBullet's ``getCameraImage``."""

from __future__ import annotations

import math

import numpy as np

from simfoundry.backends.artifact import rounded, rounded_list
from simfoundry.geometry.frames import Array
from simfoundry.scene.model import Camera, Light, LightType

NEAR, FAR = 0.01, 100.0
"""Near and far clipping distances of the cameras [m]: a wrist camera sees its own fingers at 2 cm; no room is
larger."""


def camera_arguments(camera: Camera) -> dict[str, object]:
    """Return the image size, view matrix and projection matrix; both matrices are column-major, as in OpenGL."""
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    view = flip @ camera.X_WC.inverse().matrix
    return {
        "width": camera.width,
        "height": camera.height,
        "view": rounded_list(view.T),
        "projection": rounded_list(projection_matrix(camera).T),
    }


def projection_matrix(camera: Camera) -> Array:
    """Return OpenGL's projection matrix of a pinhole camera, shape (4, 4); the center of the first pixel is (0, 0)."""
    left, right = -(camera.cx + 0.5) / camera.fx, (camera.width - camera.cx - 0.5) / camera.fx
    top, bottom = (camera.cy + 0.5) / camera.fy, -(camera.height - camera.cy - 0.5) / camera.fy
    return np.array(
        [
            [2 / (right - left), 0.0, (right + left) / (right - left), 0.0],
            [0.0, 2 / (top - bottom), (top + bottom) / (top - bottom), 0.0],
            [0.0, 0.0, -(FAR + NEAR) / (FAR - NEAR), -2 * FAR * NEAR / (FAR - NEAR)],
            [0.0, 0.0, -1.0, 0.0],
        ]
    )


def lighting_arguments(lights: tuple[Light, ...]) -> dict[str, object]:
    """Return the light of an image and the sum of the dome lights; empty for a scene without lights."""
    if not lights:
        return {}
    dome = math.fsum(t.intensity * float(np.mean(t.rgb)) for t in lights if t.type is LightType.DOME)
    lighting: dict[str, object] = {"lightAmbientCoeff": rounded(dome), "lightSpecularCoeff": 0.0}
    main = main_light(lights)
    if main is None:
        return lighting | {"lightDiffuseCoeff": 0.0}
    toward = main.X_WL.rotation[:, 2] if main.type is LightType.DISTANT else main.X_WL.p
    color = {"lightDirection": rounded_list(toward), "lightColor": rounded_list(main.rgb)}
    return lighting | color | {"lightDiffuseCoeff": rounded(main.intensity)}


def main_light(lights: tuple[Light, ...]) -> Light | None:
    """Return the only light that PyBullet can render: the first one that is not a dome."""
    return next((light for light in lights if light.type is not LightType.DOME), None)
