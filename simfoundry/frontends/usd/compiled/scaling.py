"""Scale the shape or mesh of an object by one factor along each of its axes."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from simfoundry.frontends.document_data import rounded
from simfoundry.geometry.frames import Array

# Rounds numbers to six significant digits, which removes single-precision noise: 0.31 instead of 0.310000002.
short = partial(rounded, digits=6)

# Relative tolerance for equal scale factors, which stages store in single precision.
_EVEN = 1e-6


def scale_object(data: dict[str, Any], factors: Array) -> tuple[dict[str, Any], str]:
    """Scale an object by one factor along each of its axes.

    Returns:
        The changed keys, and the reason why the result cannot be expressed. The reason is an empty string if the result
        can be expressed.
    """
    x, y, z = (float(f) for f in factors)
    if min(x, y, z) <= 0:
        return {}, "the object is mirrored or flat, which scenes do not support"
    even, round_ = max(x, y, z) - min(x, y, z) <= _EVEN * x, abs(x - y) <= _EVEN * x
    shape = data.get("shape")
    if not isinstance(shape, dict):
        if str(data.get("asset", "")).endswith(".yaml"):
            return {}, "the object was scaled, but objects from asset documents cannot be scaled"
        scale = np.array(data.get("scale", 1.0)) * (x if even else np.asarray(factors))
        return {"scale": short(scale.tolist())}, ""
    kind, value = next(iter(shape.items()))
    if kind == "sphere" and not even:
        return {"shape": {"ellipsoid": short((value * np.asarray(factors)).tolist())}}, ""
    needs_even = kind in ("capsule", "open_box", "compound") and not even
    if needs_even or (kind in ("cylinder", "cone", "lathe") and not round_):
        return {}, f"scaled by {x:.4g}, {y:.4g}, {z:.4g}, it is no longer a{'n' * (kind[0] == 'o')} {kind}"
    if kind == "compound":
        return {"shape": {"compound": {name: _scale_part(part, factors) for name, part in value.items()}}}, ""
    by_size = {"sphere": x, "radius": x, "height": z, "wall": x, "profile": (x, z), "outline": (x, y)}
    by_size |= dict.fromkeys(("box", "ellipsoid", "size"), factors)
    sizes = value if isinstance(value, dict) else {kind: value}
    new = {name: short((np.array(size) * by_size[name]).tolist()) for name, size in sizes.items()}
    return {"shape": {kind: new if isinstance(value, dict) else new[kind]}}, ""


def _scale_part(part: dict[str, Any], factors: Array) -> dict[str, Any]:
    """Scale a part of a compound uniformly."""
    out = part | scale_object(part, factors)[0]
    if "xyz" in part.get("pose", {}):
        out["pose"] = part["pose"] | {"xyz": short((np.array(part["pose"]["xyz"]) * factors).tolist())}
    return out
