"""Deform meshes smoothly, and replace handles with swept tubes.

A deformation never maps two points to the same point, so closed meshes stay closed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.errors import MeshError
from simfoundry.assets.mesh import MeshPart, file_scale, merged, read_parts
from simfoundry.cousins.objects.components import Component, Key, Kind, components, parts_of, with_parts
from simfoundry.cousins.objects.parts import aimed, at, axis_of, capsule, rod
from simfoundry.cousins.objects.profiles import Profile, Rng, resampled
from simfoundry.geometry.frames import Array, frozen_array
from simfoundry.geometry.shapes import Mesh
from simfoundry.scene.meshfile import obj_with_material
from simfoundry.spec.models.asset import AssetSpec, PartSpec

# Folder for the meshes of variants, next to their documents.
FOLDER = "meshes"


def deformed(spec: AssetSpec, files: Mapping[str, Path], rng: Rng) -> tuple[AssetSpec, dict[str, bytes], str]:
    """Apply the same random deformation to all meshes of an asset.

    Args:
        spec: The asset.
        files: Paths of the asset's mesh files by name.
        rng: Random generator.

    Returns:
        The new spec, the new files by name, and a description of the change.

    Raises:
        MeshError: A mesh has several textures, which an OBJ file cannot represent.
    """
    factor = np.exp(rng.uniform(np.log(0.88), np.log(1.15), 3))
    taper, belly = rng.uniform(-0.15, 0.15), rng.uniform(-0.08, 0.1)
    new: dict[str, bytes] = {}
    parts = parts_of(spec)
    meshes = {key: part for key, part in parts.items() if part.mesh is not None}
    read = {
        key: read_parts(files[part.mesh or ""], file_scale(files[part.mesh or ""], part.scale))
        for key, part in meshes.items()
    }
    heights = np.concatenate([piece.vertices[:, 2] for pieces in read.values() for piece in pieces])
    low, high = float(heights.min()), float(heights.max())
    for key, part in meshes.items():
        piece = joined(read[key], part.mesh or "")
        # x and y are scaled by a smooth positive function of z, and z by a constant, so the Jacobian is positive.
        share = (piece.vertices[:, 2] - low) / (high - low)
        vertices = piece.vertices * factor
        vertices[:, :2] *= (1 + taper * (share - 0.5) + belly * np.sin(np.pi * share))[:, None]
        vertices[:, 2] += low - low * factor[2]  # the base stays in place
        name, written = mesh_files(Mesh(frozen_array(vertices), piece.faces, piece.uv, piece.texture))
        new |= written
        color = part.color
        if color is None and piece.texture is None and piece.rgba is not None:
            color = piece.rgba[:3]
        parts[key] = part.model_copy(update={"mesh": name, "scale": 1.0, "color": color})
    sizes = ", ".join(f"{axis} {f:.2f}" for axis, f in zip("xyz", factor, strict=True))
    return with_parts(spec, parts), new, f"deformed: {sizes}, taper {taper:+.2f}, belly {belly:+.2f}"


def mesh_files(mesh: Mesh) -> tuple[str, dict[str, bytes]]:
    """Return the name of a mesh's OBJ file, and the contents of all files that belong to the mesh, keyed by name.

    All files are in :data:`FOLDER`.
    """
    files = {f"{FOLDER}/{name}": data for name, data in obj_with_material(mesh).items()}
    return next(iter(files)), files


def strips(rings: NDArray[np.integer]) -> NDArray[np.int32]:
    """Return the triangles between adjacent rings of vertices.

    Args:
        rings: Indices of the vertices, shape (rings, n).

    Returns:
        Indices of the triangles' corners, shape (rings - 1, 2, n - 1, 3). In each strip, the triangles with two corners
        on its first ring come first.
    """
    a, b, c, d = rings[:-1, :-1], rings[:-1, 1:], rings[1:, 1:], rings[1:, :-1]
    return np.stack([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)], axis=1).astype(np.int32)


def joined(parts: tuple[MeshPart, ...], name: str) -> MeshPart:
    """Merge the pieces of the mesh called ``name``.

    Raises:
        MeshError: The pieces have several textures.
    """
    if len(parts) == 1:
        return parts[0]
    if any(p.texture is not None for p in parts):
        message = f"{name} has several textures, but an OBJ file can have only one"
        raise MeshError("SF301", message, "merge them into one image")
    return MeshPart(*merged(parts), rgba=next((p.rgba for p in parts if p.rgba is not None), None))


# Number of rings along a tube's path, and number of corners per ring. The facets of a mug's handle are then 2 mm wide
# and are hidden by shading.
RINGS, AROUND = 33, 14

# Number of capsules in a tube's collision geometry. They deviate by 0.8 mm from a half circle with a radius of 30 mm.
COLLIDERS = 7

# Length [m] by which a tube's axis extends into the body, so that its entire end is inside an inclined or curved wall.
# Points beyond the other side of the wall are moved back into the wall.
SUNK = 0.004

# Fraction of a wall's thickness that the ends of a handle penetrate.
IN_WALL = 0.5

# Name of the visual part of a tube; the collision parts are capsules.
LOOK = "handle_look"


@dataclass(frozen=True, eq=False)
class Loop:
    """A loop handle, which consists of a bar on two posts.

    Attributes:
        feet: Attachment points of the posts [m], shape (2, 3).
        out: Unit vector along which the handle protrudes, shape (3,).
        reach: Distance of the bar's axis from the feet [m].
        radius: Radius of the bar [m].
        wall: Profile of the solid of revolution to which the handle is attached, and the height of its frame in the
            link [m]. The value is None if the handle is attached to a different kind of body.
    """

    feet: Array
    out: Array
    reach: float
    radius: float
    wall: tuple[Profile, float] | None

    @classmethod
    def of(cls, spec: AssetSpec, component: Component) -> Loop | None:
        """Return the loop formed by a component's rods, or None if the component is not a loop."""
        own = component.parts_in(spec)
        rods = [(part, size) for part in own if (size := rod(part)) is not None]
        wall = _wall(spec, component.link)
        # The handle protrudes radially from a solid of revolution, and along a coordinate axis from any other body.
        middle = np.mean([at(p) for p in own], axis=0) * [1.0, 1.0, 0.0]
        off = float(np.linalg.norm(middle))
        out = middle / off if wall is not None and off > 1e-3 else component.outward(spec)
        if out is None or len(rods) != len(own):
            return None
        posts = [(p, size) for p, size in rods if abs(float(axis_of(p) @ out)) > 0.9]
        bars = [(p, size) for p, size in rods if abs(float(axis_of(p) @ out)) < 0.3]
        if len(posts) != 2 or len(bars) != 1:
            return None
        feet = np.array([at(p) - out * size[1] / 2 for p, size in posts])
        reach = float((at(bars[0][0]) - feet.mean(axis=0)) @ out)
        return cls(feet, out, reach, bars[0][1][0], wall) if reach > 2 * bars[0][1][0] else None

    @property
    def sunk(self) -> float:
        """The maximum depth to which the ends of the handle extend into the body [m]."""
        return IN_WALL * self.wall[0].thinnest if self.wall is not None else SUNK

    def outside(self, points: Array) -> Array:
        """Move points outward that are too deep inside the wall.

        The points [m] have shape (n, 3). Points that are deeper than :attr:`sunk` are moved to that depth.
        """
        if self.wall is None:
            return points
        profile, base = self.wall
        off = np.linalg.norm(points[:, :2], axis=1)
        least = profile.radius(points[:, 2] - base) - self.sunk
        share = np.maximum(1.0, least / np.maximum(off, 1e-6))
        return np.column_stack([points[:, :2] * share[:, None], points[:, 2]])


