"""Find the points of a scene that a click means: on its background, on its objects, or on the cloud of its capture."""

from __future__ import annotations

import numpy as np

from simfoundry.capture.outputs.overlay import RAY_RAD, CaptureOverlay, object_surface
from simfoundry.capture.shapes.register_mesh import Surface
from simfoundry.capture.shapes.solid_casts import cast_mesh
from simfoundry.geometry.frames import Array
from simfoundry.geometry.shapes import tessellate
from simfoundry.scene.model import Background, Scene
from simfoundry.studio.acts.background import Point

# Opacity from which on a Gaussian is a surface that people can click on, rather than haze.
SOLID = 0.3


def background_point(background: Background, origin: Array, direction: Array) -> Point | None:
    """Return the first point [m] of a background on a ray in the world, or None if the ray misses it.

    On a splat, it is the nearest center of a Gaussian that is not transparent and lies within :data:`RAY_RAD` of the
    ray.
    """
    if background.splat is not None:
        solid = background.splat.opacities.reshape(-1) >= SOLID
        return _nearest(background.X_WB.apply(background.splat.positions[solid].astype(np.float64)), origin, direction)
    surfaces = [(tessellate(v.geometry), background.X_WB @ v.X_LG) for v in background.visuals]
    return _first(origin, direction, [(X.apply(mesh.vertices), mesh.faces) for mesh, X in surfaces])


def scene_point(scene: Scene, overlay: CaptureOverlay | None, origin: Array, direction: Array) -> Point | None:
    """Return the first point [m] of a scene's objects on a ray in the world, or else of the cloud of its capture."""
    surfaces = []
    for item in scene.objects:
        vertices, faces = object_surface(item)
        surfaces.append((item.X_WO.apply(vertices), faces))
    found = _first(origin, direction, surfaces)
    if found is None and overlay is not None:
        pixel = overlay.pixel_on_ray(origin, direction)
        return _as_point(overlay.points_W[pixel[1], pixel[0]]) if pixel is not None else None
    return found


def _first(origin: Array, direction: Array, surfaces: list[Surface]) -> Point | None:
    """Return the first point of surfaces, each of vertices (n, 3) and faces (k, 3), on a ray."""
    nearest = np.inf
    for vertices, faces in surfaces:
        if len(faces):
            hits = cast_mesh(origin, direction[None], vertices, faces)
            nearest = min(nearest, float(hits.depth[0]))
    return _as_point(origin + nearest * direction) if np.isfinite(nearest) else None


def _nearest(points: Array, origin: Array, direction: Array) -> Point | None:
    """Return the first of the points (n, 3) that lie within a small angle of a ray."""
    offsets = points - origin
    along = offsets @ (direction / np.linalg.norm(direction))
    beside = np.sqrt(np.maximum((offsets**2).sum(axis=1) - along**2, 0.0))
    near = np.flatnonzero((along > 0) & (beside < RAY_RAD * along))
    return _as_point(points[near[np.argmin(along[near])]]) if len(near) else None


def _as_point(p: Array) -> Point:
    x, y, z = (float(v) for v in p)
    return x, y, z
