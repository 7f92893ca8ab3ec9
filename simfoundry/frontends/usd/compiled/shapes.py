"""Stretch shapes of a document."""

from __future__ import annotations

from typing import Any

from simfoundry.frontends.usd.compiled.values import short
from simfoundry.geometry.frames import Array

_EVEN = 1e-6
"""Share by which factors may differ and still be one: single precision, in which stages hold them."""


def scaled(data: dict[str, Any], factors: Array) -> tuple[dict[str, Any], str]:
    """Return the changed data of an object that is stretched by ``factors`` along its axes, shape (3,).

    Or else the reason why the language has no shape for the result.
    """
    x, y, z = (float(f) for f in factors)
    if min(x, y, z) <= 0:
        return {}, "it is mirrored or flat, which no shape of a scene is"
    even, round_ = max(x, y, z) - min(x, y, z) <= _EVEN * x, abs(x - y) <= _EVEN * x
    shape = data.get("shape")
    if not isinstance(shape, dict):
        if str(data.get("asset", "")).endswith(".yaml"):
            return {}, "it was scaled, and an asset document has its own size"
        return ({"scale": short(data.get("scale", 1.0) * x)}, "") if even else ({}, "a mesh scales alike in all axes")
    kind, value = next(iter(shape.items()))
    if (kind in ("sphere", "capsule") and not even) or (kind in ("cylinder", "lathe") and not round_):
        return {}, f"stretched by {x:.4g}, {y:.4g}, {z:.4g} it is no {kind} any more"
    match kind:
        case "box":
            new: Any = tuple(short(v * f) for v, f in zip(value, (x, y, z), strict=True))
        case "sphere":
            new = short(value * x)
        case "cylinder" | "capsule":
            new = {"radius": short(value["radius"] * x), "height": short(value["height"] * z)}
        case "lathe":
            new = {"profile": tuple((short(r * x), short(h * z)) for r, h in value["profile"])}
        case _:
            outline = tuple((short(a * x), short(b * y)) for a, b in value["outline"])
            new = {"outline": outline, "height": short(value["height"] * z)}
    return {"shape": {kind: new}}, ""
