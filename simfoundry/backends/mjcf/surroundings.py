"""Cameras and lights in MJCF."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator

import numpy as np

from simfoundry.backends.artifact import number, numbers
from simfoundry.backends.losses import Loss, approximate
from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.model import Camera, Light, LightType, Scene

OPENCV_FROM_OPENGL = Pose.of(q=[0.0, 1.0, 0.0, 0.0])
"""Half a turn about x, between camera axes x right, y down, z forward and x right, y up, z backward."""

_HALF_PIXEL = 0.5
"""In a scene, the center of the first pixel is (0, 0); MuJoCo measures from the corner of the image."""


def add_camera(world: ET.Element, camera: Camera) -> None:
    """Add a camera with exact intrinsics; MuJoCo measures the principal point from the image center, left and up."""
    X_WG = camera.X_WC @ OPENCV_FROM_OPENGL
    principal = (camera.width / 2 - (camera.cx + _HALF_PIXEL), camera.height / 2 - (camera.cy + _HALF_PIXEL))
    attributes = {
        "name": camera.name,
        "pos": numbers(X_WG.p),
        "quat": numbers(X_WG.q),
        "resolution": f"{camera.width} {camera.height}",
        # Any sensor with the aspect ratio of the image would do; one micrometer per pixel keeps the numbers readable.
        "sensorsize": numbers([camera.width * 1e-6, camera.height * 1e-6]),
        "focalpixel": numbers([camera.fx, camera.fy]),
        "principalpixel": numbers(principal),
    }
    ET.SubElement(world, "camera", attributes)


def add_lights(world: ET.Element, lights: tuple[Light, ...]) -> None:
    """Add the lights that have a position or direction; they are Lambertian, without highlights or attenuation."""
    for light in lights:
        if light.type is LightType.DOME:
            continue
        attributes = {
            "name": light.name,
            "pos": numbers(light.X_WL.p),
            "dir": numbers(light.X_WL.rotation @ np.array([0.0, 0.0, -1.0])),
            "diffuse": numbers(light.intensity * light.rgb),
            "ambient": "0 0 0",
            "specular": "0 0 0",
        }
        if light.type is LightType.DISTANT:
            attributes["directional"] = "true"
        else:
            attributes |= {"cutoff": number(180), "exponent": "0", "attenuation": "1 0 0"}
        ET.SubElement(world, "light", attributes)


def headlight(lights: tuple[Light, ...]) -> dict[str, str] | None:
    """Return MuJoCo's headlight attributes, the sum of all dome lights; None if the scene has no lights."""
    if not lights:
        return None
    domes: list[Array] = [light.intensity * light.rgb for light in lights if light.type is LightType.DOME]
    return {"ambient": numbers(sum(domes, np.zeros(3))), "diffuse": "0 0 0", "specular": "0 0 0"}


def light_losses(scene: Scene) -> Iterator[Loss]:
    """Yield one loss for each dome light."""
    reason = "MuJoCo has no dome lights; its color lights all surfaces equally, without shading."
    return (approximate("dome_lights", t.name, reason) for t in scene.lights if t.type is LightType.DOME)