def _wall(spec: AssetSpec, link: str) -> tuple[Profile, float] | None:
    vessels = (c for c in components(spec) if c.kind is Kind.VESSEL and c.link == link)
    lathe = next((lathe for c in vessels if (lathe := c.lathe(spec)) is not None), None)
    return None if lathe is None else (lathe[1], float(at(parts_of(spec)[lathe[0]])[2]))


def swept(spec: AssetSpec, only: Sequence[str], rng: Rng) -> tuple[AssetSpec, dict[str, bytes], str]:
    """Replace all loop handles of an asset with smooth tubes that have the same random form.

    Args:
        spec: The asset.
        only: Names of the components that may change. If it is empty, all components may change.
        rng: Random generator.

    Returns:
        The new spec, the new files by name, and a description of the change. If there are no loop handles, the spec is
        unchanged and the description is empty.
    """
    name = list(FORMS)[int(rng.integers(len(FORMS)))]
    broad, flat = rng.uniform(0.95, 1.5), rng.uniform(0.8, 1.05)
    files: dict[str, bytes] = {}
    said = ""
    for component in components(spec):
        allowed = component.kind is Kind.HANDLE and (not only or component.name in only)
        loop = Loop.of(spec, component) if allowed else None
        if loop is None:
            continue
        path = _path(loop, FORMS[name])
        look, written = mesh_files(_tube(path, loop, broad * loop.radius, flat * loop.radius))
        files |= written
        spec = _replaced(spec, component, loop, path, flat * loop.radius, look)
        said = f"{name} handle"
    return spec, files, said


def _path(loop: Loop, form: Callable[[Array], tuple[Array, Array]]) -> Array:
    """Return evenly spaced points along the axis of a tube, from one foot to the other.

    Returns:
        Array of shape (RINGS, 3) [m].
    """
    t = np.linspace(0.0, 1.0, 201)
    along, off = form(t)
    start, end = loop.feet - SUNK * loop.out
    points = start + along[:, None] * (end - start) + (loop.reach + SUNK) * off[:, None] * loop.out
    return resampled(points, RINGS)


