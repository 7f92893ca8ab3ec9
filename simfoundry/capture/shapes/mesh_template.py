"""A mesh that is prepared for being found in an image: sampled, simplified, and with the sides on which it may lie."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.deviation import surface_samples
from simfoundry.assets.mesh import weld
from simfoundry.geometry.frames import Array, frozen_array
from simfoundry.geometry.ray_casts import area_normals, blend
from simfoundry.geometry.shapes import Mesh

# Number of points on the surface that observed points are matched with: about 6 mm apart on an object of 20 cm.
SAMPLES = 1500

# Number of triangles of the simplified mesh, which is cast hundreds of times. Scans of 16,000 triangles deviate by
# less than 2 mm then, a third of the depth noise at half a meter.
COARSE_FACES = 800

# Least angle [deg] between two sides on which a mesh may lie, and the largest number of sides. A registration turns an
# object by more than half of this angle. A round object has sides all around.
SIDE_ANGLE_DEG, MAX_SIDES = 25.0, 12

# Least share of the area of the convex hull that faces down on a side. Objects rarely rest on less.
SIDE_SHARE = 0.02

# Largest width and height [px] of the texture from which colors are taken, and side [m] of the square over which each
# is averaged: the size of a pixel at 1 m.
TEXTURE_SIZE, COLOR_SIDE = 1024, 0.002

# Number of directions from which silhouettes are measured: 15 degrees apart.
DIRECTIONS = 100


@dataclass(frozen=True, eq=False)
class MeshTemplate:
    """A mesh with what a registration needs of it.

    Attributes:
        mesh: The mesh in its own frame, with z up [m].
        vertices: Vertices of the simplified mesh [m], shape (n, 3).
        faces: Triangles of the simplified mesh, shape (k, 3).
        points: Points on the surface [m], shape (m, 3).
        normals: Normals of the surface there, shape (m, 3).
        sides: Rotations that put the mesh on the sides on which it may lie, shape (s, 3, 3). The first one is the
            identity, with the mesh as it is.
        center: Center of the bounding box [m], shape (3,).
        diameter: Length of the diagonal of the bounding box [m].
        silhouettes: Least and largest area of the silhouette of the convex hull, over all directions [m²].
        area: Area of the surface [m²].
        colors: Colors of the surface at the points, as sRGB values from 0 to 1, shape (m, 3), or None without texture.
    """

    mesh: Mesh
    vertices: Array
    faces: NDArray[np.int32]
    points: Array
    normals: Array
    sides: Array
    center: Array
    diameter: float
    silhouettes: tuple[float, float]
    area: float
    colors: Array | None = None

    @classmethod
    def of(cls, mesh: Mesh) -> MeshTemplate:
        """Prepare a mesh, whose triangles must be counterclockwise as seen from outside."""
        vertices, faces = simplified_surface(mesh.vertices, mesh.faces)
        points, owner = surface_samples(mesh.vertices, mesh.faces, SAMPLES)
        corners = mesh.vertices[mesh.faces[owner]]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
        diameter = max(float(np.linalg.norm(high - low)), 1e-9)
        sides, areas = resting_sides(vertices), hull_silhouettes(vertices)
        area = float(np.linalg.norm(area_normals(mesh.vertices[mesh.faces]), axis=1).sum() / 2)
        colors = surface_colors(mesh, points, owner)
        return cls(mesh, vertices, faces, points, normals, sides, (low + high) / 2, diameter, areas, area, colors)


def simplified_surface(
    vertices: Array, faces: NDArray[np.int32], count: int = COARSE_FACES
) -> tuple[Array, NDArray[np.int32]]:
    """Return a mesh of about ``count`` triangles with nearly the same surface."""
    corners, sides = weld(vertices, faces)
    if len(sides) <= count:
        return corners, np.ascontiguousarray(sides, np.int32)
    import fast_simplification

    found, triangles = fast_simplification.simplify(corners, sides, target_count=count)
    if not len(triangles):
        return corners, np.ascontiguousarray(sides, np.int32)
    return np.asarray(found, np.float64), np.ascontiguousarray(triangles, np.int32)


def surface_colors(mesh: Mesh, points: Array, owner: NDArray[np.int64]) -> Array | None:
    """Return the colors of a textured mesh at points of its surface, as sRGB values from 0 to 1, shape (n, 3).

    Args:
        mesh: The mesh.
        points: Points on it [m], shape (n, 3).
        owner: Index of the triangle of each point, shape (n,).
    """
    if mesh.texture is None or mesh.uv is None:
        return None
    from trimesh.triangles import points_to_barycentric

    from simfoundry.render.shading import encode_srgb, texel_density, texture_color, texture_pyramid

    chosen = mesh.faces[owner]
    corners = mesh.vertices[chosen]
    weights = np.nan_to_num(points_to_barycentric(corners, points), nan=1 / 3)
    levels = texture_pyramid(mesh.texture, TEXTURE_SIZE)
    texels = texel_density(levels, mesh.uv[chosen], corners) * COLOR_SIDE**2
    linear = texture_color(levels, blend(mesh.uv[chosen], weights), texels)
    return frozen_array(encode_srgb(linear) / 255)


def hull_silhouettes(vertices: Array) -> tuple[float, float]:
    """Return the least and the largest area of the silhouette of the convex hull of points, over all directions [m²].

    By Cauchy's formula, the silhouette in a direction is half the sum of the areas of all faces, seen from there.
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        found = ConvexHull(vertices)
    except (QhullError, ValueError):
        return 0.0, float("inf")
    corners = vertices[found.simplices]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    k = np.arange(DIRECTIONS) + 0.5
    z, turn = 1 - k / DIRECTIONS, k * math.pi * (3 - math.sqrt(5))  # a spiral over half of the sphere
    directions = np.column_stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z])
    seen = np.abs(directions @ found.equations[:, :3].T) @ area / 2
    return float(seen.min()), float(seen.max())


