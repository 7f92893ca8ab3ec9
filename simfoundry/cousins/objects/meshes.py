"""Meshes deformed smoothly: every point goes one to one to another, so that what was closed stays closed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from simfoundry.assets.errors import MeshError
from simfoundry.assets.mesh import MeshPart, read_parts
from simfoundry.cousins.objects.geometry import Rng
from simfoundry.cousins.objects.parts import Key, parts_of, with_parts
from simfoundry.geometry.frames import Array, frozen_array
from simfoundry.geometry.shapes import Mesh
from simfoundry.scene.meshfile import obj_with_material
from simfoundry.spec.models.asset import AssetSpec, PartSpec

FOLDER = "meshes"
"""Where the meshes of variants lie, beside their documents."""


def deformed(spec: AssetSpec, files: Mapping[str, Path], rng: Rng) -> tuple[AssetSpec, dict[str, bytes], str]:
    """The asset with all its meshes deformed alike: the new spec, the new files by name, and what was changed.

    Raises :class:`MeshError` for a mesh with several textures, which one OBJ cannot hold.
    """
    change, words = _deformation(rng)
    new: dict[str, bytes] = {}
    parts = parts_of(spec)
    meshes = {key: part for key, part in parts.items() if part.mesh is not None}
    span = _heights([(files[part.mesh or ""], part.scale) for part in meshes.values()])
    changed: dict[Key, PartSpec] = {}
    for key, part in meshes.items():
        assert part.mesh is not None
        read = joined(read_parts(files[part.mesh], part.scale))
        if read is None:
            message = f"{part.mesh} has several textures, which one OBJ cannot hold"
            raise MeshError("SF301", message, "join them in one picture")
        vertices = change(read.vertices, *span)
        mesh = Mesh(frozen_array(vertices), read.faces, read.uv, read.texture)
        written = obj_with_material(mesh)
        new |= {f"{FOLDER}/{name}": data for name, data in written.items()}
        color = part.color if part.color is not None else None if read.texture is not None else _rgb(read)
        changed[key] = part.model_copy(update={"mesh": f"{FOLDER}/{next(iter(written))}", "scale": 1.0, "color": color})
    return with_parts(spec, parts | changed), new, words


def joined(parts: tuple[MeshPart, ...]) -> MeshPart | None:
    """The pieces of a mesh file as one; None where they have different textures."""
    if len(parts) == 1:
        return parts[0]
    if any(p.texture is not None for p in parts):
        return None
    offsets = np.cumsum([0, *(len(p.vertices) for p in parts)])
    faces = np.concatenate([p.faces + o for p, o in zip(parts, offsets, strict=False)]).astype(np.int32)
    color = next((p.rgba for p in parts if p.rgba is not None), None)
    return MeshPart(np.concatenate([p.vertices for p in parts]), faces, rgba=color)


class _Deformation:
    """x and y times a smooth positive function of the height, z times a constant: its Jacobian is positive."""

    def __init__(self, factor: Array, taper: float, belly: float) -> None:
        self.factor, self.taper, self.belly = factor, taper, belly

    def __call__(self, vertices: Array, low: float, high: float) -> Array:
        share = (vertices[:, 2] - low) / (high - low)
        across = 1 + self.taper * (share - 0.5) + self.belly * np.sin(np.pi * share)
        out = vertices * self.factor
        out[:, :2] *= across[:, None]
        out[:, 2] += low - low * self.factor[2]  # the foot stays where it is
        return np.asarray(out)


def _deformation(rng: Rng) -> tuple[_Deformation, str]:
    factor = np.exp(rng.uniform(np.log(0.88), np.log(1.15), 3))
    taper, belly = rng.uniform(-0.15, 0.15), rng.uniform(-0.08, 0.1)
    sizes = ", ".join(f"{axis} {f:.2f}" for axis, f in zip("xyz", factor, strict=True))
    return _Deformation(factor, taper, belly), f"deformed: {sizes}, taper {taper:+.2f}, belly {belly:+.2f}"


def _heights(files: list[tuple[Path, float]]) -> tuple[float, float]:
    heights = [p.vertices[:, 2] for path, scale in files for p in read_parts(path, scale)]
    every = np.concatenate(heights)
    return float(every.min()), float(every.max())


def _rgb(part: MeshPart) -> tuple[float, float, float] | None:
    return None if part.rgba is None else part.rgba[:3]
