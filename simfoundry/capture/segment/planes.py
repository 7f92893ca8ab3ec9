"""Find planes in a depth image with RANSAC."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simfoundry.capture.frame import depth_sigma
from simfoundry.capture.segment.masks import thinned
from simfoundry.geometry.frames import Array, Pose

MAX_PLANES = 8  # maximum number of candidates: a room has a table, floor, walls, shelves and box tops
HYPOTHESES = 1500  # RANSAC draws: local triples hit a plane with 10% of the points with a probability of 0.999
MAX_POINTS = 6000  # maximum number of points used for testing hypotheses
SAMPLE, FINALISTS = 1200, 60  # points used to test all hypotheses; hypotheses then tested on all points
TOLERANCE = 3.0  # inlier tolerance in standard deviations of the depth
STEEPEST_ROLL = 0.47  # tangent of the maximum camera roll; a plane tilted more than this is a wall beside the camera
ROLL_SLACK = 0.15  # sideways component of the normal that is always allowed, however steeply the camera looks down
SMALLEST_SHARE = 0.01  # minimum fraction of all points in a plane


@dataclass(frozen=True, eq=False)
class Plane:
    """The plane ``normal @ p = offset`` in the camera frame [m].

    The normal points toward the camera.
    """

    normal: Array
    offset: float

    def height(self, points: Array) -> Array:
        """Return the signed distance of points from the plane [m].

        The points are in the camera frame and have shape (..., 3). The distance is positive toward the camera.
        """
        return np.asarray(points @ self.normal - self.offset)


def candidate_planes(points: Array, rng: np.random.Generator) -> list[Plane]:
    """Return the planes through ``points`` that could be a tabletop, starting with the largest one.

    The points are in the camera frame [m] and have shape (n, 3). A plane qualifies if the camera is above it, the
    camera's up direction does not point below it, and it is not seen edge-on from the side, like a wall beside the
    camera. A single camera cannot distinguish a wall straight ahead from a table straight below, so both of them
    qualify.
    """
    rest = points[rng.choice(len(points), min(len(points), MAX_POINTS), replace=False)]
    fewest = max(30, int(SMALLEST_SHARE * len(rest)))
    planes = []
    for _ in range(MAX_PLANES):
        if len(rest) < fewest:
            break
        plane = _best_plane(rest, rng)
        if plane is None:
            break
        inlier = np.abs(plane.height(rest)) < TOLERANCE * depth_sigma(rest[:, 2])
        if inlier.sum() < fewest:
            break
        planes.append(refine(plane, rest))
        rest = rest[~(np.abs(planes[-1].height(rest)) < TOLERANCE * depth_sigma(rest[:, 2])) & ~inlier]
    return planes


def _best_plane(points: Array, rng: np.random.Generator) -> Plane | None:
    """Return the qualifying hypothesis with the most inliers, weighted by proximity.

    Nearer points have more weight because each of their pixels covers less surface. The result is None if no hypothesis
    qualifies.
    """
    normals, offsets = _hypotheses(points, rng)
    if not len(normals):
        return None
    sample = thinned(points, SAMPLE)
    promising = np.argsort(-_support_of(sample, normals, offsets), kind="stable")[:FINALISTS]
    best = promising[int(np.argmax(_support_of(points, normals[promising], offsets[promising])))]
    return Plane(normals[best], float(offsets[best]))


def _support_of(points: Array, normals: Array, offsets: Array) -> Array:
    """Return the total weight of the points in each plane, as an array of shape (m,)."""
    tolerance = TOLERANCE * depth_sigma(points[:, 2])
    weight = 1.0 / points[:, 2]
    parts = zip(np.array_split(normals, 16), np.array_split(offsets, 16), strict=True)
    return np.concatenate([(np.abs(points @ n.T - d) < tolerance[:, None]).T @ weight for n, d in parts])


def _hypotheses(points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Sample triples of nearby points, and return the qualifying planes through them.

    Returns:
        Unit normals, as an array of shape (m, 3), and offsets [m], as an array of shape (m,).
    """
    from scipy.spatial import cKDTree

    pixels = points[:, :2] / points[:, 2:]
    seeds = rng.integers(len(points), size=HYPOTHESES)
    _, near = cKDTree(pixels).query(pixels[seeds], k=min(len(points), max(60, len(points) // 40)))
    columns = rng.integers(near.shape[1], size=(HYPOTHESES, 2))
    a = points[seeds]
    b = points[near[np.arange(HYPOTHESES), columns[:, 0]]]
    c = points[near[np.arange(HYPOTHESES), columns[:, 1]]]
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    ok = length > 1e-6
    normals, a = normals[ok] / length[ok, None], a[ok]
    offsets = np.einsum("ij,ij->i", normals, a)
    away = offsets > 0  # the camera, located at the origin, must be on the positive side
    normals[away], offsets[away] = -normals[away], -offsets[away]
    up = -normals[:, 1]
    plausible = (np.abs(normals[:, 0]) < ROLL_SLACK + STEEPEST_ROLL * np.maximum(up, 0)) & (up > -0.1)
    return normals[plausible], offsets[plausible]


def refine(plane: Plane, points: Array, rounds: int = 6) -> Plane:
    """Refit ``plane`` to its inliers among ``points`` by iteratively reweighted least squares.

    The points [m] have shape (n, 3).
    """
    for _ in range(rounds):
        sigma = depth_sigma(points[:, 2])
        residual = np.abs(plane.height(points)) / sigma
        # Tukey's biweight: points near the bottom of objects are gradually downweighted so as not to pull the plane up.
        weight = np.where(residual < TOLERANCE, (1 - (residual / TOLERANCE) ** 2) ** 2, 0.0) / sigma**2
        if np.count_nonzero(weight) < 10:
            return plane
        center = weight @ points / weight.sum()
        moment = (points - center).T @ ((points - center) * weight[:, None])
        normal = np.linalg.eigh(moment)[1][:, 0]
        if normal @ center > 0:
            normal = -normal
        plane = Plane(np.asarray(normal), float(normal @ center))
    return plane


def world_on(plane: Plane) -> Pose:
    """Return the camera pose ``X_WC`` in a world frame on ``plane``.

    The origin is straight below the camera, and x points along its viewing direction, or along the image's up direction
    if the camera looks straight down.
    """
    z = plane.normal
    x = np.array([0.0, 0.0, 1.0]) - z[2] * z
    if np.linalg.norm(x) < 0.2:
        x = np.array([0.0, -1.0, 0.0]) + z[1] * z
    x = x / np.linalg.norm(x)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([x, np.cross(z, x), z])
    matrix[2, 3] = -plane.offset
    return Pose.from_matrix(matrix)
