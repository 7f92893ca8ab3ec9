"""Search for the supporting surface of the objects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import CaptureError, Frame, SupportSurface, depth_sigma, valid_depth
from simfoundry.capture.segment.outline import TopView, polygon_of, top_view
from simfoundry.capture.segment.regions import normals_of, tangents
from simfoundry.geometry.frames import Array, Pose

TALLEST = 0.35  # [m] height up to which an object counts as standing on a plane; tables are higher above the floor
DENSE = 0.5  # share of a surface's surroundings that must be the surface too; less is chance
CROSSING = 0.6  # cosine of the angle between a surface and a plane from which on it crosses rather than joins it
SURVEY_WIDTH = 240  # [px] of the picture on which candidates are compared
MIN_POINTS = 50  # pixels of a plane worth considering
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class _View:
    """A depth picture with its points and normals in the camera frame; normals are NaN where depth is sparse."""

    depth: Array
    K: Array
    points: Array
    normals: Array


@dataclass(frozen=True, eq=False)
class _Surface:
    X_WC: Pose
    inliers: Mask
    plan: TopView
    score: float


def find_support(frame: Frame) -> SupportSurface:
    """Find the support of the objects in ``frame``, and the world frame on it.

    The origin is the centroid of the visible surface, z is the plane's normal toward the camera, x is the camera's
    viewing direction along the plane (its up direction if it looks straight down), y is to the left.

    Of all planes that could be a table top, the support is the one with the most objects and surface in view, weighted
    by nearness. A box with another on it loses against the table below, because the table carries both; the floor
    loses because it is far, and the objects on a table stand higher above it than objects are tall.
    Raises :class:`CaptureError` (``no-depth``, ``depth-unit``, ``no-plane``).
    """
    depth = np.where(valid_depth(frame.depth), frame.depth, np.nan)
    small = _view(depth, frame.K, step=max(1, depth.shape[1] // SURVEY_WIDTH))
    points = small.points[np.isfinite(small.depth)]
    planes = candidate_planes(points, np.random.default_rng(0)) if len(points) >= MIN_POINTS else []
    found = [(s.score, plane, s.plan, s.X_WC) for plane in planes if (s := _survey(small, plane, 0.01)) is not None]
    while found:
        best = max(range(len(found)), key=lambda i: found[i][0])
        _, plane, plan, X_WC = found.pop(best)
        support = _measured(_view(depth, frame.K), plane, plan, X_WC)
        if support is not None:
            return support
    raise CaptureError(
        "SF503",
        "no flat surface is seen from above that objects could stand on",
        "show at least a hand's breadth of the table top around the objects, with the camera upright above it",
    )


def world_on(plane: Plane) -> Pose:
    """``X_WC`` of a camera above ``plane``: the origin right below the camera, x along its viewing direction."""
    z = plane.normal
    x = np.array([0.0, 0.0, 1.0]) - z[2] * z
    if np.linalg.norm(x) < 0.2:
        x = np.array([0.0, -1.0, 0.0]) + z[1] * z
    x = x / np.linalg.norm(x)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([x, np.cross(z, x), z])
    matrix[2, 3] = -plane.offset
    return Pose.from_matrix(matrix)


def _view(depth: Array, K: Array, step: int = 1) -> _View:
    """Subsample a depth picture by ``step``."""
    import cv2

    small, reduced = depth[::step, ::step], np.array(K, dtype=np.float64)
    reduced[:2] /= step
    frame = Frame(np.zeros((*small.shape, 3), np.uint8), small, reduced)
    radius = max(2, round(small.shape[1] / 160))
    normals = normals_of(tangents(small, radius, 1 + (radius - 1) // 2), reduced)
    dense = cv2.blur(np.isfinite(small).astype(np.float32), (2 * radius + 1, 2 * radius + 1)) > 0.9
    return _View(small, reduced, frame.points, np.where(dense[..., None], normals, np.nan))


def _on_plane(view: _View, plane: Plane) -> Mask:
    """Pixels within the noise of the plane, except where a surface crosses it, as a chair's back does."""
    near = np.abs(plane.height(view.points)) < TOLERANCE * depth_sigma(view.depth)
    return np.asarray(near & ~(np.abs(view.normals @ plane.normal) < CROSSING))


def _survey(view: _View, plane: Plane, finest: float) -> _Surface | None:
    """Find the visible surface of ``plane`` and score it as the support."""
    X_WC = world_on(plane)
    points_W = X_WC.apply(view.points)
    inliers = _on_plane(view, plane)
    tolerance = TOLERANCE * depth_sigma(view.depth)
    hidden = ~np.isfinite(view.depth) | (points_W[..., 2] > tolerance)
    plan = top_view(inliers, hidden, X_WC, view.K, points_W, finest)
    if plan is None:
        return None
    above = plan.contains(points_W[..., :2])
    inliers = inliers & above
    if inliers.sum() < 10 or _density(inliers, view.depth) < DENSE:
        return None
    carried = above & (points_W[..., 2] > 2 * tolerance) & (points_W[..., 2] < TALLEST)
    return _Surface(X_WC, inliers, plan, _score(int(carried.sum()), view.depth[inliers], plane))


def _score(carried: int, depths: Array, plane: Plane) -> float:
    """Score of a plane as the support, from the ``carried`` pixels above it and its own pixels' ``depths`` [m].

    The objects on it count first, then its own area if there are any: a floor that fills the picture but has
    nothing on it is no support. Near pixels count more, because the subject of a picture is near.
    """
    area = len(depths)
    amount = carried + 0.5 * min(area, 4 * carried) + 0.02 * area
    return amount / float(np.median(depths)) ** 2 * (1.0 if is_level(plane) else 0.3)


def _density(inliers: Mask, depth: Array) -> float:
    """The mean share of inliers among the valid pixels within 2 px of an inlier."""
    import cv2

    of_plane = cv2.blur(inliers.astype(np.float32), (5, 5))[inliers]
    valid = cv2.blur(np.isfinite(depth).astype(np.float32), (5, 5))[inliers]
    return float(np.mean(of_plane / valid))


def _measured(view: _View, plane: Plane, plan: TopView, X_WC: Pose) -> SupportSurface | None:
    """Refine a plane on the pixels of its own connected surface ``plan``, and take the outline, at full resolution."""
    on_surface = plan.contains(X_WC.apply(view.points)[..., :2])
    for _ in range(2):
        points = view.points[_on_plane(view, plane) & on_surface]
        if len(points) < MIN_POINTS:
            return None
        plane = refine(plane, points[:: max(1, len(points) // 60000)])
    surface = _survey(view, plane, finest=0.005)
    if surface is None:
        return None
    points_W = surface.X_WC.apply(view.points[surface.inliers])
    center = np.append(points_W[:, :2].mean(axis=0), 0.0)
    residual = float(np.median(np.abs(points_W[:, 2])))
    X_WC = Pose.of(surface.X_WC.p - center, surface.X_WC.q)
    return SupportSurface(X_WC, polygon_of(surface.plan) - center[:2], residual, surface.inliers)


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
