"""Cast rays against solids.

Casts against primitives are analytic, so a fit can evaluate many of them. A ray cast returns the depth of the first hit
along each ray (infinity for a miss) and the slant. The slant is the cosine between the ray and the surface normal,
multiplied by the length of the ray, so that ``(depth - observed) * slant`` is the distance perpendicular to the surface
[m].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.ray_casts import area_normals, first_hits, scattered_rays, turned, unit

IN_FRONT = 0.2  # minimum cosine between a ray and the view axis for rays that share a view frame


@dataclass(frozen=True, eq=False)
class SolidHits:
    """The hits of rays on a solid.

    ``depth`` is the depth along each ray (inf for a miss), and ``slant`` is the slant of each ray. Both have shape
    (m,).
    """

    depth: Array
    slant: Array


def cast_box(eye: Array, rays: Array, size: Array, X_WO: Pose) -> SolidHits:
    """Cast rays against a box that has the full extents ``size`` [m] and is centered at ``X_WO``."""
    origin, directions = _to_local(eye, rays, X_WO)
    safe = np.where(np.abs(directions) < 1e-12, 1e-12, directions)
    low, high = (-size / 2 - origin) / safe, (size / 2 - origin) / safe
    entry, leave = np.minimum(low, high), np.maximum(low, high)
    axis = np.argmax(entry, axis=1)
    enter = np.take_along_axis(entry, axis[:, None], 1)[:, 0]
    hit = (enter <= leave.min(axis=1)) & (enter > 0)
    slant = np.abs(np.take_along_axis(directions, axis[:, None], 1)[:, 0])
    return SolidHits(np.where(hit, enter, np.inf), slant)


def cast_sphere(eye: Array, rays: Array, radius: float, center: Array) -> SolidHits:
    """Cast rays against a sphere."""
    to_eye = eye - center
    a = np.einsum("ij,ij->i", rays, rays)
    b = rays @ to_eye
    root = b * b - a * (to_eye @ to_eye - radius**2)
    hit = root > 0
    depth = np.where(hit, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)
    hit &= depth > 0
    normal = (to_eye + np.where(hit, depth, 0)[:, None] * rays) / radius
    return SolidHits(np.where(hit, depth, np.inf), np.abs(np.einsum("ij,ij->i", normal, rays)))


def cast_lathe(eye: Array, rays: Array, profile: Array, X_WO: Pose) -> SolidHits:
    """Cast rays against a surface of revolution about the local z axis.

    ``profile`` is a polyline of (radius, height) [m], given as an array of shape (k, 2). Each of its edges sweeps out a
    cone, a cylinder or a ring.
    """
    o, d = _to_local(eye, rays, X_WO)
    is_ring = np.abs(np.diff(profile[:, 1])) < 1e-9
    best, slant = np.full(len(d), np.inf), np.zeros(len(d))
    start, end = profile[:-1], profile[1:]
    if not is_ring.all():
        best, slant = _cone_hits(o, d, start[~is_ring], end[~is_ring], best, slant)
    if is_ring.any():
        r0, r1, z0 = start[is_ring, 0][:, None], end[is_ring, 0][:, None], start[is_ring, 1][:, None]
        safe_dz = np.where(np.abs(d[:, 2]) < 1e-12, 1e-12, d[:, 2])
        t = (z0 - o[2]) / safe_dz
        radius = np.hypot(o[0] + t * d[:, 0], o[1] + t * d[:, 1])
        hit = (t > 1e-6) & (radius >= np.minimum(r0, r1)) & (radius <= np.maximum(r0, r1))
        best, slant = _nearer(best, slant, np.where(hit, t, np.inf), np.broadcast_to(np.abs(d[:, 2]), t.shape))
    return SolidHits(best, slant)


def _cone_hits(o: Array, d: Array, start: Array, end: Array, best: Array, slant: Array) -> tuple[Array, Array]:
    """Return the nearest hits of local rays on the cones that edges (radius, height) sweep out, or previous hits."""
    r0, z0, z1 = start[:, 0][:, None], start[:, 1][:, None], end[:, 1][:, None]
    slope = (end[:, 0][:, None] - r0) / (z1 - z0)
    # On the cone through an edge, |xy| = g + slope * z.
    g = r0 - slope * z0
    rho, w = g + slope * o[2], slope * d[:, 2]
    a = d[:, 0] ** 2 + d[:, 1] ** 2 - w**2
    b = o[0] * d[:, 0] + o[1] * d[:, 1] - rho * w
    c = o[0] ** 2 + o[1] ** 2 - rho**2
    square = b * b - a * c
    exists, root = square > 0, np.sqrt(np.maximum(square, 0.0))
    safe_a = np.where(np.abs(a) < 1e-12, 1e-12, a)
    low, high = np.minimum(z0, z1), np.maximum(z0, z1)
    tilt = 1.0 / np.sqrt(1.0 + slope**2)
    for sign in (-1.0, 1.0):
        t = (-b + sign * root) / safe_a
        z, radius = o[2] + t * d[:, 2], rho + t * w
        on_edge = exists & (t > 1e-6) & (z >= low) & (z <= high) & (radius >= 0)
        x, y = o[0] + t * d[:, 0], o[1] + t * d[:, 1]
        cosine = tilt * ((x * d[:, 0] + y * d[:, 1]) / np.maximum(radius, 1e-9) - slope * d[:, 2])
        best, slant = _nearer(best, slant, np.where(on_edge, t, np.inf), np.abs(cosine))
    return best, slant


def cast_mesh(eye: Array, rays: Array, vertices: Array, faces: NDArray[np.int32]) -> SolidHits:
    """Cast rays against triangles in the world.

    The vertices [m] have shape (n, 3), and the faces have shape (k, 3). This function works for any rays and any solid.
    """
    face = first_faces(eye, rays, vertices, faces)
    hit = face >= 0
    corners = vertices[faces[face[hit]]]
    normal = unit(area_normals(corners))
    slope = np.einsum("ij,ij->i", normal, rays[hit])
    slope = np.where(np.abs(slope) < 1e-12, 1e-12, slope)
    depth, slant = np.full(len(rays), np.inf), np.zeros(len(rays))
    depth[hit] = np.einsum("ij,ij->i", normal, corners[:, 0] - eye) / slope
    slant[hit] = np.abs(slope)
    return SolidHits(depth, slant)


def first_faces(eye: Array, rays: Array, vertices: Array, faces: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return the index of the first face that each ray hits, as an array of shape (m,).

    The index is -1 for a miss. The arguments are the same as for :func:`cast_mesh`.
    """
    corners = vertices[faces] - eye
    units = unit(rays)
    out = np.full(len(rays), -1, dtype=np.int64)
    todo = np.arange(len(rays))
    while len(todo):
        # A view frame covers only the directions in front of it; rays in all directions require several view frames.
        axis = unit(units[todo].mean(axis=0))
        if not (units[todo] @ axis > IN_FRONT).any():
            axis = units[todo[0]]
        side = unit(np.cross(np.eye(3)[int(np.argmin(np.abs(axis)))], axis))
        R_EV = np.column_stack([side, np.cross(axis, side), axis])
        local = turned(R_EV.T, units[todo])
        seen = local[:, 2] > IN_FRONT
        x, y, z = local[seen].T
        out[todo[seen]] = first_hits(turned(R_EV.T, corners), scattered_rays(x / z, y / z)).triangle
        todo = todo[~seen]
    return out


def _to_local(eye: Array, rays: Array, X_WO: Pose) -> tuple[Array, Array]:
    rotation = X_WO.rotation
    return (eye - X_WO.p) @ rotation, rays @ rotation


def _nearer(best: Array, slant: Array, depth: Array, cosine: Array) -> tuple[Array, Array]:
    """Return the nearest hit on each ray.

    The hits to compare are the previous hits, which have shape (m,), and the candidates on each edge, which have shape
    (k, m).
    """
    pick, column = np.argmin(depth, axis=0), np.arange(depth.shape[1])
    nearest = depth[pick, column]
    closer = nearest < best
    return np.where(closer, nearest, best), np.where(closer, cosine[pick, column], slant)
