"""Convert the geoms in a compiled MuJoCo model to parts of links."""

from __future__ import annotations

import io
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.assets.errors import MeshError
from simfoundry.assets.mesh import MeshPart, read_parts
from simfoundry.frontends.draft import BodyDraft, JointDraft, MeshDraft, ModelDraft, PartDraft, TextureDraft
from simfoundry.frontends.meshes import mesh_of_parts
from simfoundry.frontends.names import plain_name
from simfoundry.frontends.shapes import PrimitiveShape, Rgba, clamped_rgba, primitive
from simfoundry.geometry.frames import Array, Pose


@dataclass(eq=False)
class MjcfSource:
    """A MuJoCo model to convert, with its data at the first keyframe, and the resulting draft.

    ``is_own`` is True for files that SimFoundry compiled. ``owners`` maps each body to its body draft, its link, and
    the pose of the link frame in the body frame. ``joints`` maps each joint to its body draft and its joint draft.
    ``mimics`` contains the equalities that became mimic joints.
    """

    mujoco: Any
    model: Any
    data: Any
    draft: ModelDraft
    is_own: bool
    owners: dict[int, tuple[BodyDraft, str, Pose]] = field(default_factory=dict)
    joints: dict[int, tuple[BodyDraft, JointDraft]] = field(default_factory=dict)
    mimics: set[int] = field(default_factory=set)

    def name(self, kind: str, number: int) -> str:
        """Return the name of an element, or an empty string if it is unnamed.

        ``kind`` is a MuJoCo object type such as `body`.
        """
        return self.mujoco.mj_id2name(self.model, getattr(self.mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), number) or ""

    def label(self, kind: str, number: int) -> str:
        """Return the name of an element for use in messages, or its number if it is unnamed."""
        name = self.name(kind, number)
        return f"`{name}`" if name else f"number {number + 1}"

    def is_drive(self, actuator: int) -> bool:
        """Return True if an actuator of a compiled file is the drive of a joint, which has the same name."""
        return self.is_own and self.name("actuator", actuator) == self.name(
            "joint", int(self.model.actuator_trnid[actuator, 0])
        )


# First geom group that MuJoCo's viewers hide by default; geoms in this group or above are for contact only.
HIDDEN_GROUP = 3

# Default color of a geom in MuJoCo.
UNSET = (0.5, 0.5, 0.5, 1.0)


# Relative distance of vertices that are the same, except for rounding to single precision in two frames.
SAME_VERTEX = 1e-6


def height_field_extents(model: Any, field: int) -> tuple[float, float, float, float]:
    """Return the width, the depth, the height of the highest point and the depth of the base of a height field [m]."""
    x, y, height, base = model.hfield_size[field].tolist()
    start, count = int(model.hfield_adr[field]), int(model.hfield_nrow[field] * model.hfield_ncol[field])
    return 2 * x, 2 * y, height * float(model.hfield_data[start : start + count].max(initial=0.0)), base


