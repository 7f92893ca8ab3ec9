"""Conversion of the panorama of a dome light to a MuJoCo skybox."""

from __future__ import annotations

import io
import xml.etree.ElementTree as ET

import numpy as np

from simfoundry.geometry.frames import Array
from simfoundry.scene.model import Light, LightType

# Side of each face of the skybox [px]: 90 degrees in 512 pixels is as sharp as a 2048 pixel wide panorama.
SIDE = 512


def skybox_light(lights: tuple[Light, ...]) -> Light | None:
    """Return the dome light whose panorama MuJoCo shows, which is the first one that can be decoded."""
    domes = (light for light in lights if light.type is LightType.DOME and light.panorama is not None)
    return next((light for light in domes if light.panorama is not None and light.panorama.suffix != ".exr"), None)


def add_skybox(asset: ET.Element, light: Light) -> dict[str, bytes]:
    """Add a skybox with the panorama of a dome light, and return its images, keyed by file name."""
    files = {f"sky_{name}.png": content for name, content in _faces(light).items()}
    names = {f"file{name}": f"sky_{name}.png" for name in _DIRECTIONS}
    ET.SubElement(asset, "texture", {"name": "sky", "type": "skybox"} | names)
    return files


# Rows that map a pixel of each face to the x, y and z of its direction in the world. A pixel is ``(u, v, 1)``, with u
# from -1 at the left to 1 at the right, and v from 1 at the top to -1 at the bottom. MuJoCo mirrors the faces, as was
# measured by rendering colored ones.
_DIRECTIONS = {
    "right": ((0, 0, 1), (1, 0, 0), (0, 1, 0)),
    "left": ((0, 0, -1), (-1, 0, 0), (0, 1, 0)),
    "back": ((-1, 0, 0), (0, 0, 1), (0, 1, 0)),
    "front": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "up": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "down": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
}


def _faces(light: Light) -> dict[str, bytes]:
    """Return the faces as PNG, in which radiances above 1 are clipped."""
    from PIL import Image

    assert light.panorama is not None
    pixels = light.panorama.pixels()
    assert pixels is not None
    height, width, _ = pixels.shape
    centers = (np.arange(SIDE) + 0.5) / SIDE * 2 - 1
    face = np.stack([*np.meshgrid(centers, -centers), np.ones((SIDE, SIDE))])
    faces = {}
    for name, rows in _DIRECTIONS.items():
        x, y, z = np.tensordot(light.X_WL.rotation.T @ np.array(rows, dtype=np.float64), face, axes=1)
        column = (np.pi - np.arctan2(y, x)) / (2 * np.pi) * width
        row = (np.pi / 2 - np.arctan2(z, np.hypot(x, y))) / np.pi * height
        seen = pixels[np.clip(row.astype(int), 0, height - 1), column.astype(int) % width]
        image = Image.fromarray((_srgb(seen * light.intensity * light.rgb) * 255).round().astype(np.uint8))
        stream = io.BytesIO()
        image.save(stream, format="PNG")
        faces[name] = stream.getvalue()
    return faces


def _srgb(linear: Array) -> Array:
    clipped = np.clip(linear, 0.0, 1.0)
    return np.asarray(np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055))