def _tube(path: Array, loop: Loop, broad: float, flat: float) -> Mesh:
    """Return a closed tube with an elliptical cross section along a planar path.

    Args:
        path: Points along the axis [m], shape (n, 3).
        loop: The handle that the tube replaces.
        broad: Semi-axis of the cross section perpendicular to the plane of the path [m].
        flat: Semi-axis of the cross section in the plane of the path [m].
    """
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    across = np.cross(loop.feet[1] - loop.feet[0], loop.out)
    across /= np.linalg.norm(across)
    inward = np.cross(tangent, across)
    angle = np.arange(AROUND) * (2 * np.pi / AROUND)
    # The tube is slightly thicker at its feet, where a potter would press it onto the body.
    thick = 1 + 0.25 * np.abs(np.linspace(-1, 1, len(path))) ** 4
    rings = path[:, None] + thick[:, None, None] * (
        broad * np.cos(angle)[:, None] * across + flat * np.sin(angle)[:, None] * inward[:, None]
    )
    vertices = loop.outside(np.concatenate([rings.reshape(-1, 3), path[:1], path[-1:]]))
    grid = np.arange(len(path))[:, None] * AROUND + np.arange(AROUND + 1) % AROUND
    here, after, last, end = grid[0, :-1], grid[0, 1:], grid[-1], np.full(AROUND, len(path) * AROUND)
    caps = [np.column_stack([after, here, end]), np.column_stack([last[:-1], last[1:], end + 1])]
    every = np.concatenate([strips(grid).reshape(-1, 3), *caps]).astype(np.int32)
    corners = vertices[every]
    if np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) < 0:
        every = every[:, ::-1]
    return Mesh(frozen_array(vertices), np.ascontiguousarray(every))


def _replaced(spec: AssetSpec, component: Component, loop: Loop, path: Array, radius: float, mesh: str) -> AssetSpec:
    """Replace the rods of a handle with capsules along a path and a visual mesh."""
    # Shorten the chain so that the round ends of the outer capsules extend no deeper into the body than the tube.
    joints = resampled(path, COLLIDERS + 1, SUNK + max(radius - loop.sunk, 0.0))
    parts = parts_of(spec)
    model = parts[component.parts[0]]
    kept = {k: p for k, p in parts.items() if k not in component.parts}
    added: dict[Key, PartSpec] = {}
    for n, (a, b) in enumerate(pairwise(joints)):
        long = float(np.linalg.norm(b - a))
        shape, pose = capsule(round(radius, 6), round(long, 6)), aimed((a + b) / 2, (b - a) / long)
        piece = PartSpec(shape=shape, pose=pose, material=model.material, use="collision")
        added[component.link, f"{component.name}_{n}"] = piece
    look = PartSpec(mesh=mesh, material=model.material, color=model.color, use="visual")
    added[component.link, LOOK if (component.link, LOOK) not in kept else f"{LOOK}_{component.name}"] = look
    return with_parts(spec, kept | added)


def _square(t: Array) -> tuple[Array, Array]:
    """Return a superellipse that is nearly straight along the grip and has round corners."""
    c, s = np.cos(np.pi * t), np.sin(np.pi * t)
    return (1 - np.sign(c) * np.abs(c) ** 0.5) / 2, np.abs(s) ** 0.5


def _ear(t: Array) -> tuple[Array, Array]:
    """Return an ear shape that protrudes farther near its end."""
    return (1 - np.cos(np.pi * t)) / 2, 1.05 * np.sin(np.pi * t) * (0.62 + 0.38 * t**1.5) / 0.84


def _ring(t: Array) -> tuple[Array, Array]:
    """Return a circular arc that is wider than the distance between its ends."""
    angle = np.pi * (1.3 * t - 0.15)
    return 0.5 - 0.5 * np.cos(angle) / np.cos(0.15 * np.pi), (np.sin(angle) + np.sin(0.15 * np.pi)) / 1.454


# Tube paths by name. Each function maps the path parameter, from 0 to 1, to the normalized position between the feet
# and the normalized outward distance.
FORMS: dict[str, Callable[[Array], tuple[Array, Array]]] = {
    "half-round": lambda t: ((1 - np.cos(np.pi * t)) / 2, np.sin(np.pi * t)),
    "square": _square,
    "ear-shaped": _ear,
    # Protrudes farther near its beginning.
    "drop-shaped": lambda t: (1 - _ear(1 - t)[0], _ear(1 - t)[1]),
    "ring-shaped": _ring,
    # Runs straight outward and then curves back to the other foot.
    "strap": lambda t: (t**1.6, np.sin(np.pi * t**0.6) ** 0.8),
}
