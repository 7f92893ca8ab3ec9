"""Gprims of a USD stage as parts of links: shapes with their scales, meshes, looks and physics materials."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Any

import numpy as np

from simfoundry.assets.mesh import MeshPart
from simfoundry.frontends.draft import Draft, MeshDraft, PartDraft, PrimitiveShape, Rgba
from simfoundry.frontends.meshes import mesh_of_parts
from simfoundry.frontends.names import plain_name
from simfoundry.geometry.frames import Array, Pose
from simfoundry.spec.models.base import BoxShape, CapsuleShape, CylinderShape, Round, SphereShape

ALIKE = 1e-6
"""Share by which scales may differ and still be one."""

GROUND = (20.0, 20.0, 0.1)
"""Size [m] of the box that stands for a plane; its top is the plane."""

TURNED = {
    "X": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
    "Y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "Z": np.eye(3),
}
"""Rotations that take z to an axis."""


@dataclass(frozen=True)
class Surface:
    """What a physics material says; None where it says nothing."""

    friction: float | None = None
    restitution: float | None = None
    density: float | None = None


class Geoms:
    """Turns gprims of a stage into parts."""

    def __init__(self, pxr: Any, draft: Draft, to_kg: float, to_m: float) -> None:
        self.pxr, self.draft, self.to_kg, self.to_m = pxr, draft, to_kg, to_m

    def part(self, prim: Any, X_LG: Array) -> PartDraft | None:
        """The part that a gprim is; ``X_LG`` (4, 4) takes its own units and frame into the link's, scale included."""
        made = self.geometry(prim, X_LG)
        if made is None:
            return None
        geometry, X_LP = made
        part = PartDraft(prim.GetName(), geometry, self.use(prim), X_LP)
        surface = self.surface(prim)
        part.friction, part.restitution = surface.friction, surface.restitution
        if not isinstance(geometry, MeshDraft) and part.use != "collision":
            part.color, _ = self.look(prim)
        return part

    def use(self, prim: Any) -> str:
        """What a gprim is for: colliders touch; guides and what is invisible are not seen."""
        geom = self.pxr.UsdGeom.Imageable(prim)
        seen = geom.ComputePurpose() in ("default", "render") and geom.ComputeVisibility() != "invisible"
        touches = is_collider(self.pxr, prim)
        if touches:
            return "both" if seen else "collision"
        return "visual" if seen else "none"

    def geometry(self, prim: Any, X_LG: Array) -> tuple[PrimitiveShape | MeshDraft, Pose] | None:
        """The geometry of a gprim and its pose; a scale that no primitive can have makes a mesh of it."""
        usd, kind = self.pxr.UsdGeom, prim.GetTypeName()
        scales = np.linalg.norm(X_LG[:3, :3], axis=0)
        if not np.isfinite(X_LG).all() or scales.min() <= 0:
            self.draft.dropped(f"{kind} `{prim.GetPath()}`", "it is scaled to nothing")
            return None
        R_LG = X_LG[:3, :3] / scales
        straight = bool(np.abs(R_LG.T @ R_LG - np.eye(3)).max() < 1e-5)
        proper = straight and float(np.linalg.det(R_LG)) > 0
        if straight and not proper:  # every primitive is its own mirror image
            R_LG = R_LG @ np.diag([1.0, 1.0, -1.0])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = R_LG, X_LG[:3, 3]

        def value(schema: Any, name: str) -> float:
            return float(getattr(schema, f"Get{name}Attr")().Get())

        if kind == "Cube" and straight:
            size = value(usd.Cube(prim), "Size") * scales
            return BoxShape(box=(float(size[0]), float(size[1]), float(size[2]))), Pose.from_matrix(pose)
        if kind == "Sphere" and straight and _same(*scales):
            return SphereShape(sphere=value(usd.Sphere(prim), "Radius") * float(scales[0])), Pose.from_matrix(pose)
        if kind in ("Cylinder", "Capsule") and straight:
            schema = getattr(usd, kind)(prim)
            axis = schema.GetAxisAttr().Get()
            along = "XYZ".index(axis)
            across = [float(s) for k, s in enumerate(scales) if k != along]
            even = _same(*across) and (kind == "Cylinder" or _same(*scales))
            if even:
                pose[:3, :3] = R_LG @ TURNED[axis]
                radius, height = value(schema, "Radius") * across[0], value(schema, "Height") * float(scales[along])
                size_ = Round(radius=radius, height=height)
                shape = CylinderShape(cylinder=size_) if kind == "Cylinder" else CapsuleShape(capsule=size_)
                return shape, Pose.from_matrix(pose)
        if kind == "Plane" and straight:
            axis = usd.Plane(prim).GetAxisAttr().Get()
            pose[:3, :3] = R_LG @ TURNED[axis]
            self.draft.changed(f"plane `{prim.GetPath()}`", f"a box of {GROUND[0]:g} x {GROUND[1]:g} m stands for it")
            return BoxShape(box=GROUND), Pose.from_matrix(pose) @ Pose.of([0, 0, -GROUND[2] / 2])
        mesh = self.mesh(prim) if kind == "Mesh" else self.tessellated(prim, kind)
        if mesh is None:
            return None
        return self.placed(prim, mesh, X_LG, R_LG if straight else None, scales)

    def placed(
        self, prim: Any, mesh: MeshPart, X_LG: Array, R_LG: Array | None, scales: Array
    ) -> tuple[MeshDraft, Pose]:
        """A mesh with its scale baked in, posed by what remains."""
        pose = np.eye(4)
        if R_LG is not None:
            pose[:3, :3], pose[:3, 3] = R_LG, X_LG[:3, 3]
        bake = np.linalg.inv(pose) @ X_LG
        vertices = mesh.vertices @ bake[:3, :3].T + bake[:3, 3]
        faces = mesh.faces if np.linalg.det(bake[:3, :3]) > 0 else np.ascontiguousarray(mesh.faces[:, ::-1])
        rgba, texture = self.look(prim)
        uv = mesh.uv if texture is not None else None
        part = MeshPart(
            np.round(vertices, 9), faces, uv, texture if uv is not None else None, rgba if uv is None else None
        )
        return mesh_of_parts([part], plain_name(prim.GetName(), "mesh")), Pose.from_matrix(pose)

    def mesh(self, prim: Any) -> MeshPart | None:
        """The triangles of a mesh in its own units; polygons are cut into fans."""
        mesh = self.pxr.UsdGeom.Mesh(prim)
        points = np.array(mesh.GetPointsAttr().Get() or [], dtype=np.float64).reshape(-1, 3)
        counts = np.array(mesh.GetFaceVertexCountsAttr().Get() or [], dtype=np.int64)
        indices = np.array(mesh.GetFaceVertexIndicesAttr().Get() or [], dtype=np.int64)
        sound = len(points) and len(counts) and counts.sum() == len(indices) and counts.min() >= 0
        if not sound or indices.min() < 0 or indices.max() >= len(points):
            self.draft.dropped(f"Mesh `{prim.GetPath()}`", "it has no usable faces")
            return None
        corners = _fans(counts)
        faces = indices[corners]
        if mesh.GetOrientationAttr().Get() == "leftHanded":
            corners, faces = corners[:, ::-1], faces[:, ::-1]
        uv = self.coordinates(prim, corners, faces, len(points))
        if uv is None:
            return MeshPart(points, np.ascontiguousarray(faces, dtype=np.int32))
        return MeshPart(points[faces.reshape(-1)], np.arange(faces.size, dtype=np.int32).reshape(-1, 3), uv)

    def coordinates(self, prim: Any, corners: Any, faces: Any, points: int) -> Array | None:
        """Texture coordinates of each corner, shape (3 m, 2), v up."""
        api = self.pxr.UsdGeom.PrimvarsAPI(prim)
        primvar = next(
            (v for n in ("st", "UVMap", "st0", "uv") if (v := api.FindPrimvarWithInheritance(n)) and v.HasValue()), None
        )
        if primvar is None:
            return None
        values = np.array(primvar.ComputeFlattened(), dtype=np.float64).reshape(-1, 2)
        chosen = corners if primvar.GetInterpolation() == "faceVarying" else faces
        enough = len(values) > int(chosen.max())
        return values[chosen.reshape(-1)] if enough and primvar.GetInterpolation() != "constant" else None

    def tessellated(self, prim: Any, kind: str) -> MeshPart | None:
        """A mesh for a primitive that the language does not have, or that is scaled unevenly."""
        import trimesh

        usd = self.pxr.UsdGeom
        match kind:
            case "Sphere":
                made = trimesh.creation.icosphere(subdivisions=3, radius=float(usd.Sphere(prim).GetRadiusAttr().Get()))
            case "Cylinder" | "Capsule" | "Cone":
                schema = getattr(usd, kind)(prim)
                radius, height = float(schema.GetRadiusAttr().Get()), float(schema.GetHeightAttr().Get())
                make = {
                    "Cylinder": trimesh.creation.cylinder,
                    "Capsule": trimesh.creation.capsule,
                    "Cone": trimesh.creation.cone,
                }
                made = make[kind](radius=radius, height=height)
                if kind == "Cone":
                    made.apply_translation([0, 0, -height / 2])
                turn = np.eye(4)
                turn[:3, :3] = TURNED[schema.GetAxisAttr().Get()]
                made.apply_transform(turn)
            case "Cube":
                made = trimesh.creation.box(extents=[float(usd.Cube(prim).GetSizeAttr().Get())] * 3)
            case _:
                self.draft.dropped(f"{kind} `{prim.GetPath()}`", "the language has no such shape")
                return None
        self.draft.changed(f"{kind} `{prim.GetPath()}`", f"a mesh of {len(made.faces)} triangles stands for it")
        return MeshPart(np.asarray(made.vertices, dtype=np.float64), np.asarray(made.faces, dtype=np.int32))

    def surface(self, prim: Any) -> Surface:
        """The physics material that is bound to a gprim."""
        physics, shade = self.pxr.UsdPhysics, self.pxr.UsdShade
        material, _ = shade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
        target = material.GetPrim() if material else None
        if not target or not target.HasAPI(physics.MaterialAPI):
            return Surface()
        api = physics.MaterialAPI(target)

        def said(attribute: Any) -> float | None:
            return float(attribute.Get()) if attribute.HasAuthoredValue() else None

        static, dynamic = said(api.GetStaticFrictionAttr()), said(api.GetDynamicFrictionAttr())
        if static is not None and dynamic is not None and abs(static - dynamic) > 1e-6:
            self.draft.changed(f"material `{target.GetPath()}`", "it has one friction here, the dynamic one")
        density = said(api.GetDensityAttr())
        return Surface(
            dynamic if dynamic is not None else static,
            said(api.GetRestitutionAttr()),
            density * self.to_kg / self.to_m**3 if density else None,
        )

    def look(self, prim: Any) -> tuple[Rgba | None, bytes | None]:
        """The colour of a gprim, and the PNG of its texture."""
        shade = self.pxr.UsdShade
        material, _ = shade.MaterialBindingAPI(prim).ComputeBoundMaterial()
        shader = material.ComputeSurfaceSource()[0] if material else None
        if shader and shader.GetIdAttr().Get() == "UsdPreviewSurface":
            return self.preview(shader)
        shown = self.pxr.UsdGeom.Gprim(prim).GetDisplayColorPrimvar()
        colors = shown.Get() if shown and shown.HasValue() else None
        if colors is None or len(colors) != 1:
            return None, None
        opacity = self.pxr.UsdGeom.Gprim(prim).GetDisplayOpacityPrimvar().Get()
        return _srgb([float(v) for v in colors[0]], float(opacity[0]) if opacity else 1.0), None

    def preview(self, shader: Any) -> tuple[Rgba | None, bytes | None]:
        """Colour and texture of a UsdPreviewSurface."""
        diffuse, opacity = shader.GetInput("diffuseColor"), shader.GetInput("opacity")
        alpha = float(opacity.Get()) if opacity and isinstance(opacity.Get(), float) else 1.0
        if not diffuse:
            return None, None
        sources = diffuse.GetConnectedSources()[0]
        if sources:
            node = self.pxr.UsdShade.Shader(sources[0].source.GetPrim())
            file = node.GetInput("file").Get() if node and node.GetInput("file") else None
            png = _png(file.resolvedPath) if file is not None and file.resolvedPath else None
            if png is None:
                self.draft.dropped(f"texture of `{shader.GetPath()}`", "its picture is not found")
            return None, png
        color = diffuse.Get()
        return (None if color is None else _srgb([float(v) for v in color], alpha)), None


