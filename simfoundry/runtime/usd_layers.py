"""USD layers in the crate format, written such that equal layers have equal bytes."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pxr import Sdf


def new_crate(default_prim: str) -> Sdf.Layer:
    """Return an empty layer in meters with z up, to be filled by the caller and passed to :func:`crate_bytes`."""
    from pxr import Sdf

    layer = Sdf.Layer.CreateAnonymous(".usdc")
    root = layer.pseudoRoot
    root.SetInfo("metersPerUnit", 1.0)
    root.SetInfo("upAxis", "Z")
    layer.defaultPrim = default_prim
    return layer


def author(prim: Sdf.PrimSpec, name: str, type_name: str, value: object, *, uniform: bool = False) -> Sdf.AttributeSpec:
    """Author an attribute of a prim in a crate layer."""
    from pxr import Sdf

    variability = Sdf.VariabilityUniform if uniform else Sdf.VariabilityVarying
    made = Sdf.AttributeSpec(prim, name, Sdf.ValueTypeNames.Find(type_name), variability)
    made.default = value
    return made


def crate_bytes(layer: Sdf.Layer) -> bytes:
    """Return the layer in the crate format. Identical layers produce identical bytes, even across Python versions.

    USD can only write crates to files. The crate version is 0.8.0, which all releases since 2020 can read.
    """
    with tempfile.TemporaryDirectory(prefix="simfoundry-") as folder:
        path = Path(folder) / "layer.usdc"
        layer.Export(str(path))
        return path.read_bytes()