def resting_sides(vertices: Array) -> Array:
    """Return rotations that put a mesh on the sides on which it may lie, after the identity.

    A side is a direction in which a large part of the convex hull faces. Sides that differ by little are one.

    Returns:
        Array of shape (s, 3, 3), with 1 to :data:`MAX_SIDES` rotations.
    """
    from scipy.spatial import ConvexHull, QhullError

    down = np.array([0.0, 0.0, -1.0])
    kept = [down]
    try:
        found = ConvexHull(vertices)
    except (QhullError, ValueError):
        return np.eye(3)[None]
    corners = vertices[found.simplices]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    normals = found.equations[:, :3]
    near = normals @ normals.T > np.cos(np.radians(SIDE_ANGLE_DEG / 2))
    weight = near @ area
    left = np.ones(len(normals), dtype=bool)
    left &= normals @ down < np.cos(np.radians(SIDE_ANGLE_DEG))
    while len(kept) < MAX_SIDES and left.any():
        best = int(np.argmax(np.where(left, weight, -1.0)))
        if weight[best] < SIDE_SHARE * area.sum():
            break
        mean = (normals * (area * near[best])[:, None]).sum(axis=0)
        kept.append(mean / np.linalg.norm(mean))
        left &= normals @ normals[best] < np.cos(np.radians(SIDE_ANGLE_DEG))
    return frozen_array(np.array([rotation_between(side, down) for side in kept]))


def rotation_between(a: Array, b: Array) -> Array:
    """Return the smallest rotation that turns the unit vector ``a`` into ``b``, shape (3, 3)."""
    cosine = float(a @ b)
    if cosine < -1 + 1e-9:  # half a turn about any axis across
        axis = np.cross(a, np.eye(3)[int(np.argmin(np.abs(a)))])
        axis /= np.linalg.norm(axis)
        return np.asarray(2 * np.outer(axis, axis) - np.eye(3))
    v = np.cross(a, b)
    K = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.asarray(np.eye(3) + K + K @ K / (1 + cosine))
