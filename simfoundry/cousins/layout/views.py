"""Visibility of objects, measured as the fraction of an object that is inside a camera's image and not occluded."""

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

# Fraction of an object that at least one camera must see. If less is visible in the twin, that much is sufficient.
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
        corners: Coordinates of the three corners of each triangle in the surface frame S [m], shape (3, 3, m). The
            first index is the corner, the second the coordinate (x, y, z), and the third the triangle.
        center: Center of the bounding sphere in S [m], shape (3,).
        radius: Radius of the bounding sphere [m].
        X_WS: Pose of S in the world.
    """

    corners: Array
    center: Array
    radius: float
    X_WS: Pose = IDENTITY

    @classmethod
    def of(cls, item: SceneObject) -> VisibleSurface:
        """Collect the surface of an object at its current joint positions.

        The surface consists of the visuals, or of the colliders for links without visuals. Transparent visuals are
        ignored because they do not occlude anything.
        """
        X_OL = link_poses(item)
        found = [np.zeros((0, 3, 3))]
        for link in item.links:
            visuals = [visual for visual in link.visuals if visual.rgba[3] == 1]
            parts = visuals or (() if link.visuals else link.colliders)
            found += [(X_OL[link.name] @ part.X_LG).apply(_triangles(part.geometry)) for part in parts]
        triangles = np.concatenate(found)
        corners = np.ascontiguousarray(triangles.transpose(1, 2, 0))
        if not len(triangles):
            return cls(corners, np.zeros(3), 0.0)
        low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
        return cls(corners, (low + high) / 2, float(np.linalg.norm(high - low)) / 2)

    def at(self, X_WS: Pose) -> VisibleSurface:
        """Return the surface at another pose."""
        return VisibleSurface(self.corners, self.center, self.radius, X_WS)

    def seen_from(self, X_CW: Pose) -> Array:
        """Return the corners in the frame of a camera C [m], as an array of shape (3, 3, m)."""
        X_CS = X_CW @ self.X_WS
        return np.asarray(X_CS.rotation @ self.corners + X_CS.p[:, None])


@lru_cache(maxsize=512)
def _triangles(geometry: Geometry) -> Array:
    mesh = tessellate(geometry, SEGMENTS)
    return np.asarray(mesh.vertices, dtype=np.float64)[mesh.faces]


def visible_share(camera: Camera, thing: VisibleSurface, others: Iterable[VisibleSurface]) -> float:
    """Return the fraction of an object's silhouette that is inside the camera's image and not hidden by ``others``."""
    X_CW = camera.X_WC.inverse()
    local = thing.seen_from(X_CW).transpose(2, 0, 1)
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
    before = [_before(other, X_CW, low, high, farthest) for other in others]
    triangles = np.concatenate([np.zeros((0, 3, 3)), *before])
    if len(triangles):
        hidden = first_hits(triangles, scattered_rays(x[seen], y[seen]), own.inverse_depth[seen]).triangle >= 0
        seen = seen[~hidden]
    return len(seen) / len(met)


def _before(other: VisibleSurface, X_CW: Pose, low: Array, high: Array, depth: float) -> Array:
    """Return the triangles of a surface that may occlude an object.

    Args:
        other: Surface that may be in front of the object.
        X_CW: Pose of the world in the camera frame.
        low: Lower bounds of the object's rectangle in the plane z = 1, shape (2,).
        high: Upper bounds of the rectangle, shape (2,).
        depth: Greatest depth of the object [m].

    Returns:
        Corners of the triangles in the camera frame [m], as an array of shape (m, 3, 3).
    """
    x, y, z = X_CW.apply(other.X_WS.apply(other.center))
    near = max(z - other.radius, CLOSEST)
    if z + other.radius < CLOSEST or near > depth:
        return np.zeros((0, 3, 3))
    if z > other.radius + CLOSEST:  # entirely in front of the camera, so it may be outside the rectangle's cone
        center = np.array([x, y])
        before = center - low * z < -other.radius * np.hypot(1, low)
        beyond = center - high * z > other.radius * np.hypot(1, high)
        if (before | beyond).any():
            return np.zeros((0, 3, 3))
    local = other.seen_from(X_CW)
    nearest, deepest = _range(local[:, 2])
    may_hide = (nearest < depth) & (deepest > CLOSEST)
    apart = nearest > CLOSEST  # triangles that extend behind the camera may cover anything
    z = np.where(local[:, 2] > CLOSEST, local[:, 2], 1.0)
    outside = np.zeros(len(apart), dtype=bool)
    for k in (0, 1):
        least, most = _range(local[:, k] / z)
        outside |= (most < low[k]) | (least > high[k])
    return np.asarray(local[:, :, may_hide & ~(apart & outside)].transpose(2, 0, 1))


def _range(values: Array) -> tuple[Array, Array]:
    """Return the minimum and maximum of the values at the corners of each triangle.

    Args:
        values: Values at the corners, shape (3, m).

    Returns:
        Two arrays of shape (m,).
    """
    a, b, c = values
    return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)


def best_view(
    cameras: Sequence[Camera], name: str, surfaces: Mapping[str, VisibleSurface], enough: float = 1.0
) -> tuple[str, float]:
    """Find the camera that sees the largest fraction of an object.

    Args:
        cameras: The cameras. There must be at least one.
        name: Name of the object.
        surfaces: Surfaces of all objects by name. Other objects may occlude this one.
        enough: Sufficient fraction. The search stops at the first camera that sees at least this much.

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
