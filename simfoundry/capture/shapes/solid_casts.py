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
PARALLEL = 1e-12  # smallest divisor: in place of it, rays that are parallel to a face or an axis have none
REACH_M = 1e-6  # [m] margin around a solid within which rays are cast at it: more than the rounding of their distances


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
    half = size / 2
    enter, leave, slant = np.full(len(rays), -np.inf), np.full(len(rays), np.inf), np.zeros(len(rays))
    for axis, direction in enumerate(directions.T.copy()):  # axis by axis: NumPy is slow along axes of length 3
        steep = np.abs(direction)
        safe = np.where(steep < PARALLEL, PARALLEL, direction)
        low, high = (-half[axis] - origin[axis]) / safe, (half[axis] - origin[axis]) / safe
        entry = np.minimum(low, high)
        slant = np.where(entry > enter, steep, slant)
        np.maximum(enter, entry, out=enter)
        np.minimum(leave, np.maximum(low, high), out=leave)
    hit = (enter <= leave) & (enter > 0)
    return SolidHits(np.where(hit, enter, np.inf), slant)


def cast_open_box(eye: Array, rays: Array, size: Array, wall: float, X_WO: Pose) -> SolidHits:
    """Cast rays against a box without a lid, with full extents ``size`` [m] and floor and walls of ``wall`` [m].

    The middle of its outside is at ``X_WO``. The camera must not be inside of it.
    """
    outside = cast_box(eye, rays, size, X_WO)
    origin, directions = _to_local(eye, rays, X_WO)
    half, inner = size / 2, size / 2 - wall
    known = np.where(np.isfinite(outside.depth), outside.depth, 0.0)
    at = origin + known[:, None] * directions
    enters = np.isfinite(outside.depth) & (np.abs(at[:, 2] - half[2]) < 1e-9) & (directions[:, 2] < 0)
    enters &= (np.abs(at[:, :2]) < inner[:2]).all(axis=1)
    # A ray that enters the opening ends where it leaves the cavity: at the floor or at a wall.
    leave, slant = np.full(len(rays), np.inf), np.zeros(len(rays))
    for axis, direction in enumerate(directions.T.copy()):
        bound = np.where(direction < 0, -inner[axis], inner[axis])
        safe = np.where(np.abs(direction) < PARALLEL, PARALLEL, direction)
        exit_at = np.where(np.abs(direction) < PARALLEL, np.inf, (bound - origin[axis]) / safe)
        slant = np.where(exit_at < leave, np.abs(direction), slant)
        np.minimum(leave, exit_at, out=leave)
    return SolidHits(np.where(enters, leave, outside.depth), np.where(enters, slant, outside.slant))


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


def cast_cylinder(eye: Array, rays: Array, radius: float, height: float, X_WO: Pose) -> SolidHits:
    """Cast rays against a solid cylinder about the local z axis, whose middle is at ``X_WO``.

    It takes a third of the time of :func:`cast_lathe`.
    """
    o, local = _to_local(eye, rays, X_WO)
    x, y, z = local.T.copy()
    steep = np.abs(z)
    middle, half = -o[2] / np.where(steep < PARALLEL, PARALLEL, z), height / 2 / np.maximum(steep, PARALLEL)
    a, b = np.maximum(x * x + y * y, PARALLEL), o[0] * x + o[1] * y
    square = b * b - a * (o[0] ** 2 + o[1] ** 2 - radius**2)
    root = np.sqrt(np.maximum(square, 0.0))
    through_end, through_side = middle - half, (-b - root) / a
    enter, leave = np.maximum(through_end, through_side), np.minimum(middle + half, (root - b) / a)
    hit = (square > 0) & (enter <= leave) & (enter > 0)
    return SolidHits(np.where(hit, enter, np.inf), np.where(through_end > through_side, steep, root / radius))


