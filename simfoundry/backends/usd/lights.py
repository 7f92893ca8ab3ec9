"""Lights: UsdLux lights in UsdLux units."""

from __future__ import annotations

import math

from simfoundry.backends.artifact import rounded
from simfoundry.backends.usd.materials import linear_from_srgb
from simfoundry.backends.usd.prims import Prim, attribute, define, place, vec3
from simfoundry.scene.model import Light, LightType

# A white diffuse surface has radiance 1 at irradiance pi. A normalized distant light states its irradiance; a
# normalized sphere gives intensity / (4 d^2) at distance d, here 1 m; a dome states its radiance.
FULL = {LightType.DISTANT: math.pi, LightType.POINT: 4.0 * math.pi, LightType.DOME: 1.0}
_POINT_RADIUS = 0.02


def define_light(scope: Prim, light: Light) -> None:
    """Define ``light``; intensity 1 makes a white surface facing it appear white (for a point light, at 1 m)."""
    match light.type:
        case LightType.DISTANT:
            prim = define(scope, light.name, "DistantLight")
            attribute(prim, "inputs:angle", "float", 0.53)
        case LightType.POINT:
            prim = define(scope, light.name, "SphereLight")
            attribute(prim, "extent", "float3[]", [(-_POINT_RADIUS,) * 3, (_POINT_RADIUS,) * 3])
            attribute(prim, "inputs:radius", "float", _POINT_RADIUS)
            attribute(prim, "treatAsPoint", "bool", True)
        case LightType.DOME:
            prim = define(scope, light.name, "DomeLight")
    attribute(prim, "inputs:color", "color3f", vec3(linear_from_srgb(light.rgb)))
    attribute(prim, "inputs:intensity", "float", rounded(light.intensity * FULL[light.type]))
    if light.type is not LightType.DOME:
        attribute(prim, "inputs:normalize", "bool", True)
    place(prim, light.X_WL)
