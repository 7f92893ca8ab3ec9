"""Cameras, lights and the background of a scene. Gaussian splats are stored in a separate layer."""

from __future__ import annotations

import hashlib
import math

from simfoundry.backends.usd.prims import Asset, Prim, vec3
from simfoundry.backends.usd.shapes import define_visual, linear_from_srgb
from simfoundry.geometry.frames import Pose
from simfoundry.scene.model import Background, Camera, Light, LightType, Panorama
from simfoundry.splats.usd import FIELD, FIELD_TYPE

# The path of the splat layer in the artifact.
SPLAT = "assets/background.usdc"


def define_background(world: Prim, looks: Prim, background: Background) -> None:
    """Define ``background`` below ``/World/Background``."""
    prim = world.define("Background", "Xform")
    prim.place(background.X_WB)
    for visual in background.visuals:
        define_visual(prim, looks, visual)
    if background.splat is not None:
        field = prim.define(FIELD, FIELD_TYPE)
        field.references.append(f"@./{SPLAT}@")


# Focal length and apertures have the same unit, and only their ratios matter. At 1/32 per pixel, the values resemble a
# real lens (640 px correspond to 20 mm), and a power of two preserves all digits of the width.
PIXEL = 1.0 / 32.0

# Like OpenCV, a scene measures pixel coordinates from the center of the first pixel; an aperture starts at its edge.
HALF_PIXEL = 0.5

#: From OpenCV's camera axes (x right, y down, z forward) to USD's (x right, y up, looking along -z).
X_CU = Pose.of(q=(0.0, 1.0, 0.0, 0.0))


def define_camera(scope: Prim, camera: Camera) -> None:
    """Define ``camera`` with exact intrinsics, and store the image size in pixels in a custom attribute.

    USD has a single focal length, so unequal ``fx`` and ``fy`` are represented by non-square pixels with a stretched
    vertical aperture.
    """
    prim = scope.define(camera.name, "Camera")
    right = camera.width / 2 - (camera.cx + HALF_PIXEL)
    up = camera.cy + HALF_PIXEL - camera.height / 2
    tall = PIXEL * camera.fx / camera.fy
    prim.attribute("clippingRange", "float2", (0.01, 1000.0))
    prim.floats(camera.fx * PIXEL, "focalLength")
    prim.floats(camera.width * PIXEL, "horizontalAperture")
    prim.floats(right * PIXEL, "horizontalApertureOffset")
    prim.attribute("projection", "token", "perspective")
    prim.attribute("simfoundry:resolution", "int2", (camera.width, camera.height), uniform=True)
    prim.floats(camera.height * tall, "verticalAperture")
    prim.floats(up * tall, "verticalApertureOffset")
    prim.place(camera.X_WC @ X_CU)


# A white diffuse surface has radiance 1 at irradiance pi. A normalized distant light's intensity is its irradiance. A
# normalized sphere light yields intensity / (4 d^2) at distance d, here 1 m. A dome light's intensity is its radiance.
FULL = {LightType.DISTANT: math.pi, LightType.POINT: 4.0 * math.pi, LightType.DOME: 1.0}
_POINT_RADIUS = 0.02  # m, about the size of a light bulb; a sphere light needs a radius


# Rotation from the axes of a USD dome, whose image has its center along z and its top along y, to those of a scene,
# with the center along x and the top along z.
X_DOME = Pose.of(q=(0.5, 0.5, 0.5, 0.5))


def panorama_path(panorama: Panorama) -> str:
    """Return the path of a panorama in the artifact, with a file name derived from its content."""
    return f"assets/{hashlib.sha256(panorama.content).hexdigest()[:16]}{panorama.suffix}"


def define_light(scope: Prim, light: Light) -> None:
    """Define ``light`` so that intensity 1 makes a white surface facing it (1 m away for a point light) look white."""
    match light.type:
        case LightType.DISTANT:
            prim = scope.define(light.name, "DistantLight")
            prim.attribute("inputs:angle", "float", 0.53)
        case LightType.POINT:
            prim = scope.define(light.name, "SphereLight")
            prim.attribute("extent", "float3[]", [(-_POINT_RADIUS,) * 3, (_POINT_RADIUS,) * 3])
            prim.attribute("inputs:radius", "float", _POINT_RADIUS)
            prim.attribute("treatAsPoint", "bool", True)
        case LightType.DOME:
            prim = scope.define(light.name, "DomeLight")
            if light.panorama is not None:
                prim.attribute("inputs:texture:file", "asset", Asset(f"./{panorama_path(light.panorama)}"))
                prim.attribute("inputs:texture:format", "token", "latlong")
    prim.attribute("inputs:color", "color3f", vec3(linear_from_srgb(light.rgb)))
    prim.floats(light.intensity * FULL[light.type], "inputs:intensity")
    if light.type is not LightType.DOME:
        prim.attribute("inputs:normalize", "bool", True)
    prim.place(light.X_WL if light.panorama is None else light.X_WL @ X_DOME)
