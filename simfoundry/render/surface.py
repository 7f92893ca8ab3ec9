"""The visible surfaces of a scene as a list of triangles, with shading data at each corner."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.ray_casts import area_normals, dot, turned, unit
from simfoundry.geometry.shapes import Geometry, tessellate
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Scene, Visual
from simfoundry.scene.state import SceneState

SEGMENTS = 96  # Segments around round primitives; the surface of a 5 cm cup is off by at most 27 micrometers

# Segments for images that must be fast; the outline of a cup 200 pixels wide is off by at most half a pixel.
FEW_SEGMENTS = 32

CREASE_DEG = 35.0  # Faces that meet at a smaller angle than this are shaded as a single smooth surface

# Vertices with more corners than this, such as the hub of a fan, are not smoothed, because the number of corner pairs
# grows quadratically.
_CROWDED = 512


@dataclass(frozen=True, eq=False)
class SceneSurface:
    """All m visible triangles in a scene.

    Attributes:
        corners: The corners in the world [m], as an array of shape (m, 3, 3).
        normals: The unit normals in the world at each corner, as an array of shape (m, 3, 3).
        uv: The texture coordinates, as an array of shape (m, 3, 2). They are zero for surfaces that have none.
        visual: The index of each triangle's visual in ``visuals``, as an array of shape (m,).
        object: The index of each triangle's object in the scene's objects, or -1 for the background, as an array of
            shape (m,).
        closed: A mask of the triangles of watertight, outward-oriented surfaces, as an array of shape (m,). The insides
            of these surfaces are never visible.
        visuals: The visuals that the triangles belong to.
    """

    corners: Array
    normals: Array
    uv: Array
    visual: NDArray[np.int64]
    object: NDArray[np.int64]
    closed: NDArray[np.bool_]
    visuals: tuple[Visual, ...]


@dataclass(frozen=True, eq=False)
class SurfacePatch:
    """The triangles of a geometry in its own frame. For the array shapes, see :class:`SceneSurface`."""

    corners: Array
    normals: Array
    uv: Array
    closed: bool


def scene_surface(
    scene: Scene, state: SceneState | None = None, segments: int = SEGMENTS, most_background: int = 0
) -> SceneSurface:
    """Return the visible triangles of ``scene`` in ``state``, which defaults to the state described by the scene.

    Args:
        scene: The scene.
        state: Its state.
        segments: The number of segments around round primitives.
        most_background: The maximum number of triangles of a background mesh. A larger one is left out.
    """
    state = SceneState.initial(scene) if state is None else state
    patches: list[SurfacePatch] = []
    visuals: list[Visual] = []
    owners: list[int] = []
    for index, item in enumerate(scene.objects):
        X_WO = state.poses.get(item.name, item.X_WO)
        X_OL = link_poses(item, state.of_object(item))
        for link in item.links:
            for visual in link.visuals:
                if visual.rgba[3] > 0:
                    patches.append(
                        _posed(surface_patch(visual.geometry, segments), X_WO @ X_OL[link.name] @ visual.X_LG)
                    )
                    visuals.append(visual)
                    owners.append(index)
    if scene.background is not None:
        around = [(visual, surface_patch(visual.geometry, segments)) for visual in scene.background.visuals]
        if sum(len(patch.corners) for _, patch in around) <= most_background:
            for visual, patch in around:
                patches.append(_posed(patch, scene.background.X_WB @ visual.X_LG))
                visuals.append(visual)
                owners.append(-1)
    sizes = [len(p.corners) for p in patches]
    return SceneSurface(
        corners=np.concatenate([np.zeros((0, 3, 3)), *(p.corners for p in patches)]),
        normals=np.concatenate([np.zeros((0, 3, 3)), *(p.normals for p in patches)]),
        uv=np.concatenate([np.zeros((0, 3, 2)), *(p.uv for p in patches)]),
        visual=np.repeat(np.arange(len(patches)), sizes),
        object=np.repeat(np.array(owners, dtype=np.int64), sizes),
        closed=np.repeat(np.array([p.closed for p in patches], dtype=np.bool_), sizes),
        visuals=tuple(visuals),
    )


def _posed(patch: SurfacePatch, X_WG: Pose) -> SurfacePatch:
    R_WG = X_WG.rotation
    return SurfacePatch(turned(R_WG, patch.corners) + X_WG.p, turned(R_WG, patch.normals), patch.uv, patch.closed)


@lru_cache(maxsize=512)
def surface_patch(geometry: Geometry, segments: int) -> SurfacePatch:
    """Return the triangles of a geometry; ``segments`` is the number of segments around round primitives."""
    mesh = tessellate(geometry, segments)
    corners = mesh.vertices[mesh.faces]
    uv = np.zeros((len(mesh.faces), 3, 2)) if mesh.uv is None else np.asarray(mesh.uv)[mesh.faces]
    _, merged = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = merged.reshape(-1)[mesh.faces].astype(np.int64)
    return SurfacePatch(corners, _corner_normals(corners, faces), uv, _is_closed(corners, faces))


def _is_closed(corners: Array, faces: NDArray[np.int64]) -> bool:
    """Return True if every edge is used once in each direction and the enclosed volume is positive."""
    if not len(faces):
        return False
    start, stop = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    count = int(faces.max()) + 1
    forth, back = np.sort(start * count + stop), np.sort(stop * count + start)
    volume = float(dot(corners[:, 0], area_normals(corners)).sum())
    return volume > 0 and bool((forth == back).all()) and bool((np.diff(forth) > 0).all())


def _corner_normals(corners: Array, faces: NDArray[np.int64]) -> Array:
    """Return unit normals at the corners, as an array of shape (m, 3, 3).

    Each normal is the area-weighted mean of the adjacent faces that do not form a crease.
    """
    area = area_normals(corners)
    facet = unit(area)
    vertex = faces.ravel()
    order = np.argsort(vertex, kind="stable")
    size = np.bincount(vertex) if len(vertex) else np.zeros(0, dtype=np.int64)
    start = np.cumsum(size) - size
    count = np.where(size > _CROWDED, 0, size)[vertex]
    corner = np.repeat(np.arange(len(vertex)), count)
    within = np.arange(len(corner)) - np.repeat(np.cumsum(count) - count, count)
    face, other = corner // 3, order[start[vertex[corner]] + within] // 3
    smooth = dot(facet[face], facet[other]) > np.cos(np.radians(CREASE_DEG))
    sums = [np.bincount(corner[smooth], weights=area[other[smooth], k], minlength=len(vertex)) for k in range(3)]
    normals = np.stack(sums, axis=1).astype(np.float64)
    smoothed = dot(normals, normals)[:, None] > 0
    return np.where(smoothed, unit(normals), np.repeat(facet, 3, axis=0)).reshape(-1, 3, 3)
