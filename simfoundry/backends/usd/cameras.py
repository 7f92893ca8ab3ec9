"""Cameras: a pinhole's intrinsics as focal length, apertures and their offsets."""

from __future__ import annotations

from typing import TYPE_CHECKING

from simfoundry.backends.usd.prims import attribute, define, place, rounded
from simfoundry.scene.frames import Pose
from simfoundry.scene.model import Camera

if TYPE_CHECKING:
    from pxr import Sdf

# Focal length and apertures share a unit, and only their ratios count. At 1/32 a pixel they read like a real lens
# (640 px become 20 mm), and a power of two loses no digit of the width.
PIXEL = 1.0 / 32.0

#: From OpenCV's camera axes (x right, y down, z forward) to USD's (x right, y up, looking along -z).
X_CU = Pose.of(q=(0.0, 1.0, 0.0, 0.0))


def define_camera(scope: Sdf.PrimSpec, camera: Camera) -> None:
    """Define ``camera``; ``cx`` and ``cy`` count from the picture's upper left corner.

    USD has one focal length, so unequal ``fx`` and ``fy`` become unequal pixels: the vertical aperture is stretched.
    """
    from pxr import Gf

    prim = define(scope, camera.name, "Camera")
    tall = PIXEL * camera.fx / camera.fy
    attribute(prim, "clippingRange", "float2", Gf.Vec2f(0.01, 1000.0))
    attribute(prim, "focalLength", "float", rounded(camera.fx * PIXEL))
    attribute(prim, "horizontalAperture", "float", rounded(camera.width * PIXEL))
    attribute(prim, "horizontalApertureOffset", "float", rounded((camera.width / 2 - camera.cx) * PIXEL))
    attribute(prim, "projection", "token", "perspective")
    attribute(prim, "simfoundry:resolution", "int2", Gf.Vec2i(camera.width, camera.height), uniform=True)
    attribute(prim, "verticalAperture", "float", rounded(camera.height * tall))
    attribute(prim, "verticalApertureOffset", "float", rounded((camera.cy - camera.height / 2) * tall))
    place(prim, camera.X_WC @ X_CU)
