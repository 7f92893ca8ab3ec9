"""Gaussian splats as USD prims of the type ``ParticleField3DGaussianSplat`` (OpenUSD 26.03 and later).

The prims have linear scales, opacities in [0, 1], quaternions that arrays show in xyzw order, and the coefficients of
the spherical harmonics sorted by order, with those of each Gaussian together.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.assets.errors import MeshError
from simfoundry.geometry.frames import Array, Pose, from_xyzw
from simfoundry.geometry.similarity import Similarity
from simfoundry.runtime.usd_layers import author, crate_bytes, new_crate
from simfoundry.splats.gaussians import (
    EXPORT,
    MAX_DEGREE,
    GaussianSplat,
    check_count,
    gaussian_splat,
    joined_splats,
)
from simfoundry.splats.y_up import X_ZY

# Name and type of the prim that holds a splat in the layers of this project.
FIELD, FIELD_TYPE = "splat", "ParticleField3DGaussianSplat"

# Extent of a Gaussian in standard deviations.
_REACH = 3.0


def splat_layer(splat: GaussianSplat) -> bytes:
    """Return a layer in the crate format whose default prim is the Gaussian field. Equal splats give equal bytes."""
    return crate_bytes(_layer(splat))


def splat_text(splat: GaussianSplat) -> bytes:
    """Return the layer of :func:`splat_layer` in the text format."""
    return str(_layer(splat).ExportToString()).encode()


def _layer(splat: GaussianSplat) -> Any:
    from pxr import Sdf, Vt

    layer = new_crate(FIELD)
    with Sdf.ChangeBlock():
        prim = Sdf.PrimSpec(layer, FIELD, Sdf.SpecifierDef, FIELD_TYPE)
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
    return layer


def read_usd(path: Path) -> GaussianSplat:
    """Read the Gaussians of all splats on a USD stage at its default time, in meters and with z up.

    Raises:
        MeshError: If the file has no usable splat.
    """
    from pxr import Sdf, Tf, Usd, UsdGeom

    try:
        layer = Sdf.Layer.OpenAsAnonymous(str(path))
        others = layer.GetCompositionAssetDependencies()
        if others:
            message = f"it refers to the file {others[0]}, and only single files can be read; flatten it"
            raise _unreadable(path.name, message)
        stage = Usd.Stage.Open(layer)
    except Tf.ErrorException:
        raise _unreadable(path.name, "it is not a USD file") from None
    unit = float(UsdGeom.GetStageMetersPerUnit(stage))
    if not (np.isfinite(unit) and unit > 0):
        raise _unreadable(path.name, "its `metersPerUnit` is not greater than zero")
    up = X_ZY if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y else Pose.of()
    S_WU = Similarity(up, unit)
    prims = [prim for prim in stage.Traverse() if prim.GetTypeName() == FIELD_TYPE]
    check_count(path.name, sum(_count(prim) for prim in prims))
    parts = []
    for prim in prims:
        matrix = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())).T
        try:
            S_UF = Similarity.from_matrix(matrix)
        except ValueError as error:
            raise _unreadable(path.name, f"the prim {prim.GetPath()} is {error}") from None
        parts.append(_field(path.name, prim).moved(S_WU @ S_UF))
    return joined_splats(path.name, parts)


def _field(name: str, prim: Any) -> GaussianSplat:
    """Return the splat of a prim in its own frame and unit."""
    count = _count(prim)
    degree = prim.GetAttribute("radiance:sphericalHarmonicsDegree").Get()
    if not isinstance(degree, int) or not 0 <= degree <= MAX_DEGREE:
        raise _unreadable(name, f"the degree of its spherical harmonics is not between 0 and {MAX_DEGREE}")
    terms = (degree + 1) ** 2
    coefficients = _values(name, prim, "radiance:sphericalHarmonicsCoefficients", (count * terms, 3))
    return gaussian_splat(
        name,
        positions=_values(name, prim, "positions", (count, 3)),
        scales=_values(name, prim, "scales", (count, 3)),
        rotations=from_xyzw(_values(name, prim, "orientations", (count, 4))),
        opacities=_values(name, prim, "opacities", (count,)),
        harmonics=coefficients.reshape(count, terms, 3),
    )


def _count(prim: Any) -> int:
    return len(_attribute(prim, "positions") or ())


def _values(name: str, prim: Any, attribute: str, shape: tuple[int, ...]) -> Array:
    found = _attribute(prim, attribute)
    values = np.zeros(0) if found is None else np.array(found, dtype=np.float64)
    if values.shape != shape:
        raise _unreadable(name, f"the attribute `{attribute}` of the prim {prim.GetPath()} has the wrong length")
    return values


def _attribute(prim: Any, name: str) -> Any:
    """Return the values of an attribute in single precision or, without them, in half precision."""
    found = prim.GetAttribute(name).Get()
    return found if found is not None else prim.GetAttribute(name + "h").Get()


def _unreadable(name: str, reason: str) -> MeshError:
    return MeshError("SF301", f"{name} could not be read as a splat: {reason}", EXPORT)