def cast_lathe(eye: Array, rays: Array, profile: Array, X_WO: Pose) -> SolidHits:
    """Cast rays against a surface of revolution about the local z axis.

    ``profile`` is a polyline of (radius, height) [m], given as an array of shape (k, 2). Each of its edges sweeps out a
    cone, a cylinder or a ring.
    """
    o, local = _to_local(eye, rays, X_WO)
    d = local.T.copy()
    near = np.flatnonzero(_may_hit(o, d, profile))
    d = d[:, near]
    is_ring = np.abs(np.diff(profile[:, 1])) < 1e-9
    best, slant = np.full(len(near), np.inf), np.zeros(len(near))
    start, end = profile[:-1], profile[1:]
    if not is_ring.all():
        best, slant = _cone_hits(o, d, start[~is_ring], end[~is_ring], best, slant)
    if is_ring.any():
        r0, r1, z0 = start[is_ring, 0][:, None], end[is_ring, 0][:, None], start[is_ring, 1][:, None]
        safe_dz = np.where(np.abs(d[2]) < PARALLEL, PARALLEL, d[2])
        t = (z0 - o[2]) / safe_dz
        radius = np.hypot(o[0] + t * d[0], o[1] + t * d[1])
        hit = (t > 1e-6) & (radius >= np.minimum(r0, r1)) & (radius <= np.maximum(r0, r1))
        _, nearest = _nearest(np.where(hit, t, np.inf))
        closer = nearest < best
        best, slant = np.where(closer, nearest, best), np.where(closer, np.abs(d[2]), slant)
    out = SolidHits(np.full(len(rays), np.inf), np.zeros(len(rays)))
    out.depth[near], out.slant[near] = best, slant
    return out


def _may_hit(o: Array, d: Array, profile: Array) -> NDArray[np.bool_]:
    """Return a mask of the local rays that pass through the cylinder around a profile, shape (m,)."""
    radius, low, high = profile[:, 0].max() + REACH_M, profile[:, 1].min() - REACH_M, profile[:, 1].max() + REACH_M
    a, b = d[0] * d[0] + d[1] * d[1], o[0] * d[0] + o[1] * d[1]
    a = np.maximum(a, PARALLEL)
    square = b * b - a * (o[0] ** 2 + o[1] ** 2 - radius**2)
    root = np.sqrt(np.maximum(square, 0.0))
    entry, leave = o[2] + d[2] * ((-b - root) / a), o[2] + d[2] * ((-b + root) / a)
    return np.asarray((square >= 0) & (np.minimum(entry, leave) <= high) & (np.maximum(entry, leave) >= low))


def _cone_hits(o: Array, d: Array, start: Array, end: Array, best: Array, slant: Array) -> tuple[Array, Array]:
    """Return the nearest hits of local rays on the cones that edges (radius, height) sweep out, or previous hits."""
    r0, z0, z1 = start[:, 0][:, None], start[:, 1][:, None], end[:, 1][:, None]
    slope = (end[:, 0][:, None] - r0) / (z1 - z0)
    # On the cone through an edge, |xy| = g + slope * z.
    g = r0 - slope * z0
    rho, w = g + slope * o[2], slope * d[2]
    a = d[0] ** 2 + d[1] ** 2 - w**2
    b = o[0] * d[0] + o[1] * d[1] - rho * w
    c = o[0] ** 2 + o[1] ** 2 - rho**2
    square = b * b - a * c
    exists, root = square > 0, np.sqrt(np.maximum(square, 0.0))
    safe_a = np.where(np.abs(a) < PARALLEL, PARALLEL, a)
    low, high = np.minimum(z0, z1), np.maximum(z0, z1)
    tilt = 1.0 / np.sqrt(1.0 + slope**2)[:, 0]
    for signed in (-root, root):
        t = (-b + signed) / safe_a
        z = o[2] + t * d[2]
        on_edge = exists & (t > 1e-6) & (z >= low) & (z <= high) & (rho + t * w >= 0)
        pick, nearest = _nearest(np.where(on_edge, t, np.inf))
        ray = np.flatnonzero(nearest < best)
        edge, t_ray, dx, dy, dz = pick[ray], nearest[ray], d[0, ray], d[1, ray], d[2, ray]
        x, y, radius = o[0] + t_ray * dx, o[1] + t_ray * dy, rho[edge, 0] + t_ray * w[edge, ray]
        cosine = tilt[edge] * ((x * dx + y * dy) / np.maximum(radius, 1e-9) - slope[edge, 0] * dz)
        best[ray], slant[ray] = t_ray, np.abs(cosine)
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


def _nearest(depth: Array) -> tuple[NDArray[np.intp], Array]:
    """Return the edge that each ray hits first, and the depth of the hit, given depths of shape (k, m)."""
    if len(depth) == 1:
        return np.zeros(depth.shape[1], dtype=np.intp), depth[0]
    pick = np.argmin(depth, axis=0)
    return pick, depth[pick, np.arange(depth.shape[1])]
