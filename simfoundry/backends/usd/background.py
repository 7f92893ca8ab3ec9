"""The background: meshes without colliders, or a field of Gaussians in a separate layer."""

from __future__ import annotations

import numpy as np

from simfoundry.backends.usd.crates import author, crate_bytes, new_crate
from simfoundry.backends.usd.geometry import define_geometry
from simfoundry.backends.usd.materials import visual_material
from simfoundry.backends.usd.prims import Prim, define, place, relate
from simfoundry.scene.model import Background, Splat

SPLAT = "assets/background.usdc"
"""The path of the splat's layer in the artifact."""

_REACH = 3.0
"""Number of standard deviations of a Gaussian that count as its extent."""


def define_background(world: Prim, looks: Prim, background: Background) -> None:
    """Define ``background`` below ``/World/Background``."""
    prim = define(world, "Background", "Xform")
    place(prim, background.X_WB)
    for visual in background.visuals:
        shown = define_geometry(prim, visual.name, visual.geometry, visual.X_LG, ["MaterialBindingAPI"])
        relate(shown, "material:binding", [visual_material(looks, visual)])
    if background.splat is not None:
        field = define(prim, "splat", "ParticleField3DGaussianSplat")
        field.references.append(f"@./{SPLAT}@")


def splat_layer(splat: Splat) -> bytes:
    """Return a layer whose default prim is the Gaussian field, with colors as spherical harmonics by order."""
    from pxr import Sdf, Vt

    layer = new_crate("splat")
    with Sdf.ChangeBlock():
        prim = Sdf.PrimSpec(layer, "splat", Sdf.SpecifierDef, "ParticleField3DGaussianSplat")
        reach = _REACH * splat.scales.max(axis=1, keepdims=True)
        corners = np.stack([(splat.positions - reach).min(axis=0), (splat.positions + reach).max(axis=0)])
        author(prim, "extent", "float3[]", Vt.Vec3fArray.FromNumpy(corners))
        author(prim, "positions", "point3f[]", Vt.Vec3fArray.FromNumpy(splat.positions))
        author(prim, "scales", "float3[]", Vt.Vec3fArray.FromNumpy(splat.scales))
        xyzw = np.ascontiguousarray(splat.rotations[:, [1, 2, 3, 0]])
        author(prim, "orientations", "quatf[]", Vt.QuatfArray.FromNumpy(xyzw))
        author(prim, "opacities", "float[]", Vt.FloatArray.FromNumpy(splat.opacities))
        author(prim, "radiance:sphericalHarmonicsDegree", "int", splat.degree, uniform=True)
        colors = np.ascontiguousarray(splat.harmonics.reshape(-1, 3))
        author(prim, "radiance:sphericalHarmonicsCoefficients", "float3[]", Vt.Vec3fArray.FromNumpy(colors))
    return crate_bytes(layer)
