"""Convert the gprims in a USD stage, including their scales and materials, to parts of links."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from simfoundry.assets.errors import MeshError
from simfoundry.assets.mesh import MeshPart, srgb_of_linear, texture_png
from simfoundry.frontends.draft import Contact, MeshDraft, ModelDraft, PartDraft, TextureDraft
from simfoundry.frontends.meshes import mesh_of_parts
from simfoundry.frontends.names import plain_name
from simfoundry.frontends.shapes import PrimitiveShape, Rgba, clamped_rgba, primitive
from simfoundry.geometry.frames import IDENTITY, Array, Pose, quat_from_matrix

# Relative tolerance for equal scales, which stages store in single precision.
EVEN_SCALE = 1e-6

# Maximum dot product of orthogonal unit axes; allows for single precision after a few transforms.
ORTHOGONAL = 1e-5

# Names of texture coordinates in files from OpenUSD, Blender, and older exporters.
COORDINATES = ("st", "UVMap", "st0", "uv")

# Rotations that map the z axis to each axis.
AXES = {
    "X": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
    "Y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "Z": np.eye(3),
}


class UsdGprims:
    """A converter from the gprims in a stage to parts.

    ``to_m`` [m] and ``to_kg`` [kg] are the stage's units of length and mass.
    """

    def __init__(self, pxr: Any, draft: ModelDraft, to_kg: float, to_m: float) -> None:
        self.pxr, self.draft, self.to_kg, self.to_m = pxr, draft, to_kg, to_m

    def part(self, prim: Any, X_LG: Array) -> PartDraft | None:
        """Convert a gprim to a part, or return None if it is unsupported.

        ``X_LG``, shape (4, 4), is the transform from the gprim's frame and units to the link frame, including scale.
        """
        if (found := self.geometry(prim, X_LG)) is None:
            return None
        geometry, X_LP = found
        part = PartDraft(prim.GetName(), geometry, self.use(prim), X_LP, contact=self.surface(prim)[0])
        if not isinstance(geometry, MeshDraft) and part.use != "collision":
            part.color, png = self.look(prim)
            if png is not None:
                part.texture = TextureDraft(prim.GetName(), png)
                why = "the image is projected along the nearest axis of the shape"
                self.draft.changed(f"texture of `{prim.GetPath()}`", why)
        return part

    def use(self, prim: Any) -> str:
        """Return the use of a gprim: `both`, `visual`, `collision`, or `none`.

        Guides and invisible prims are not visual.
        """
        geom = self.pxr.UsdGeom.Imageable(prim)
        visible = geom.ComputePurpose() in ("default", "render") and geom.ComputeVisibility() != "invisible"
        if is_collider(self.pxr, prim):
            return "both" if visible else "collision"
        return "visual" if visible else "none"

    def geometry(self, prim: Any, X_LG: Array) -> tuple[PrimitiveShape | MeshDraft, Pose] | None:
        """Return the geometry of a gprim and its pose in the link frame.

        A primitive with an unsupported scale is converted to a mesh.
        """
        kind, scales = prim.GetTypeName(), np.linalg.norm(X_LG[:3, :3], axis=0)
        if not np.isfinite(X_LG).all() or scales.min() <= 0:
            self.draft.dropped(f"{kind} `{prim.GetPath()}`", "the scale is zero or not finite")
            return None
        R_LG = X_LG[:3, :3] / scales
        is_orthogonal = bool(np.abs(R_LG.T @ R_LG - np.eye(3)).max() < ORTHOGONAL)
        if is_orthogonal and np.linalg.det(R_LG) < 0:
            R_LG = R_LG @ _mirror(prim)
        found = self.primitive(prim, kind, scales) if is_orthogonal else None
        if found is not None:
            shape, X_GS = found
            return shape, _pose(R_LG, X_LG[:3, 3]) @ X_GS
        mesh = self.mesh(prim) if kind == "Mesh" else self.tessellated(prim, kind)
        return None if mesh is None else self.baked(prim, mesh, X_LG, R_LG if is_orthogonal else None)

    def primitive(self, prim: Any, kind: str, scales: Array) -> tuple[PrimitiveShape, Pose] | None:
        """Return a scaled gprim as a primitive with its pose in the gprim's frame, or None if no primitive fits."""
        match kind:
            case "Cube":
                return primitive("box", *(prim.GetAttribute("size").Get() * scales).tolist()), IDENTITY
            case "Sphere" if _is_even(scales):
                return primitive("sphere", prim.GetAttribute("radius").Get() * float(scales[0])), IDENTITY
            case "Sphere":
                return primitive("ellipsoid", *(prim.GetAttribute("radius").Get() * scales).tolist()), IDENTITY
            case "Cylinder" | "Capsule" | "Cone":
                axis = prim.GetAttribute("axis").Get()
                along = "XYZ".index(axis)
                across = np.delete(scales, along)
                if not _is_even(scales if kind == "Capsule" else across):
                    return None
                sizes = zip(("radius", "height"), (across[0], scales[along]), strict=True)
                size = (prim.GetAttribute(name).Get() * float(scale) for name, scale in sizes)
                return primitive(kind.lower(), *size), _pose(AXES[axis])
            case "Plane":
                box, X_AB = self.draft.plane(f"plane `{prim.GetPath()}`")
                return box, _pose(AXES[prim.GetAttribute("axis").Get()]) @ X_AB
        return None

    def baked(self, prim: Any, mesh: MeshPart, X_LG: Array, R_LG: Array | None) -> tuple[MeshDraft, Pose]:
        """Return a mesh with the scale baked into its vertices, along with the remaining pose."""
        pose = Pose.of() if R_LG is None else _pose(R_LG, X_LG[:3, 3])
        bake = np.linalg.inv(pose.matrix) @ X_LG
        vertices = np.round(mesh.vertices @ bake[:3, :3].T + bake[:3, 3], 9)
        faces = mesh.faces if np.linalg.det(bake[:3, :3]) > 0 else np.ascontiguousarray(mesh.faces[:, ::-1])
        rgba, texture = self.look(prim)
        textured = texture is not None and mesh.uv is not None
        part = MeshPart(vertices, faces, mesh.uv, texture) if textured else MeshPart(vertices, faces, rgba=rgba)
        return mesh_of_parts([part], plain_name(prim.GetName(), "mesh")), pose

    def mesh(self, prim: Any) -> MeshPart | None:
        """Return the triangles of a mesh in the gprim's units.

        Polygons are triangulated as fans.
        """
        mesh = self.pxr.UsdGeom.Mesh(prim)
        points = np.array(mesh.GetPointsAttr().Get() or [], dtype=np.float64).reshape(-1, 3)
        counts = np.array(mesh.GetFaceVertexCountsAttr().Get() or [], dtype=np.int64)
        indices = np.array(mesh.GetFaceVertexIndicesAttr().Get() or [], dtype=np.int64)
        is_sound = len(points) and len(counts) and counts.sum() == len(indices) and counts.min() >= 0
        if not is_sound or indices.min() < 0 or indices.max() >= len(points):
            self.draft.dropped(f"Mesh `{prim.GetPath()}`", "the mesh has no valid faces")
            return None
        corners = _fans(counts)
        faces = indices[corners]
        if mesh.GetOrientationAttr().Get() == "leftHanded":
            corners, faces = corners[:, ::-1], faces[:, ::-1]
        if (uv := self.coordinates(prim, corners, faces)) is None:
            return MeshPart(points, np.ascontiguousarray(faces, dtype=np.int32))
        return MeshPart(points[faces.reshape(-1)], np.arange(faces.size, dtype=np.int32).reshape(-1, 3), uv)

    def coordinates(self, prim: Any, corners: Any, faces: Any) -> Array | None:
        """Return the texture coordinates of each face corner as an array of shape (3 m, 2), with v pointing up."""
        found = (self.pxr.UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(name) for name in COORDINATES)
        primvar = next((v for v in found if v and v.HasValue()), None)
        if primvar is None or primvar.GetInterpolation() == "constant":
            return None
        values = np.array(primvar.ComputeFlattened(), dtype=np.float64).reshape(-1, 2)
        chosen = corners if primvar.GetInterpolation() == "faceVarying" else faces
        return values[chosen.reshape(-1)] if len(values) > int(chosen.max()) else None

    def tessellated(self, prim: Any, kind: str) -> MeshPart | None:
        """Return a mesh for a primitive whose type or scale is not supported in documents."""
        import trimesh

        def value(name: str) -> float:
            return float(prim.GetAttribute(name).Get())

        match kind:
            case "Sphere":  # sheared
                made = trimesh.creation.icosphere(subdivisions=3, radius=value("radius"))
            case "Cylinder" | "Capsule" | "Cone":
                make = getattr(trimesh.creation, kind.lower())
                made = make(radius=value("radius"), height=value("height"))
                if kind == "Cone":
                    made.apply_translation([0, 0, -value("height") / 2])
                made.apply_transform(_pose(AXES[prim.GetAttribute("axis").Get()]).matrix)
            case "Cube":
                made = trimesh.creation.box(extents=[value("size")] * 3)
            case _:
                self.draft.dropped(f"{kind} `{prim.GetPath()}`", "the scene language does not support this shape")
                return None
        self.draft.changed(f"{kind} `{prim.GetPath()}`", f"the shape is represented by {len(made.faces)} triangles")
        return MeshPart(np.asarray(made.vertices, dtype=np.float64), np.asarray(made.faces, dtype=np.int32))

    def surface(self, prim: Any) -> tuple[Contact, float | None]:
        """Return the contact parameters and density [kg/m^3] from the physics material bound to a gprim."""
        physics, shade = self.pxr.UsdPhysics, self.pxr.UsdShade
        material, _ = shade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
        target = material.GetPrim() if material else None
        if not target or not target.HasAPI(physics.MaterialAPI):
            return {}, None
        names = ("staticFriction", "dynamicFriction", "restitution", "density")
        attributes = (target.GetAttribute(f"physics:{name}") for name in names)
        static, dynamic, restitution, density = (float(a.Get()) if a.HasAuthoredValue() else None for a in attributes)
        if static is not None and dynamic is not None and abs(static - dynamic) > EVEN_SCALE:
            self.draft.changed(f"material `{target.GetPath()}`", "only the dynamic friction is used")
        given = {"friction": static if dynamic is None else dynamic, "restitution": restitution}
        contact = {key: value for key, value in given.items() if value is not None}
        return contact, density * self.to_kg / self.to_m**3 if density else None

    def look(self, prim: Any) -> tuple[Rgba | None, bytes | None]:
        """Return the color of a gprim and its texture as PNG, either of which may be None."""
        material, _ = self.pxr.UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
        shader = material.ComputeSurfaceSource()[0] if material else None
        if shader and shader.GetIdAttr().Get() == "UsdPreviewSurface":
            return self.preview(shader)
        shown = self.pxr.UsdGeom.Gprim(prim).GetDisplayColorPrimvar()
        colors = shown.Get() if shown and shown.HasValue() else None
        if colors is None or len(colors) != 1:
            return None, None
        opacity = self.pxr.UsdGeom.Gprim(prim).GetDisplayOpacityPrimvar().Get()
        return _rgba(colors[0], float(opacity[0]) if opacity else 1.0), None

    def preview(self, shader: Any) -> tuple[Rgba | None, bytes | None]:
        """Return the color of a UsdPreviewSurface and its texture as PNG, either of which may be None."""
        diffuse, opacity = shader.GetInput("diffuseColor"), shader.GetInput("opacity")
        if not diffuse:
            return None, None
        sources = diffuse.GetConnectedSources()[0]
        if sources:
            node = self.pxr.UsdShade.Shader(sources[0].source.GetPrim())
            file = node.GetInput("file").Get() if node and node.GetInput("file") else None
            png = _png(file.resolvedPath) if file is not None and file.resolvedPath else None
            if png is None:
                self.draft.dropped(f"texture of `{shader.GetPath()}`", "the image could not be found")
            return None, png
        color = diffuse.Get()
        alpha = float(opacity.Get()) if opacity and isinstance(opacity.Get(), float) else 1.0
        return (None if color is None else _rgba(color, alpha)), None