def is_collider(pxr: Any, prim: Any) -> bool:
    """Whether a gprim touches."""
    if not prim.HasAPI(pxr.UsdPhysics.CollisionAPI):
        return False
    return pxr.UsdPhysics.CollisionAPI(prim).GetCollisionEnabledAttr().Get() is not False


def _same(*scales: float) -> bool:
    return max(scales) - min(scales) <= ALIKE * max(scales)


def _fans(counts: Any) -> Any:
    """Positions in the list of corners, three for each triangle, shape (m, 3)."""
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    per_face = np.maximum(counts - 2, 0)
    face = np.repeat(np.arange(len(counts)), per_face)
    k = np.arange(per_face.sum()) - np.repeat(np.cumsum(per_face) - per_face, per_face)
    return np.column_stack([starts[face], starts[face] + k + 1, starts[face] + k + 2])


def _srgb(linear: list[float], alpha: float) -> Rgba:
    """USD colours are linear, ours sRGB (IEC 61966-2-1)."""
    r, g, b = (
        12.92 * v if v <= 0.0031308 else 1.055 * v ** (1 / 2.4) - 0.055 for v in (min(max(v, 0.0), 1.0) for v in linear)
    )
    return r, g, b, min(max(alpha, 0.0), 1.0)


def _png(path: str) -> bytes | None:
    from PIL import Image

    stream = io.BytesIO()
    try:
        with Image.open(path) as picture:
            picture.convert("RGBA" if picture.mode in ("RGBA", "LA", "P") else "RGB").save(stream, format="PNG")
    except OSError:
        return None
    return stream.getvalue()
