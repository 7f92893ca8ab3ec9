"""Visibility of objects: the fraction of an object that is inside a camera's image and not occluded."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from simfoundry.geometry.frames import IDENTITY, Array, Pose
from simfoundry.geometry.ray_casts import first_hits, scattered_rays
from simfoundry.geometry.shapes import Geometry, tessellate
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Camera, SceneObject

# Fraction of an object that at least one camera must see. If less is visible in the twin, that fraction is sufficient.
SEEN = 0.6

# Near plane of a camera [m].
CLOSEST = 0.01

# Number of rays along each side of an object's rectangle in the image; gives an accuracy of about 3%.
RAYS = 16

# Number of edges around a round shape. The outline error is at most 3.4% of the radius, about the ray resolution.
SEGMENTS = 12


@dataclass(frozen=True, eq=False)
class VisibleSurface:
    """The visible surface of an object.

    Attributes:
        triangles: Triangles in the surface frame S [m], shape (m, 3, 3).
        center: Center of the bounding sphere in S [m], shape (3,).
        radius: Radius of the bounding sphere [m].
        X_WS: Pose of S in the world.
    """

    triangles: Array
    center: Array
    radius: float
    X_WS: Pose = IDENTITY

    @classmethod
    def of(cls, item: SceneObject) -> VisibleSurface:
        """Collect the surface of an object at its current joint positions.

        The surface consists of the visuals, or of the colliders for links without visuals. Transparent visuals are
        ignored, because they do not occlude anything.
        """
        X_OL = link_poses(item)
        found = [np.zeros((0, 3, 3))]
        for link in item.links:
            visuals = [visual for visual in link.visuals if visual.rgba[3] == 1]
            parts = visuals or (() if link.visuals else link.colliders)
            found += [(X_OL[link.name] @ part.X_LG).apply(_triangles(part.geometry)) for part in parts]
        triangles = np.concatenate(found)
        if not len(triangles):
            return cls(triangles, np.zeros(3), 0.0)
        low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
        return cls(triangles, (low + high) / 2, float(np.linalg.norm(high - low)) / 2)

    def at(self, X_WS: Pose) -> VisibleSurface:
        """Return the surface at another pose."""
        return VisibleSurface(self.triangles, self.center, self.radius, X_WS)

    def seen_from(self, camera: Camera) -> Array:
        """Return the triangles in the camera frame [m], shape (m, 3, 3)."""
        return (camera.X_WC.inverse() @ self.X_WS).apply(self.triangles)


@lru_cache(maxsize=512)
def _triangles(geometry: Geometry) -> Array:
    mesh = tessellate(geometry, SEGMENTS)
    return np.asarray(mesh.vertices, dtype=np.float64)[mesh.faces]


def visible_share(camera: Camera, thing: VisibleSurface, others: Iterable[VisibleSurface]) -> float:
    """Return the fraction of an object's silhouette that is inside the image and not occluded by ``others``."""
    local = thing.seen_from(camera)
    corners = local.reshape(-1, 3)
    ahead = corners[corners[:, 2] > CLOSEST]
    if not len(ahead):
        return 0.0
    across = ahead[:, :2] / ahead[:, 2:]
    low, high = across.min(axis=0), across.max(axis=0)
    steps = (np.arange(RAYS) + 0.5) / RAYS
    x, y = (g.ravel() for g in np.meshgrid(*(low[k] + steps * (high[k] - low[k]) for k in (0, 1))))
    own = first_hits(local, scattered_rays(x, y))
    met = np.flatnonzero(own.triangle >= 0)
    u, v = camera.fx * x[met] + camera.cx, camera.fy * y[met] + camera.cy
    inside = (u >= -0.5) & (u < camera.width - 0.5) & (v >= -0.5) & (v < camera.height - 0.5)
    seen = met[inside]
    if not len(seen):
        return 0.0
    farthest = float(ahead[:, 2].max())
    before = [_before(other, camera, low, high, farthest) for other in others]
    triangles = np.concatenate([np.zeros((0, 3, 3)), *before])
    if len(triangles):
        hidden = first_hits(triangles, scattered_rays(x[seen], y[seen]), own.inverse_depth[seen]).triangle >= 0
        seen = seen[~hidden]
    return len(seen) / len(met)


def _before(other: VisibleSurface, camera: Camera, low: Array, high: Array, depth: float) -> Array:
    """Return the triangles of a surface that may occlude an object, in the camera frame [m], shape (m, 3, 3).

    Args:
        other: Surface that may be in front of the object.
        camera: The camera.
        low: Lower bounds of the object's rectangle in the plane z = 1, shape (2,).
        high: Upper bounds of the rectangle, shape (2,).
        depth: Greatest depth of the object [m].
    """
    x, y, z = camera.X_WC.inverse().apply(other.X_WS.apply(other.center))
    near = max(z - other.radius, CLOSEST)
    if z + other.radius < CLOSEST or near > depth:
        return np.zeros((0, 3, 3))
    if z > other.radius + CLOSEST:  # entirely in front of the camera, so it may be outside the rectangle's cone
        center = np.array([x, y])
        before = center - low * z < -other.radius * np.hypot(1, low)
        beyond = center - high * z > other.radius * np.hypot(1, high)
        if (before | beyond).any():
            return np.zeros((0, 3, 3))
    local = other.seen_from(camera)
    z = local[:, :, 2]
    may_hide = (z.min(axis=1) < depth) & (z.max(axis=1) > CLOSEST)
    whole = z.min(axis=1) > CLOSEST  # triangles that extend behind the camera may cover anything
    across = local[:, :, :2] / np.where(z > CLOSEST, z, 1.0)[:, :, None]
    apart = (across.max(axis=1) < low).any(axis=1) | (across.min(axis=1) > high).any(axis=1)
    return np.asarray(local[may_hide & ~(whole & apart)])


def best_view(
    cameras: Sequence[Camera], name: str, surfaces: Mapping[str, VisibleSurface], enough: float = 1.0
) -> tuple[str, float]:
    """Find the camera that sees the largest fraction of an object.

    Args:
        cameras: The cameras; there must be at least one.
        name: Name of the object.
        surfaces: Surfaces of all objects by name; other objects may occlude this one.
        enough: The search stops at the first camera that sees at least this fraction.

    Returns:
        The name of the camera and the fraction that it sees.
    """
    others = [surface for other, surface in surfaces.items() if other != name]
    best = (cameras[0].name, -1.0)
    for camera in cameras:
        share = visible_share(camera, surfaces[name], others)
        if share > best[1]:
            best = (camera.name, share)
        if share >= enough:
            break
    return best
