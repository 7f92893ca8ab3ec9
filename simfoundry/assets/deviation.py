"""Measure how far convex parts or simplified meshes deviate from the original mesh."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.mass import Array, Faces

# Numbers of sample points on the mesh and on the parts; on a 20 cm object, mesh samples are about 1 mm apart.
ON_MESH, ON_PARTS = 20_000, 4_000

# Number of nearest samples whose triangles provide an upper bound on a point's distance.
NEIGHBORS = 8

# Batch size for exact distances, which are computed in the order of their bounds; few batches are needed.
TOGETHER = 256

# Margin [m] added to a bound so that rounding cannot exclude the triangle from which it was computed.
ROUNDING = 1e-12

# Number of mesh samples whose distance to the parts is computed; one in five is enough for 1% accuracy.
CHECKED = 4_000

# Gap between parts, relative to the longest side, below which they are treated as touching along a cut.
TOUCHING = 0.01


def deviation(vertices: Array, faces: Faces, parts: list[tuple[Array, Faces]]) -> float:
    """Return the maximum distance [m] between the surface of a mesh and the outer surface of convex parts.

    The distance is sampled with a fixed seed so that it is reproducible. It is measured in both directions: from points
    on the mesh that are outside all parts to the face planes of the nearest part, and from points on the outer surface
    of the parts to the mesh.
    """
    points, owner = surface_samples(vertices, faces, ON_MESH)
    planes = [face_planes(corners, sides) for corners, sides in parts]
    step = max(1, len(points) // CHECKED)
    short = distances_outside(points[::step], planes)
    outer = _outer(parts, planes, TOUCHING * float(np.ptp(vertices, axis=0).max()))
    return max(0.0, float(short.max()), _greatest_distance(outer, vertices[faces], points, owner))


def surface_samples(vertices: Array, faces: Faces, count: int) -> tuple[Array, NDArray[np.int64]]:
    """Sample points uniformly on a surface with a fixed seed.

    Returns:
        The points, shape (count, 3), and the index of the triangle that contains each point, shape (count,).
    """
    rng = np.random.default_rng(0)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    ends = np.cumsum(area)
    owner = np.minimum(np.searchsorted(ends, (np.arange(count) + 0.5) / count * ends[-1]), len(faces) - 1)
    u, v = rng.random((2, count))
    folded = u + v > 1
    u[folded], v[folded] = 1 - u[folded], 1 - v[folded]
    return a[owner] + u[:, None] * (b - a)[owner] + v[:, None] * (c - a)[owner], owner


def face_planes(corners: Array, sides: Faces) -> tuple[Array, Array]:
    """Return the planes of a convex part's faces.

    Returns:
        The outward unit normals, shape (n, 3), and the plane offsets [m], shape (n,).
    """
    a, b, c = (corners[sides[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    normal = normal[length > 0] / length[length > 0, None]
    return normal, np.einsum("ij,ij->i", normal, a[length > 0])


def distances_outside(points: Array, planes: list[tuple[Array, Array]]) -> Array:
    """Return the largest distance [m] from each point to a face plane of the nearest part, as an array of shape (n,).

    ``planes`` contains the result of :func:`face_planes` for each part. The distance is negative inside a part.
    """
    nearest = np.full(len(points), np.inf)
    for normal, offset in planes:
        nearest = np.minimum(nearest, (points @ normal.T - offset).max(axis=1))
    return nearest


def _outer(parts: list[tuple[Array, Faces]], planes: list[tuple[Array, Array]], touching: float) -> Array:
    """Sample points on the surfaces of parts, omitting points that are covered or touched by another part.

    The points are returned as an array of shape (n, 3).
    """
    found = []
    for k, (corners, sides) in enumerate(parts):
        points, _ = surface_samples(corners, sides, max(200, ON_PARTS // len(parts)))
        points = np.concatenate([points, corners])
        others = planes[:k] + planes[k + 1 :]
        found.append(points[distances_outside(points, others) > touching])
    return np.concatenate(found)


def _greatest_distance(points: Array, triangles: Array, samples: Array, owner: NDArray[np.int64]) -> float:
    """Return the maximum distance [m] from points to triangles, given samples on the triangles.

    The nearest samples provide upper bounds. Exact distances are computed in descending order of these bounds, until
    the next bound does not exceed the maximum found so far.
    """
    from scipy.spatial import cKDTree

    if not len(points):
        return 0.0
    _, near = cKDTree(samples).query(points, k=NEIGHBORS)
    rows = np.repeat(np.arange(len(points)), NEIGHBORS)
    bounds = _least_distances(points, triangles, rows, owner[near].ravel())
    centers = triangles.mean(axis=1)
    radii = np.linalg.norm(triangles - centers[:, None], axis=2).max(axis=1)
    tree, widest, greatest = cKDTree(centers), float(radii.max()), 0.0
    order = np.argsort(-bounds, kind="stable")
    for first in range(0, len(order), TOGETHER):
        some = order[first : first + TOGETHER]
        if bounds[some[0]] <= greatest:
            break
        found = tree.query_ball_point(points[some], bounds[some] + widest)
        rows = np.repeat(some, [len(each) for each in found])
        columns = np.concatenate([np.asarray(each, dtype=np.int64) for each in found])
        reached = np.linalg.norm(points[rows] - centers[columns], axis=1) <= bounds[rows] + radii[columns] + ROUNDING
        exact = _least_distances(points, triangles, rows[reached], columns[reached])[some]
        greatest = max(greatest, float(exact.max()))
    return greatest


def _least_distances(points: Array, triangles: Array, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> Array:
    """Return the distance [m] from each point to the nearest triangle with which it is paired.

    ``rows`` and ``columns`` list the indices of the point and the triangle in each pair. The distance is infinite for
    points without any pair.
    """
    import trimesh

    closest = trimesh.triangles.closest_point(triangles[columns], points[rows])
    least = np.full(len(points), np.inf)
    np.minimum.at(least, rows, np.linalg.norm(closest - points[rows], axis=1))
    return least


# Target number of triangles for simplified meshes.
#
# The YCB banana (16,384 triangles) then decomposes equally well in 0.6 s instead of 4.3 s.
ENOUGH_FACES = 4096

# Maximum deviation of a simplified mesh relative to its longest side; convex parts deviate ten times as much.
ALLOWED = 0.005

# Number of points on the original surface from which the deviation is measured.
SAMPLES = 20_000


def simplified(vertices: Array, faces: Faces, enough: int = ENOUGH_FACES) -> tuple[Array, Faces, float]:
    """Simplify a mesh to about ``enough`` triangles, or more if necessary to preserve its surface.

    The mesh is returned unchanged if it has at most ``enough`` triangles or if no sufficiently accurate simplification
    is found.

    Returns:
        The vertices, the faces, and the deviation from the original surface [m].
    """
    if len(faces) <= enough:
        return vertices, faces, 0.0
    import fast_simplification

    size = float(np.ptp(vertices, axis=0).max())
    points, _ = surface_samples(vertices, faces, SAMPLES)
    count = enough
    while count < len(faces) // 2:
        corners, sides = fast_simplification.simplify(vertices, faces, target_count=count)
        corners, sides = np.asarray(corners, dtype=np.float64), np.asarray(sides, dtype=np.int32)
        if len(sides):
            lost = _greatest_distance(points, corners[sides], *surface_samples(corners, sides, ON_MESH))
            if lost <= ALLOWED * size:
                return corners, sides, lost
        count *= 4
    return vertices, faces, 0.0
