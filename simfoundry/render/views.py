"""Cameras that show a whole scene or a single object."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from simfoundry.geometry.frames import Array, look_at
from simfoundry.render.surface import FEW_SEGMENTS, scene_surface
from simfoundry.scene.model import Camera, Scene

VIEW_DEG = 40.0  # Vertical field of view [deg] of the default camera; wider views distort upright objects at the edges

# Direction from the center of the scene to the default camera, which is behind the robot's right shoulder.
FROM = (-0.72, -0.62, 0.62)

# Margin that the default camera leaves around the objects, as a factor of their radius; less would cut off outlines.
MARGIN = 1.08

# Minimum radius [m] of what a view shows, so that a tiny object is not magnified until nothing around it is visible.
LEAST_RADIUS = 0.05


@dataclass(frozen=True)
class Orbit:
    """The position of a camera that looks at a point, in the world.

    Attributes:
        azimuth_deg: The direction from the point to the camera about z, counterclockwise from x [deg].
        elevation_deg: The angle of this direction above the horizon [deg].
        distance: The distance of the camera from the point [m].
    """

    azimuth_deg: float
    elevation_deg: float
    distance: float

    @classmethod
    def of(cls, away: Array) -> Self:
        """Return the orbit of a camera that is at ``away`` [m] from its point, an array of shape (3,)."""
        x, y, z = map(float, away)
        flat = math.hypot(x, y)
        return cls(math.degrees(math.atan2(y, x)), math.degrees(math.atan2(z, flat)), math.hypot(flat, z))

    def eye(self, center: Array) -> Array:
        """Return the position of the camera [m], for a point at ``center``."""
        azimuth, elevation = math.radians(self.azimuth_deg), math.radians(self.elevation_deg)
        flat = math.cos(elevation)
        away = np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)])
        return np.asarray(center + self.distance * away)


def framing(scenes: Sequence[Scene], least: float = LEAST_RADIUS) -> tuple[Array, float]:
    """Return the center [m] and the radius [m] of the movable objects, or of all objects if none can move.

    The radius is at least ``least`` [m], and never zero.
    """
    clouds = (np.concatenate([np.zeros((0, 3)), *(_corners(s, free) for s in scenes)]) for free in (True, False))
    cloud = next((points for points in clouds if len(points)), np.array([[-0.5] * 3, [0.5] * 3]))
    low, high = cloud.min(axis=0), cloud.max(axis=0)
    return (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, least, 1e-6)


def default_orbit(radius: float) -> Orbit:
    """Return a three-quarter view of a sphere with the given radius [m]."""
    away = np.array(FROM) / np.linalg.norm(FROM)
    return Orbit.of(away * MARGIN * radius / np.sin(np.radians(VIEW_DEG / 2)))


def orbit_camera(center: Array, orbit: Orbit, width: int, height: int, name: str = "overview") -> Camera:
    """Return a camera of ``width`` x ``height`` [px] that looks at ``center`` [m] from an orbit around it."""
    focal = height / 2 / np.tan(np.radians(VIEW_DEG / 2))
    X_WC = look_at(orbit.eye(center), center)
    return Camera(name, width, height, float(focal), float(focal), (width - 1) / 2, (height - 1) / 2, X_WC)


def overview(scenes: Sequence[Scene], width: int, height: int, least: float = LEAST_RADIUS) -> Camera:
    """Return a three-quarter view of the movable objects, or of all objects if none can move; see :func:`framing`."""
    center, radius = framing(scenes, least)
    return orbit_camera(center, default_orbit(radius), width, height)


def shrunk(camera: Camera, width: int, height: int) -> Camera:
    """Return a camera with an image scaled down to fit into ``width`` x ``height`` [px]."""
    scale = min(1.0, width / camera.width, height / camera.height)
    wide, high = max(1, round(camera.width * scale)), max(1, round(camera.height * scale))
    x, y = wide / camera.width, high / camera.height
    return replace(
        camera,
        width=wide,
        height=high,
        fx=camera.fx * x,
        fy=camera.fy * y,
        cx=(camera.cx + 0.5) * x - 0.5,  # pixel centers are integers
        cy=(camera.cy + 0.5) * y - 0.5,
    )


def _corners(scene: Scene, free: bool) -> Array:
    """Return the corners of the visible triangles in the world [m], as an array of shape (n, 3).

    If ``free`` is set, only free objects are included.
    """
    surface = scene_surface(scene, segments=FEW_SEGMENTS)
    wanted = np.array([not (free and item.fixed) for item in scene.objects], dtype=np.bool_)
    return np.asarray(surface.corners[wanted[surface.object]].reshape(-1, 3))
