"""Read splat files with other packages, and write some: ``python foreign_splats.py FOLDER``.

Runs in an environment of its own. plyfile and GaussForge read ``a.ply``; GaussForge, which contains Niantic's code, and
usd-convert-gsplat (NVIDIA) read ``a2.spz`` and ``a3.spz``; pygltflib reads ``a.glb``. GaussForge writes ``forge2.spz``
and ``forge3.spz``, and usd-convert-gsplat writes ``nvidia.usda``. Values are stored in ``values.npz``.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

COLUMNS = ("positions", "scales", "rotations", "alphas", "colors", "sh")


def by_gaussforge(folder: Path) -> dict[str, Any]:
    """Read the files with GaussForge, and convert the PLY file."""
    import gaussforge

    forge, found = gaussforge.GaussForge(), dict[str, Any]()
    for name in ("a.ply", "a2.spz", "a3.spz"):
        values = forge.read((folder / name).read_bytes(), name[-3:])["data"]
        found |= {f"forge {name} {key}": np.frombuffer(values[key], np.float32) for key in COLUMNS}
    ply = (folder / "a.ply").read_bytes()
    for version in (2, 3):
        made = forge.convert(ply, "ply", "spz", spz_version=version)
        (folder / f"forge{version}.spz").write_bytes(made["data"])
    return found


def by_nvidia(folder: Path) -> dict[str, Any]:
    """Read the SPZ files with usd-convert-gsplat, and convert the PLY file to USD."""
    from usd_convert_gsplat.ply_reader import read_ply
    from usd_convert_gsplat.spz_reader import read_spz
    from usd_convert_gsplat.usd_writer import write_gaussian_splat_usd

    found: dict[str, Any] = {}
    for name in ("a2.spz", "a3.spz"):
        values = vars(read_spz(str(folder / name)))
        found |= {f"nvidia {name} {key}": values[key] for key in values if isinstance(values[key], np.ndarray)}
    ply = folder / "a.ply"
    write_gaussian_splat_usd(read_ply(str(ply)), str(folder / "nvidia.usda"), source_file=str(ply), up_axis="Z")
    return found


def by_readers(folder: Path) -> dict[str, Any]:
    """Read the PLY file with plyfile, and the accessors of the GLB file with pygltflib."""
    import plyfile
    import pygltflib

    rows = plyfile.PlyData.read(folder / "a.ply")["vertex"].data
    found: dict[str, Any] = {f"plyfile {name}": np.array(rows[name]) for name in rows.dtype.names}
    tree = pygltflib.GLTF2().load(folder / "a.glb")
    primitive = tree.meshes[tree.nodes[tree.scenes[tree.scene].nodes[0]].mesh].primitives[0]
    for name, index in vars(primitive.attributes).items():
        if index is None:
            continue
        accessor = tree.accessors[index]
        view = tree.bufferViews[accessor.bufferView]
        data = tree.binary_blob()[view.byteOffset : view.byteOffset + view.byteLength]
        found[f"glb {name}"] = np.frombuffer(data, np.float32).reshape(accessor.count, -1)
    found["glb rotation"] = np.array(tree.nodes[0].rotation)
    return found


if __name__ == "__main__":
    here = Path(sys.argv[1])
    np.savez(here / "values.npz", **by_gaussforge(here), **by_nvidia(here), **by_readers(here))