def is_collider(pxr: Any, prim: Any) -> bool:
    """Return True if a gprim is collision geometry."""
    api = pxr.UsdPhysics.CollisionAPI
    return prim.HasAPI(api) and api(prim).GetCollisionEnabledAttr().Get() is not False


def _pose(rotation: Array, p: Array | tuple[float, ...] = (0.0, 0.0, 0.0)) -> Pose:
    return Pose.of(p, quat_from_matrix(rotation))


def _mirror(prim: Any) -> Array:
    """Return a reflection that maps a primitive to itself; a cone is symmetric only across its axis."""
    axis = prim.GetAttribute("axis").Get() if prim.GetTypeName() == "Cone" else "X"
    signs = np.ones(3)
    signs["XYZ".index(axis) - 1] = -1.0
    return np.diag(signs)


def _is_even(scales: Array) -> bool:
    return bool(np.ptp(scales) <= EVEN_SCALE * scales.max())


def _fans(counts: Any) -> Any:
    """Triangulate faces as fans.

    Returns:
        Three indices into the list of face corners for each triangle, shape (m, 3).
    """
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    per_face = np.maximum(counts - 2, 0)
    face = np.repeat(np.arange(len(counts)), per_face)
    k = np.arange(per_face.sum()) - np.repeat(np.cumsum(per_face) - per_face, per_face)
    return np.column_stack([starts[face], starts[face] + k + 1, starts[face] + k + 2])


def _rgba(linear: Sequence[float], alpha: float) -> Rgba:
    """Convert a linear USD color to sRGB and add an alpha value."""
    return clamped_rgba((*(srgb_of_linear(min(max(float(v), 0.0), 1.0)) for v in linear), alpha))


def _png(path: str) -> bytes | None:
    from PIL import Image

    try:
        with Image.open(path) as picture:
            return texture_png(path, picture)
    except (OSError, MeshError):
        return None
