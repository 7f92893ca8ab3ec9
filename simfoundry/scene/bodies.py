"""Build a rigid body from shapes and meshes, including its visuals, colliders, mass, center of mass and inertia."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from simfoundry.assets import mass
from simfoundry.assets.cache import Cache, key_of
from simfoundry.assets.errors import MeshError, Scale
from simfoundry.geometry.frames import IDENTITY, Array, Pose
from simfoundry.geometry.frames import frozen_array as frozen
from simfoundry.geometry.shapes import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    Faces,
    Geometry,
    Mesh,
    Sphere,
    closed_mesh,
)
from simfoundry.scene.box_mapping import Texture, textured
from simfoundry.scene.model import Collider, Link, Visual
from simfoundry.scene.state import pose
from simfoundry.spec.models import base, shapes
from simfoundry.spec.models.asset import Inertial, PartSpec

if TYPE_CHECKING:
    from simfoundry.assets.mesh import MeshPart
    from simfoundry.scene.mesh_bodies import MeshBody

GRAY = (0.7, 0.7, 0.7, 1.0)
# Density [kg/m^3] of a piece without a density, which is allowed if its body is fixed or has a specified mass.
USUAL_DENSITY = 1000.0

# Minimum mass [kg] and inertia [kg m^2] that MuJoCo accepts for a moving body.
LEAST_MASS = LEAST_MOMENT = 1e-15


# Indices of the entries of an inertia matrix in a document's order: xx, yy, zz, xy, xz, yz.
TENSOR = [[0, 3, 4], [3, 1, 5], [4, 5, 2]]


# A part of an asset's link, or of a compound.
Part = PartSpec | shapes.CompoundPart


class MeshUse(NamedTuple):
    """Options for using a mesh file in a body.

    Attributes:
        scale: Factor that converts the file's units to meters, or one factor along each axis of the mesh.
        touches: False if the mesh has no colliders.
        solid: The solid from which the mass is computed, or `given` if the body's mass is already specified. In that
            case, the mesh does not need to be closed.
        collision: The type of collider.
    """

    scale: Scale
    touches: bool = True
    solid: Literal["exact", "hull", "given"] = "exact"
    collision: str = "auto"


@dataclass
class BodyBuilder:
    """A builder that collects the parts of a link and computes the finished link.

    If the mass of the link is already specified (``weighed``), its parts do not need a volume. In a ``draft``, meshes
    are neither shown nor decomposed. A mesh without cached convex parts is represented by its hull, and
    ``is_approximate`` is set. If ``shown`` is set, a draft has the same visuals as a build. ``texture_of`` returns the
    texture of a material, if it has one. ``hidden`` contains the whole meshes of parts with native data that are not
    shown. ``drafts`` contains the mesh bodies of a draft, which are shared by all objects with the same mesh.

    Raises:
        MeshError: If a mesh is unusable.
    """

    name: str
    body: base.BodySpec
    materials: dict[str, base.Material]
    cache: Cache | None
    weighed: bool = False
    draft: bool = False
    shown: bool = False
    is_approximate: bool = False
    visuals: list[Visual] = field(default_factory=list)
    colliders: list[Collider] = field(default_factory=list)
    solids: list[tuple[float | None, mass.SolidMoments]] = field(default_factory=list)
    collision_error: float = 0.0
    hidden: dict[str, Mesh] = field(default_factory=dict)
    report: Callable[[str], object] = lambda said: None
    texture_of: Callable[[str], Texture | None] = lambda material: None
    drafts: dict[tuple[Path, MeshUse], MeshBody] = field(default_factory=dict)

    def add_shape(self, name: str, shape: shapes.Shape, X_LG: Pose, part: Part | None, show: bool = True) -> None:
        """Add a shape at a pose in the link frame.

        The parts of a compound keep their names, and the walls of an open box are named ``name_floor``, ``name_left``
        and so on. ``show`` is False if a mesh is shown instead of the shape.
        """
        if isinstance(shape, shapes.CompoundShape):
            for own_name, own in shape.compound.items():
                self.add_shape(own_name, own.shape, X_LG @ pose(own.pose), own, show)
            return
        if isinstance(shape, shapes.OpenBoxShape):
            for wall_name, wall, X_GW in open_box_walls(shape.open_box):
                self.add_shape(f"{name}_{wall_name}", wall, X_LG @ X_GW, part, show)
            return
        body = shape_body(shape, self.cache)
        if show and _use(part) != "collision":
            self._show_surface(name, body.visual, X_LG, part)
        if _use(part) == "visual":
            return
        if self.body.collision != "none":
            self.collision_error = max(self.collision_error, body.error)
            is_cut = body.colliders[0] is not body.visual
            names = _piece_names(name, len(body.colliders), part) if is_cut else [name]
            for label, piece in zip(names, body.colliders, strict=True):
                self._collide(label, piece, X_LG, part)
        self._weigh(body.solid, X_LG, part)

    def add_mesh(self, name: str, path: Path, scale: Scale, X_LG: Pose, part: Part | None, show: bool = True) -> None:
        """Add a mesh file at a pose in the link frame.

        The entire mesh is used as the visual, but the mass and the colliders are computed from a single solid.
        """
        solid: Literal["exact", "hull", "given"] = "given" if self.weighed else self.body.solid
        body = self._mesh_body(path, MeshUse(scale, _use(part) != "visual", solid, self.body.collision))
        if show and _use(part) != "collision":
            self._show(name, body.pieces, X_LG, part)
        elif isinstance(part, PartSpec) and part.native is not None and len(body.pieces) == 1:
            self.hidden[name] = closed_mesh(body.pieces[0].vertices, body.pieces[0].faces)
        if body.solid is not None:
            self._weigh(body.solid, X_LG, part)
        self.collision_error = max(self.collision_error, body.error)
        self.is_approximate |= body.is_approximate
        for label, (geometry, X_GP) in zip(_piece_names(name, len(body.colliders), part), body.colliders, strict=True):
            self._collide(label, geometry, X_LG @ X_GP, part)

    def add_visual(self, name: str, path: Path, scale: Scale = 1.0) -> None:
        """Add a visual-only mesh file."""
        self._show(name, self._mesh_body(path, MeshUse(scale, touches=False)).pieces, IDENTITY, None)

    def _mesh_body(self, path: Path, use: MeshUse) -> MeshBody:
        from simfoundry.scene import mesh_bodies  # lazy import because most scenes have no meshes

        if self.draft:
            if (path, use) not in self.drafts:
                body = mesh_bodies.draft_body(path, use, self.cache)
                pieces = mesh_bodies.shown_pieces(path, use.scale) if self.shown else ()
                self.drafts[path, use] = body._replace(pieces=pieces)
            return self.drafts[path, use]
        return mesh_bodies.read_body(path, use, self.cache, self.report)

    def _show(self, name: str, pieces: tuple[MeshPart, ...], X_LG: Pose, part: Part | None) -> None:
        for k, piece in enumerate(pieces):
            label = name if len(pieces) == 1 else f"{name}_{k}"
            if piece.texture is None and piece.rgba is None:
                self._show_surface(label, _piece_mesh(piece), X_LG, part)
                continue
            mesh = _piece_mesh(piece)
            # Textured meshes are white by default, so that the texture is unchanged.
            own = (1.0, 1.0, 1.0, 1.0) if piece.texture is not None and piece.rgba is None else piece.rgba
            self.visuals.append(Visual(label, mesh, self._rgba(part, own), X_LG))

    def _show_surface(self, name: str, geometry: Geometry, X_LG: Pose, part: Part | None) -> None:
        """Add a visual without a color of its own, which has the color and the texture of its material."""
        material = self._material_name(part)
        hidden = self.draft and not self.shown
        texture = None if material is None or hidden else self.texture_of(material)
        if texture is None:
            self.visuals.append(Visual(name, geometry, self._rgba(part, None), X_LG))
            return
        rgba = self._rgba(part, self._material(part).color or (1.0, 1.0, 1.0, 1.0))
        self.visuals.append(Visual(name, textured(geometry, texture), rgba, X_LG))

    def link(self, fixed: bool, inertial: Inertial | None) -> Link:
        """Return the finished link.

        Raises:
            MeshError: If the link has no mass.
        """
        total = base.quantity_value(self.body.mass)
        if self.weighed:
            assert total is not None and inertial is not None and inertial.inertia is not None
            return self._finished(total, np.array(inertial.com), np.array(inertial.inertia)[TENSOR], fixed)
        own = base.quantity_value(self.body.density)
        densities = [own if own is not None else density for density, _ in self.solids]
        if total is not None or fixed:  # a specified mass is distributed over the parts; a fixed body requires no mass
            densities = [USUAL_DENSITY if d is None else d for d in densities]
        weighed = [(d, s) for d, (_, s) in zip(densities, self.solids, strict=True) if d is not None]
        if len(weighed) < len(densities):
            hint = "give `mass`, `density`, or a `material` with a density"
            raise MeshError("SF108", f"`{self.name}` has no mass", hint)
        if not 0 < sum(d * s.volume for d, s in weighed) < math.inf:
            raise MeshError("SF104", f"the mass of `{self.name}` is not finite", "check its sizes and densities")
        computed, com, inertia = mass.combine(weighed)
        if total is not None:
            inertia = inertia * (total / computed)
        if inertial is not None:
            com = np.array(inertial.com)
        return self._finished(total if total is not None else computed, com, inertia, fixed)

    def _finished(self, mass_kg: float, com: Array, inertia: Array, fixed: bool) -> Link:
        inertia = (inertia + inertia.T) / 2  # exactly symmetric despite rounding
        shapes = tuple(self.visuals), tuple(self.colliders)
        link = Link(self.name, mass_kg, frozen(com), frozen(inertia), *shapes, self.collision_error)
        least, middle, largest = moments = sorted(link.principal[0].tolist())
        if not (least > 0 and largest <= (least + middle) * (1 + 1e-6) < math.inf):
            shown = ", ".join(f"{m:.3g}" for m in moments)
            message = f"`{self.name}` has moments of inertia {shown}, which are impossible for a rigid body"
            raise MeshError("SF104", message, "check `inertial`")
        if not fixed and (mass_kg < LEAST_MASS or least < LEAST_MOMENT):
            shown = f"`{self.name}` of {mass_kg:.3g} kg has a moment of inertia of {least:.3g} kg m^2"
            raise MeshError("SF104", f"{shown}, which is too small for a simulator", "check its mass, size and units")
        return link

    def _weigh(self, solid: mass.SolidMoments, X_LG: Pose, part: Part | None) -> None:
        moved = solid if X_LG.is_identity else solid.moved(X_LG.rotation, X_LG.p)
        self.solids.append((self._material(part).density, moved))

    def _collide(self, name: str, geometry: Geometry, X_LG: Pose, part: Part | None) -> None:
        material = self._material(part)
        friction = material.friction if self.body.friction is None else self.body.friction
        restitution = material.restitution if self.body.restitution is None else self.body.restitution
        spinning, rolling = material.torsional_friction, material.rolling_friction
        label = self._material_name(part) or ""
        self.colliders.append(Collider(name, geometry, friction, restitution, X_LG, spinning, rolling, label))

    def _material_name(self, part: Part | None) -> str | None:
        return part.material if part is not None and part.material is not None else self.body.material

    def _material(self, part: Part | None) -> base.Material:
        name = self._material_name(part)
        return base.Material() if name is None else self.materials[name]

    def _rgba(self, part: Part | None, default: tuple[float, ...] | None) -> Array:
        """Return the first color that is set for the part, the body, the mesh file or the material.

        The default is gray.
        """
        colors = part.color if part is not None else None, self.body.color, default, self._material(part).color
        return frozen((*next((color for color in colors if color is not None), GRAY), 1.0)[:4])


@lru_cache(maxsize=64)  # pieces that are kept are rendered without being prepared again
def _piece_mesh(piece: MeshPart) -> Mesh:
    return closed_mesh(piece.vertices, piece.faces, piece.uv, piece.texture)


def _use(part: Part | None) -> str:
    """Return the use of a part, which is both a visual and a collider by default."""
    return part.use if isinstance(part, PartSpec) else "both"


def _piece_names(name: str, count: int, part: Part | None) -> list[str]:
    """Return names for the convex parts of a piece.

    The names are numbered unless there is only one convex part and no visual has the same name.
    """
    return [name] if count == 1 and _use(part) == "collision" else [f"{name}_{k}" for k in range(count)]


# Version of the convex decomposition of lathes and prisms; part of the cache key.
CUT_VERSION = "cut shape 1"


class ShapeBody(NamedTuple):
    """The body of a shape in the shape's own frame: a ``visual``, a ``solid`` with density 1, and ``colliders``.

    ``error`` [m] is the maximum distance between the colliders and the shape.
    """

    visual: Geometry
    solid: mass.SolidMoments
    colliders: tuple[Geometry, ...]
    error: float = 0.0


def open_box_walls(box: shapes.OpenBox) -> Iterator[tuple[str, shapes.BoxShape, Pose]]:
    """Yield the name, the shape and the pose of the floor and the walls of an open box, which do not overlap.

    Seen along x, the walls are called `front` (-x), `back` (+x), `left` (+y) and `right` (-y). The walls stand on the
    floor, and those on the left and right are between the other two.
    """
    (x, y, z), t = box.size, box.wall
    floor, front, back, left, right = shapes.WALLS
    yield floor, shapes.BoxShape(box=(x, y, t)), Pose.of([0.0, 0.0, (t - z) / 2])
    for name, side in ((front, -1), (back, 1)):
        yield name, shapes.BoxShape(box=(t, y, z - t)), Pose.of([side * (x - t) / 2, 0.0, t / 2])
    for name, side in ((left, 1), (right, -1)):
        yield name, shapes.BoxShape(box=(x - 2 * t, t, z - t)), Pose.of([0.0, side * (y - t) / 2, t / 2])


# Shapes that are lowered to a single solid.
Solid = (
    shapes.BoxShape | shapes.SphereShape | shapes.EllipsoidShape | shapes.CylinderShape | shapes.CapsuleShape
    | shapes.ConeShape | shapes.PrismShape | shapes.LatheShape
)  # fmt: skip


@lru_cache(maxsize=1024)
def shape_body(shape: Solid, cache: Cache | None = None) -> ShapeBody:
    """Return the body of a shape.

    Decomposing a lathe or prism takes up to 40 ms and imports two large libraries, so ``cache`` stores the parts for
    later runs.

    Raises:
        MeshError: If a profile or outline does not enclose an area.
    """
    geometry: Geometry
    match shape:
        case shapes.BoxShape():
            geometry, solid = Box(frozen(shape.box)), mass.box(np.array(shape.box))
        case shapes.SphereShape():
            geometry, solid = Sphere(shape.sphere), mass.sphere(shape.sphere)
        case shapes.EllipsoidShape():
            radii = frozen(shape.ellipsoid)
            geometry, solid = Ellipsoid(radii), mass.ellipsoid(radii)
        case shapes.ConeShape(cone=c):
            geometry, solid = Cone(c.radius, c.height), mass.cone(c.radius, c.height)
        case shapes.CylinderShape(cylinder=c):
            geometry, solid = Cylinder(c.radius, c.height), mass.cylinder(c.radius, c.height)
        case shapes.CapsuleShape(capsule=c):
            geometry, solid = Capsule(c.radius, c.height), mass.capsule(c.radius, c.height)
        case shapes.PrismShape(prism=p):
            from simfoundry.assets.solids import prism_mesh

            outline, parts, _ = _cut(shape, cache)
            whole = prism_mesh(outline, p.height)
            return ShapeBody(closed_mesh(*whole), mass.mesh(*whole), parts)
        case shapes.LatheShape():
            from simfoundry.assets.solids import lathe_mesh

            profile, parts, error = _cut(shape, cache)
            return ShapeBody(closed_mesh(*lathe_mesh(profile)), mass.revolution(profile), parts, error)
    return ShapeBody(geometry, solid, (geometry,))


# A checked outline or profile, the convex parts of its solid, and their maximum distance from it [m].
_Cut = tuple[Array, tuple[Geometry, ...], float]


def _cut(shape: shapes.PrismShape | shapes.LatheShape, cache: Cache | None) -> _Cut:
    key = key_of(CUT_VERSION, repr(shape))
    stored = cache.get(key) if cache is not None else None
    if stored is not None and (found := _unpack(stored)) is not None:
        return found
    parts: list[tuple[Array, Faces]]
    if isinstance(shape, shapes.PrismShape):
        from simfoundry.assets.solids import checked_outline, convex_outlines, prism_mesh

        outline, error = checked_outline(np.array(shape.prism.outline)), 0.0
        parts = [prism_mesh(p, shape.prism.height) for p in convex_outlines(outline)]
    else:
        from simfoundry.assets.convex import hull
        from simfoundry.assets.solids import checked_profile, lathe_error, lathe_parts

        outline = checked_profile(np.array(shape.lathe.profile))
        parts = [hull(points) for points in lathe_parts(outline)]
        error = lathe_error(outline, parts)
    if cache is not None:
        cache.put(key, _pack(outline, parts, error))
    return outline, tuple(closed_mesh(*part) for part in parts), error


def _pack(outline: Array, parts: list[tuple[Array, Faces]], error: float) -> bytes:
    stream = io.BytesIO()
    counts = np.array([[len(corners), len(faces)] for corners, faces in parts])
    corners, faces = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    np.savez(stream, allow_pickle=False, outline=outline, corners=corners, faces=faces, counts=counts, error=error)
    return stream.getvalue()


def _unpack(data: bytes) -> _Cut | None:
    """Deserialize a cache entry, or return None if the entry is corrupt and must be recomputed."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            ends = np.cumsum(arrays["counts"], axis=0)[:-1]
            corners, faces = (np.split(arrays[name], ends[:, k]) for k, name in enumerate(("corners", "faces")))
            parts: tuple[Mesh, ...] = tuple(map(closed_mesh, corners, faces))
            return arrays["outline"], parts, float(arrays["error"])
    except Exception:  # a corrupt archive raises OSError, KeyError, ValueError, or errors from zipfile and zlib
        return None
