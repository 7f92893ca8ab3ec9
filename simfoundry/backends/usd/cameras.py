"""Cameras: pinhole intrinsics as focal length, apertures and aperture offsets."""

from __future__ import annotations

from simfoundry.backends.artifact import rounded
from simfoundry.backends.usd.prims import Prim, attribute, define, place
from simfoundry.geometry.frames import Pose
from simfoundry.scene.model import Camera

# Focal length and apertures share a unit, and only their ratios matter. At 1/32 per pixel the values resemble a real
# lens (640 px become 20 mm), and a power of two preserves all digits of the width.
PIXEL = 1.0 / 32.0

# A scene counts pixels from the center of the first one, as OpenCV does; an aperture starts at the edge of that pixel.
HALF_PIXEL = 0.5

#: From OpenCV's camera axes (x right, y down, z forward) to USD's (x right, y up, looking along -z).
X_CU = Pose.of(q=(0.0, 1.0, 0.0, 0.0))


def define_camera(scope: Prim, camera: Camera) -> None:
    """Define ``camera`` with exact intrinsics; the image size in pixels is stored as a custom attribute.

    USD has a single focal length, so unequal ``fx`` and ``fy`` become non-square pixels with a stretched vertical
    aperture.
    """
    prim = define(scope, camera.name, "Camera")
    right = camera.width / 2 - (camera.cx + HALF_PIXEL)
    up = camera.cy + HALF_PIXEL - camera.height / 2
    tall = PIXEL * camera.fx / camera.fy
    attribute(prim, "clippingRange", "float2", (0.01, 1000.0))
    attribute(prim, "focalLength", "float", rounded(camera.fx * PIXEL))
    attribute(prim, "horizontalAperture", "float", rounded(camera.width * PIXEL))
    attribute(prim, "horizontalApertureOffset", "float", rounded(right * PIXEL))
    attribute(prim, "projection", "token", "perspective")
    attribute(prim, "simfoundry:resolution", "int2", (camera.width, camera.height), uniform=True)
    attribute(prim, "verticalAperture", "float", rounded(camera.height * tall))
    attribute(prim, "verticalApertureOffset", "float", rounded(up * tall))
    place(prim, camera.X_WC @ X_CU)