class MjcfGeoms:
    """A converter from geoms to parts. Meshes shared by several geoms are written only once."""

    def __init__(self, source: MjcfSource) -> None:
        self.source, self.mujoco, self.model, self.draft = source, source.mujoco, source.model, source.draft
        self.meshes: dict[tuple[int, int], MeshDraft] = {}

    def part(self, geom: int) -> PartDraft | None:
        """Return a geom as a part with its pose in the body.

        Unsupported geoms are recorded, and None is returned for them.
        """
        model, types = self.model, self.mujoco.mjtGeom
        name = self.source.name("geom", geom)
        kind = types(model.geom_type[geom])
        kind_name = kind.name.removeprefix("mjGEOM_").lower()
        X_BG = Pose.of(model.geom_pos[geom], model.geom_quat[geom])
        geometry: PrimitiveShape | MeshDraft
        a, b, c = (float(v) for v in model.geom_size[geom])
        match kind:
            case types.mjGEOM_BOX:
                geometry = primitive("box", 2 * a, 2 * b, 2 * c)
            case types.mjGEOM_SPHERE:
                geometry = primitive("sphere", a)
            case types.mjGEOM_CYLINDER | types.mjGEOM_CAPSULE:
                geometry = primitive(kind_name, a, 2 * b)
            case types.mjGEOM_ELLIPSOID:
                geometry = primitive("ellipsoid", a, b, c)
            case types.mjGEOM_PLANE:
                geometry, X_GB = self.draft.plane(f"plane `{name or geom}`", 2 * a, 2 * b)
                X_BG = X_BG @ X_GB
            case types.mjGEOM_MESH | types.mjGEOM_SDF:
                geometry, X_BG = self.mesh(geom, X_BG)
            case types.mjGEOM_HFIELD if not self.source.is_own:
                geometry, X_GB = self.height_field(geom, name)
                X_BG = X_BG @ X_GB
            case _:
                why = f"the scene language does not support the geom type {kind_name}"
                self.draft.dropped(f"geom `{name or geom}`", why)
                return None
        use = self.use(geom)
        return self.with_contact(geom, PartDraft(name or {"both": "geom"}.get(use, use), geometry, use, X_BG))

    def use(self, geom: int) -> str:
        """Return the use of a geom.

        The use is `visual` if the geom never collides, `collision` if viewers hide it, and `both` otherwise.
        """
        if not self.model.geom_contype[geom] and not self.model.geom_conaffinity[geom]:
            return "visual"
        return "collision" if int(self.model.geom_group[geom]) >= HIDDEN_GROUP or self.rgba(geom)[3] == 0 else "both"

    def with_contact(self, geom: int, part: PartDraft) -> PartDraft:
        """Add the contact parameters and the color of a geom to its part, and return the part."""
        model = self.model
        if part.collides:
            sliding, spinning, rolling = model.geom_friction[geom].tolist()
            dimensions = int(model.geom_condim[geom])
            part.contact["friction"] = sliding if dimensions > 1 else 0.0
            if self.source.is_own and model.nuser_geom:
                part.contact["restitution"] = float(model.geom_user[geom, 0])
            if dimensions >= 4:
                part.contact["torsional_friction"] = spinning
            if dimensions >= 6:
                part.contact["rolling_friction"] = rolling
        if not isinstance(part.geometry, MeshDraft):
            part.texture = self.texture_draft(geom, part)
        color = self.rgba(geom)
        if color != UNSET and part.use != "collision":
            part.color = color
        return part

    def texture_draft(self, geom: int, part: PartDraft) -> TextureDraft | None:
        """Return the image of a primitive, or None if there is none."""
        material = int(self.model.geom_matid[geom])
        if (texture := self.texture(material)) < 0 or part.use == "collision":
            return None
        repeat = float(self.model.mat_texrepeat[material][0])
        across = 1.0 if self.model.mat_texuniform[material] else 2 * float(max(self.model.geom_size[geom]))
        why = "the image is projected along the nearest axis of the shape"
        self.draft.changed(f"texture of geom `{part.name}`", why)
        name = self.source.name("texture", texture) or f"texture_{texture}"
        return TextureDraft(name, self.png(texture), across / repeat if repeat > 0 and across > 0 else None)

    def rgba(self, geom: int) -> Rgba:
        """Return the color of a geom, which may come from its material."""
        rgba, material = tuple(self.model.geom_rgba[geom].tolist()), int(self.model.geom_matid[geom])
        return clamped_rgba(self.model.mat_rgba[material] if rgba == UNSET and material >= 0 else rgba)

    def texture(self, material: int) -> int:
        """Return the id of a material's color texture, or -1 if there is no texture that can be applied to a mesh."""
        if material < 0:
            return -1
        roles = np.ravel(self.model.mat_texid[material])
        role = int(self.mujoco.mjtTextureRole.mjTEXROLE_RGB)
        texture = int(roles[role]) if len(roles) > role else int(roles[0])
        flat = texture >= 0 and self.model.tex_type[texture] == self.mujoco.mjtTexture.mjTEXTURE_2D
        return texture if flat else -1

    def mesh(self, geom: int, X_BG: Pose) -> tuple[MeshDraft, Pose]:
        """Return the mesh of a geom in the frame of its file, and the pose of that frame in the body."""
        model, mesh = self.model, int(self.model.geom_dataid[geom])
        X_FM = Pose.of(model.mesh_pos[mesh], model.mesh_quat[mesh])
        texture = self.texture(int(model.geom_matid[geom]))
        if (mesh, texture) not in self.meshes:
            name = self.source.name("mesh", mesh) or f"mesh_{mesh}"
            self.meshes[mesh, texture] = mesh_of_parts([self.mesh_part(mesh, texture, X_FM)], plain_name(name, "mesh"))
        return self.meshes[mesh, texture], X_BG @ X_FM.inverse()

    def baked(self, geom: int) -> MeshPart:
        """Return the mesh of a geom in the body frame, including its color and texture."""
        model, mesh = self.model, int(self.model.geom_dataid[geom])
        texture = self.texture(int(model.geom_matid[geom]))
        part = self.mesh_part(mesh, texture, Pose.of(model.geom_pos[geom], model.geom_quat[geom]))
        return replace(part, rgba=self.rgba(geom))

    def mesh_part(self, mesh: int, texture: int, X_FM: Pose) -> MeshPart:
        """Return a mesh expressed in frame F, given the pose ``X_FM`` of MuJoCo's mesh frame in F."""
        model = self.model
        start, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        vertices = X_FM.apply(np.array(model.mesh_vert[start : start + count], dtype=np.float64))
        first, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
        corners = np.array(model.mesh_face[first : first + faces])
        uv, png = None, None
        if texture >= 0 and int(model.mesh_texcoordnum[mesh]):
            at = int(model.mesh_texcoordadr[mesh])
            chosen = np.array(model.mesh_facetexcoord[first : first + faces]).reshape(-1)
            uv = np.array(model.mesh_texcoord[at + chosen], dtype=np.float64) * (1, -1) + (0, 1)
            vertices, corners = vertices[corners.reshape(-1)], np.arange(3 * faces).reshape(-1, 3)
            png = self.png(texture)
        # Rounding to MuJoCo's single precision removes the noise that the rotation introduced.
        vertices = self.as_in_file(mesh, vertices.astype(np.float32).astype(np.float64))
        return MeshPart(vertices, corners.astype(np.int32), uv, png)

    def as_in_file(self, mesh: int, vertices: Array) -> Array:
        """Return vertices to the last bit as in the mesh file, or rounded if they are not from there."""
        from scipy.spatial import cKDTree

        rounded = np.asarray(np.round(vertices, 9))
        start = int(self.model.mesh_pathadr[mesh])
        if start < 0 or not (self.model.mesh_scale[mesh] == 1).all():
            return rounded
        path = Path(bytes(self.model.paths[start:]).partition(b"\0")[0].decode("utf-8", "replace"))
        if path.suffix.lower() not in (".stl", ".obj") or not path.is_file():
            return rounded
        try:
            parts = read_parts(path)
        except MeshError:  # MuJoCo reads it nevertheless
            return rounded
        points = np.vstack([part.vertices for part in parts])
        limit = SAME_VERTEX * np.ptp(points, axis=0).max()
        _, first = np.unique(points, axis=0, return_index=True)
        in_order = points[np.sort(first)]  # MuJoCo keeps the first of equal vertices
        if in_order.shape == vertices.shape and np.abs(in_order - vertices).max() <= limit:
            return in_order
        distances, nearest = cKDTree(points).query(vertices)
        return points[nearest] if distances.max() <= limit else rounded

    def png(self, texture: int) -> bytes:
        """Encode a texture as PNG."""
        from PIL import Image

        model = self.model
        height, width, channels = (int(getattr(model, f"tex_{n}")[texture]) for n in ("height", "width", "nchannel"))
        start = int(model.tex_adr[texture])
        pixels = np.array(model.tex_data[start : start + height * width * channels], dtype=np.uint8)
        stream = io.BytesIO()
        shape = (height, width) if channels == 1 else (height, width, channels)
        Image.fromarray(pixels.reshape(shape)).convert("RGB").save(stream, format="PNG")
        return stream.getvalue()

    def height_field(self, geom: int, name: str) -> tuple[PrimitiveShape, Pose]:
        """Return a box that represents a height field up to its highest point, and its pose in the geom."""
        width, depth, top, bottom = height_field_extents(self.model, int(self.model.geom_dataid[geom]))
        why = "the height field is represented by a box up to its highest point; only MJCF keeps its heights"
        self.draft.changed(f"height field `{name or geom}`", why)
        return primitive("box", width, depth, top + bottom), Pose.of([0.0, 0.0, (top - bottom) / 2])
