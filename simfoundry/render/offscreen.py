"""Offscreen rendering of MuJoCo models with exact camera intrinsics."""

from __future__ import annotations

import copy
import importlib
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.render.backdrop import SplatBackdrop
from simfoundry.render.gl import Engine, RenderError, choose_engine
from simfoundry.render.shading import HORIZON, KEY_DIRECTION, encode_srgb
from simfoundry.scene.model import Camera

if TYPE_CHECKING:
    import mujoco


Image = NDArray[np.uint8]

VISUAL_GROUP = 2  # Geom group of visuals in the MJCF backend; no other group is rendered

# Settings for quick images: the shadow map resolution and the supersampling factor, each along one side.
QUICK_SHADOW, FINE = 1024, 2

NEAR, FAR = 0.01, 100.0  # Near and far clipping distances [m]

BACKDROP_EMISSION = 1e3  # Emission of the backdrop; high enough that lights in the scene do not change its color


class MujocoRenderer(AbstractContextManager["MujocoRenderer"]):
    """An offscreen renderer for a MuJoCo model. Close it after use, or use it in a ``with`` statement.

    On a CPU, a ``quick`` renderer takes a third of the usual time for small images. It uses simplified meshes
    (:func:`coarsened`), smaller shadow maps, and four rendered pixels per image pixel instead of the driver's
    multisampling.

    Attributes:
        size: The maximum width and height of an image [px].
    """

    def __init__(
        self, model: mujoco.MjModel, width: int, height: int, engine: Engine = Engine.AUTO, quick: bool = False
    ) -> None:
        import mujoco

        chosen = choose_engine(engine)
        if chosen is Engine.RAYCAST:
            raise RenderError("MuJoCo could not find a GL driver: install libegl1 and libgl1-mesa-dri, or libosmesa6")
        self._model, self.size, self._fine = model, (width, height), FINE if quick else 1
        buffer = model.vis.global_
        buffer.offwidth = max(self._fine * width, buffer.offwidth)
        buffer.offheight = max(self._fine * height, buffer.offheight)
        drawn = coarsened(model) if quick else model
        if quick:
            drawn.vis.quality.shadowsize, drawn.vis.quality.offsamples = QUICK_SHADOW, 0
        driver: Any = importlib.import_module(f"mujoco.{chosen.value}")
        self._gl = driver.GLContext(buffer.offwidth, buffer.offheight)
        self._gl.make_current()
        self._context = mujoco.MjrContext(drawn, mujoco.mjtFontScale.mjFONTSCALE_100)
        self._scene = mujoco.MjvScene(model, maxgeom=max(1000, 4 * model.ngeom))
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = 0
        self._option.geomgroup[VISUAL_GROUP] = 1

    def holds(self, width: int, height: int) -> bool:
        """Return True if an image of this size can be rendered."""
        return width <= self.size[0] and height <= self.size[1]

    def picture(self, data: mujoco.MjData, camera: Camera, backdrop: SplatBackdrop | None = None) -> Image:
        """Render the image seen by ``camera``, with the splat that it sees, if there is one.

        Returns:
            The sRGB image as a uint8 array of shape (h, w, 3).
        """
        picture = self._draw(data, camera, self._fine)
        if self._fine > 1:
            import cv2

            size = (camera.width, camera.height)
            picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
        return picture if backdrop is None else self._composited(picture, data, camera, backdrop)

    def _composited(self, picture: Image, data: mujoco.MjData, camera: Camera, backdrop: SplatBackdrop) -> Image:
        """Composite a splat with the image, in which outlines are blended with the color of the horizon."""
        if self._fine == 1 or _has_sky(self._model):
            return backdrop.over(picture, self.depth(data, camera))
        h, w, n = camera.height, camera.width, self._fine
        blocks = self.depth(data, camera, n).reshape(h, n, w, n)
        coverage = np.isfinite(blocks).mean(axis=(1, 3))
        return backdrop.over(picture, blocks.min(axis=(1, 3)), coverage, encode_srgb(HORIZON) / 255.0)

    def geoms(self, data: mujoco.MjData, camera: Camera) -> NDArray[np.int32]:
        """Return the geom that is visible at each pixel.

        Returns:
            An array of shape (h, w) that contains the geom's ID plus 1, or 0 if there is no geom.
        """
        import mujoco

        labels = [mujoco.mjtRndFlag.mjRND_SEGMENT.value, mujoco.mjtRndFlag.mjRND_IDCOLOR.value]
        self._scene.flags[labels] = 1
        try:
            rgb = self._draw(data, camera).astype(np.int32)
        finally:
            self._scene.flags[labels] = 0
        drawn = rgb[..., 0] + (rgb[..., 1] << 8) + (rgb[..., 2] << 16)  # 1 + the index in the scene's list
        geom = np.zeros(self._scene.ngeom + 1, dtype=np.int32)
        for item in self._scene.geoms[: self._scene.ngeom]:
            if item.segid >= 0 and item.objtype == mujoco.mjtObj.mjOBJ_GEOM:
                geom[item.segid + 1] = item.objid + 1
        return np.asarray(geom[np.where(drawn < len(geom), drawn, 0)], dtype=np.int32)

    def depth(self, data: mujoco.MjData, camera: Camera, fine: int = 1) -> NDArray[np.float64]:
        """Return the depth [m] along the optical axis at each pixel, or infinity where no surface is visible.

        Returns:
            An array of shape (fine * h, fine * w), with ``fine`` pixels per image pixel along each axis.
        """
        import mujoco

        self._scene.flags[mujoco.mjtRndFlag.mjRND_SEGMENT.value] = 1  # without the backdrop
        try:
            self._draw(data, camera, fine)
        finally:
            self._scene.flags[mujoco.mjtRndFlag.mjRND_SEGMENT.value] = 0
        near = np.empty((fine * camera.height, fine * camera.width), dtype=np.float32)
        mujoco.mjr_readPixels(None, near, mujoco.MjrRect(0, 0, near.shape[1], near.shape[0]), self._context)
        values = near[::-1].astype(np.float64)
        with np.errstate(divide="ignore"):
            meters = NEAR / (1.0 - values * (1.0 - NEAR / FAR))
        return np.asarray(np.where(values < 1.0, meters, np.inf))

    def _draw(self, data: mujoco.MjData, camera: Camera, fine: int = 1) -> Image:
        """Render with ``fine`` pixels per image pixel along each axis."""
        import mujoco

        if not self.holds(camera.width, camera.height):
            sizes = f"is {camera.width}x{camera.height}, but the renderer was created for {self.size[0]}x{self.size[1]}"
            hint = "create the renderer with the size of the largest camera"
            raise RenderError(f"the image from camera {camera.name!r} {sizes}; {hint}")
        self._gl.make_current()
        free, every = mujoco.MjvCamera(), mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(self._model, data, self._option, None, free, every, self._scene)
        for view in self._scene.camera:
            _aim(view, camera)
        _light(self._scene, self._model, camera)
        if not self._scene.flags[mujoco.mjtRndFlag.mjRND_SEGMENT]:
            _hang_backdrop(self._scene, self._model, camera)
        viewport = mujoco.MjrRect(0, 0, fine * camera.width, fine * camera.height)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        mujoco.mjr_render(viewport, self._scene, self._context)
        picture = np.empty((fine * camera.height, fine * camera.width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(picture, None, viewport, self._context)
        return np.ascontiguousarray(picture[::-1])  # GL counts rows from the bottom

    def close(self) -> None:
        """Release the driver's resources. The renderer cannot be used afterward."""
        self._gl.make_current()
        self._context.free()
        self._gl.free()

    def __exit__(self, *_: object) -> None:
        """Close the renderer."""
        self.close()


def _aim(view: mujoco.MjvGLCamera, camera: Camera) -> None:
    """Set the pose and frustum of a GL camera.

    The image starts at -0.5 because pixel centers lie at integer coordinates.
    """
    R_WC = camera.X_WC.rotation
    view.pos, view.forward, view.up = camera.X_WC.p, R_WC[:, 2], -R_WC[:, 1]
    view.orthographic = 0
    view.frustum_near, view.frustum_far = NEAR, FAR
    view.frustum_center = NEAR * ((camera.width - 1) / 2 - camera.cx) / camera.fx
    view.frustum_width = NEAR * camera.width / 2 / camera.fx
    view.frustum_top = NEAR * (camera.cy + 0.5) / camera.fy
    view.frustum_bottom = NEAR * (camera.cy + 0.5 - camera.height) / camera.fy


def _light(scene: mujoco.MjvScene, model: mujoco.MjModel, camera: Camera) -> None:
    """Move MuJoCo's headlight to the camera. A model without lights is lit in the same way as by the ray caster."""
    import mujoco

    for light in scene.lights[: scene.nlight]:
        if light.headlight:
            light.pos, light.dir = camera.X_WC.p, camera.X_WC.rotation[:, 2]
            if model.nlight == 0:
                light.ambient, light.diffuse, light.specular = np.full(3, 0.40), np.full(3, 0.12), np.zeros(3)
    if model.nlight or scene.nlight == len(scene.lights):
        return
    key = scene.lights[scene.nlight]
    key.id, key.headlight, key.castshadow, key.texid = -1, 0, 1, -1
    key.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    key.pos, key.dir = model.stat.center + KEY_DIRECTION * model.stat.extent, -KEY_DIRECTION
    key.ambient, key.diffuse, key.specular = np.zeros(3), np.full(3, 0.62), np.full(3, 0.1)
    key.attenuation, key.cutoff, key.exponent = np.array([1.0, 0.0, 0.0]), 180.0, 0.0
    scene.nlight += 1


def _has_sky(model: mujoco.MjModel) -> bool:
    import mujoco

    return bool((model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX).any())


def _hang_backdrop(scene: mujoco.MjvScene, model: mujoco.MjModel, camera: Camera) -> None:
    """Add a plane in the ray caster's horizon color behind everything else, unless the model has a skybox."""
    import mujoco

    if _has_sky(model) or scene.ngeom == scene.maxgeom:
        return
    R_WC = camera.X_WC.rotation
    center, R_WG = camera.X_WC.p + 0.9 * FAR * R_WC[:, 2], R_WC * np.array([1.0, -1.0, -1.0])
    color = np.append(encode_srgb(HORIZON) / 255 / BACKDROP_EMISSION, 1.0).astype(np.float32)
    plane = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(plane, mujoco.mjtGeom.mjGEOM_PLANE, np.full(3, 100 * FAR), center, R_WG.ravel(), color)
    plane.emission, plane.specular, plane.reflectance = BACKDROP_EMISSION, 0.0, 0.0
    plane.category = mujoco.mjtCatBit.mjCAT_DECOR
    scene.ngeom += 1


Index = NDArray[np.int64]
Floats = NDArray[np.float32]

FEW = 500  # Meshes with at most this many triangles are not simplified

# Edge length [m] of the cubes in which vertices are merged: 0.4 pixels at half a meter in an image 320 pixels wide.
MERGED_M = 1e-3

# Flat regions are also merged in larger cubes: two, four and eight times as large. FLAT is the minimum cosine (10 deg)
# between the normals of a flat region and their mean. The outline moves by at most 0.2 mm, and shading does not change
# because the normals are kept.
FLAT_LEVELS, FLAT = 3, 0.985


def coarsened(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy of a model for rendering, with meshes simplified to the level of detail visible in a small image.

    Triangles that are degenerate or duplicated after merging are omitted. The copy cannot be used for physics, because
    its collision meshes are not updated.
    """
    drawn = copy.copy(model)
    for mesh in range(drawn.nmesh):
        if drawn.mesh_facenum[mesh] > FEW:
            _coarsen(drawn, mesh)
    return drawn


def _coarsen(model: mujoco.MjModel, mesh: int) -> None:
    begin, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    corner = int(model.mesh_vertadr[mesh])
    corners = model.mesh_vert[corner : corner + int(model.mesh_vertnum[mesh])]
    faces = model.mesh_face[begin : begin + count].astype(np.int64)
    faces = _clusters(corners, faces)[faces]
    kept = _distinct(faces)
    model.mesh_face[begin : begin + len(kept)] = faces[kept]
    for rows in (model.mesh_facenormal, model.mesh_facetexcoord):  # indexed by the same corners of the same triangles
        rows[begin : begin + len(kept)] = rows[begin : begin + count][kept]
    model.mesh_facenum[mesh] = len(kept)


def _clusters(corners: Floats, faces: Index) -> Index:
    """Return the index of the vertex that each vertex is merged into.

    Args:
        corners: The vertices [m], as an array of shape (n, 3).
        faces: The vertex indices of each triangle.

    Returns:
        An array of shape (n,).
    """
    a, b, c = (corners[faces[:, k]] for k in range(3))
    normals = _unit(np.cross(b - a, c - a))
    owner = _cubes(corners, MERGED_M)
    for level in range(1, FLAT_LEVELS + 1):
        cubes = _cubes(corners, MERGED_M * 2**level)
        at = cubes[faces.ravel()]
        every = np.repeat(normals, 3, axis=0)
        mean = _unit(np.stack([np.bincount(at, every[:, k], cubes.max() + 1) for k in range(3)], axis=1))
        least = np.ones(len(mean))
        np.minimum.at(least, at, np.einsum("ij,ij->i", every, mean[at]))
        flat = least[cubes] > FLAT
        owner = np.where(flat, cubes + (level << 32), owner)
    _, first, cube = np.unique(owner, return_index=True, return_inverse=True)
    return np.asarray(first[cube])


def _unit(vectors: NDArray[np.floating]) -> NDArray[np.float64]:
    """Normalize an array of vectors with shape (n, 3). Vectors of zero length are unchanged."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, 1e-20), dtype=np.float64)


def _cubes(corners: Floats, size: float) -> Index:
    """Return the index of the cube that contains each vertex, as an array of shape (n,).

    Empty cubes are not counted.
    """
    x, y, z = np.floor((corners - corners.min(axis=0)) / size).astype(np.int64).T
    along = int(max(x.max(), y.max(), z.max())) + 1
    return np.asarray(np.unique((x * along + y) * along + z, return_inverse=True)[1], dtype=np.int64)


def _distinct(faces: Index) -> Index:
    """Return the indices of non-degenerate triangles that do not duplicate an earlier triangle, in ascending order."""
    a, b, c = np.sort(faces, axis=1).T
    size = int(c.max()) + 1
    _, first = np.unique((a * size + b) * size + c, return_index=True)
    first.sort()
    return np.asarray(first[(a[first] != b[first]) & (b[first] != c[first])], dtype=np.int64)
