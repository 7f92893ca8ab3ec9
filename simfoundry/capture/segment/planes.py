"""Candidate support planes of a depth picture: seeded RANSAC among planes that could carry something."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simfoundry.capture.segment.noise import depth_sigma
from simfoundry.geometry.frames import Array

MAX_PLANES = 8  # candidates: table, floor, walls, shelves and box tops of a room
HYPOTHESES = 1500  # RANSAC draws: a plane of 10 % of the points is hit by local triples with 0.999
MAX_POINTS = 6000  # points that a hypothesis is tested on
SAMPLE, FINALISTS = 1200, 60  # points on which all hypotheses compete, and how many go on to all points
TOLERANCE = 3.0  # in standard deviations of the depth
STEEPEST_ROLL = 0.47  # tangent of the camera roll beyond which a plane is a wall beside it
ROLL_SLACK = 0.15  # what a normal may lean sideways however steeply the camera looks down
SMALLEST_SHARE = 0.01  # of all points


@dataclass(frozen=True, eq=False)
class Plane:
    """Points with ``normal @ p = offset`` in the camera frame [m]; the normal points to the camera's side."""

    normal: Array
    offset: float

    def height(self, points: Array) -> Array:
        """Signed distance [m] of camera-frame points, shape (..., 3), positive on the camera's side."""
        return np.asarray(points @ self.normal - self.offset)


def candidate_planes(points: Array, rng: np.random.Generator) -> list[Plane]:
    """The planes, largest first, that ``points`` (camera frame [m], shape (n, 3)) hold and that could be a table top.

    A plane qualifies if the camera is above it, with the camera's up direction not pointing below it, and if it is
    not seen edge-on sideways, as a wall beside the camera is. Walls straight ahead and tables straight below look
    alike to one camera; both are kept here.
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
    """The qualifying hypothesis with most inliers, nearer points counting more, as they cover less surface a pixel."""
    normals, offsets = _hypotheses(points, rng)
    if not len(normals):
        return None
    sample = points[:: max(1, len(points) // SAMPLE)]
    promising = np.argsort(-_support_of(sample, normals, offsets), kind="stable")[:FINALISTS]
    best = promising[int(np.argmax(_support_of(points, normals[promising], offsets[promising])))]
    return Plane(normals[best], float(offsets[best]))


def _support_of(points: Array, normals: Array, offsets: Array) -> Array:
    """The weight of the points that lie in each plane, shape (m,)."""
    tolerance = TOLERANCE * depth_sigma(points[:, 2])
    weight = 1.0 / points[:, 2]
    return np.concatenate(
        [
            (np.abs(points @ n.T - d) < tolerance[:, None]).T @ weight
            for n, d in zip(np.array_split(normals, 16), np.array_split(offsets, 16), strict=True)
        ]
    )


def _hypotheses(points: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Unit normals, shape (m, 3), and offsets, shape (m,), of qualifying planes through triples of nearby points."""
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
    away = offsets > 0  # the camera, at zero, must lie on the positive side
    normals[away], offsets[away] = -normals[away], -offsets[away]
    up = -normals[:, 1]
    plausible = (np.abs(normals[:, 0]) < ROLL_SLACK + STEEPEST_ROLL * np.maximum(up, 0)) & (up > -0.1)
    return normals[plausible], offsets[plausible]


def refine(plane: Plane, points: Array, rounds: int = 6) -> Plane:
    """Weighted least squares through the inliers among ``points`` [m], shape (n, 3), repeated as the inliers change."""
    for _ in range(rounds):
        sigma = depth_sigma(points[:, 2])
        residual = np.abs(plane.height(points)) / sigma
        # Tukey's weight: points of objects that begin at the surface fade out rather than pull it up.
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


def is_level(plane: Plane) -> bool:
    """Return whether a level camera could see this plane as a floor, neither straight ahead nor straight below."""
    return bool(plane.normal[1] < -0.3)
