"""Search for the supporting surface of the objects: candidate planes by RANSAC, and the visible outline of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simfoundry.capture.frame import CaptureError, Frame, SupportSurface, depth_sigma
from simfoundry.capture.segment.masks import Mask, Plan, closed, components, disk, filled, opened, simplified, thinned
from simfoundry.capture.segment.regions import normals_of, tangents
from simfoundry.geometry.frames import Array, Pose

TALLEST = 0.35  # [m] height up to which an object counts as standing on a plane; tables are higher above the floor
DENSE = 0.5  # share of a surface's surroundings that must be the surface too; less is chance
CROSSING = 0.6  # cosine of the angle between a surface and a plane from which on it crosses rather than joins it
SURVEY_WIDTH = 240  # [px] of the picture on which candidates are compared
MIN_POINTS = 50  # pixels of a plane worth considering
MAX_PLANES = 8  # candidates: table, floor, walls, shelves and box tops of a room
HYPOTHESES = 1500  # RANSAC draws: a plane of 10 % of the points is hit by local triples with 0.999
MAX_POINTS = 6000  # points that a hypothesis is tested on
SAMPLE, FINALISTS = 1200, 60  # points on which all hypotheses compete, and how many go on to all points
TOLERANCE = 3.0  # in standard deviations of the depth
STEEPEST_ROLL = 0.47  # tangent of the camera roll beyond which a plane is a wall beside it
ROLL_SLACK = 0.15  # what a normal may lean sideways however steeply the camera looks down
SMALLEST_SHARE = 0.01  # of all points
MAX_CELLS = 700  # cells along the longer side of a plan: 5 mm on a table of 3.5 m
COARSE, FINE = 0.01, 0.005  # [m] cells of a plan when planes are compared, and for the result
OUTLINE_TOLERANCE = 0.01  # [m] of the simplified outline
SHADOW = 0.25  # [m] the widest strip behind an object across which two seen parts are one surface


@dataclass(frozen=True, eq=False)
class Plane:
    """Points with ``normal @ p = offset`` in the camera frame [m]; the normal points to the camera's side."""

    normal: Array
    offset: float

    def height(self, points: Array) -> Array:
        """Signed distance [m] of camera-frame points, shape (..., 3), positive on the camera's side."""
        return np.asarray(points @ self.normal - self.offset)


@dataclass(frozen=True, eq=False)
class _View:
    """A depth picture with its points and normals in the camera frame; normals are NaN where depth is sparse."""

    depth: Array
    K: Array
    points: Array
    normals: Array


@dataclass(frozen=True, eq=False)
class _Surface:
    """The visible surface of a plane: its pixels, its plan in the world ``X_WC``, and its score as the support."""

    plane: Plane
    X_WC: Pose
    inliers: Mask
    plan: Plan
    score: float


def find_support(frame: Frame) -> SupportSurface:
    """Find the support of the objects in ``frame``, and the world frame on it.

    The origin is the centroid of the visible surface, z is the plane's normal toward the camera, x is the camera's
    viewing direction along the plane (its up direction if it looks straight down), y is to the left.

    Of all planes that could be a table top, the support is the one with the most objects and surface in view, weighted
    by nearness. A box with another on it loses against the table below, because the table carries both; the floor
    loses because it is far, and the objects on a table stand higher above it than objects are tall.
    Raises :class:`CaptureError` if the depth is unusable or no plane is found.
    """
    frame = frame.cleaned()
    small = _view(frame, step=max(1, frame.depth.shape[1] // SURVEY_WIDTH))
    points = small.points[np.isfinite(small.depth)]
    planes = candidate_planes(points, np.random.default_rng(0)) if len(points) >= MIN_POINTS else []
    found = [surface for plane in planes if (surface := _survey(small, plane, COARSE)) is not None]
    for surface in sorted(found, key=lambda surface: -surface.score):
        support = _measured(_view(frame), surface)
        if support is not None:
            return support
    raise CaptureError(
        "SF503",
        "no flat surface is seen from above that objects could stand on",
        "show at least a hand's breadth of the table top around the objects, with the camera upright above it",
    )


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
    sample = thinned(points, SAMPLE)
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


def _view(frame: Frame, step: int = 1) -> _View:
    """Subsample a depth picture by ``step``."""
    import cv2

    K = np.array(frame.K, dtype=np.float64)
    K[:2] /= step
    small = Frame(frame.color[::step, ::step], frame.depth[::step, ::step], K)
    radius = max(2, round(small.depth.shape[1] / 160))
    normals = normals_of(tangents(small.depth, radius, 1 + (radius - 1) // 2), K)
    dense = cv2.blur(np.isfinite(small.depth).astype(np.float32), (2 * radius + 1, 2 * radius + 1)) > 0.9
    return _View(small.depth, K, small.points, np.where(dense[..., None], normals, np.nan))


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
    plan = _plan_of(inliers, hidden, X_WC, view.K, points_W, finest)
    if plan is None:
        return None
    above = plan.contains(points_W[..., :2])
    inliers = inliers & above
    if inliers.sum() < 10 or _density(inliers, view.depth) < DENSE:
        return None
    carried = above & (points_W[..., 2] > 2 * tolerance) & (points_W[..., 2] < TALLEST)
    return _Surface(plane, X_WC, inliers, plan, _score(int(carried.sum()), view.depth[inliers], plane))


def _score(carried: int, depths: Array, plane: Plane) -> float:
    """Score of a plane as the support, from the ``carried`` pixels above it and its own pixels' ``depths`` [m].

    The objects on it count first, then its own area if there are any: a floor that fills the picture but has
    nothing on it is no support. Near pixels count more, because the subject of a picture is near.
    """
    area = len(depths)
    # A level camera could see a plane of weight 1 as a floor, neither straight ahead nor straight below.
    amount = carried + 0.5 * min(area, 4 * carried) + 0.02 * area
    return amount / float(np.median(depths)) ** 2 * (1.0 if plane.normal[1] < -0.3 else 0.3)


def _density(inliers: Mask, depth: Array) -> float:
    """The mean share of inliers among the valid pixels within 2 px of an inlier."""
    import cv2

    of_plane = cv2.blur(inliers.astype(np.float32), (5, 5))[inliers]
    valid = cv2.blur(np.isfinite(depth).astype(np.float32), (5, 5))[inliers]
    return float(np.mean(of_plane / valid))


def _measured(view: _View, found: _Surface) -> SupportSurface | None:
    """Refine a plane on the pixels of its own connected surface, and take the outline, at full resolution."""
    plane = found.plane
    on_surface = found.plan.contains(found.X_WC.apply(view.points)[..., :2])
    for _ in range(2):
        points = view.points[_on_plane(view, plane) & on_surface]
        if len(points) < MIN_POINTS:
            return None
        plane = refine(plane, thinned(points, 60000))
    surface = _survey(view, plane, FINE)
    if surface is None:
        return None
    points_W = surface.X_WC.apply(view.points[surface.inliers])
    center = np.append(points_W[:, :2].mean(axis=0), 0.0)
    residual = float(np.median(np.abs(points_W[:, 2])))
    X_WC = Pose.of(surface.X_WC.p - center, surface.X_WC.q)
    return SupportSurface(X_WC, polygon_of(surface.plan) - center[:2], residual, surface.inliers)


def _plan_of(inliers: Mask, hidden: Mask, X_WC: Pose, K: Array, points_W: Array, finest: float) -> Plan | None:
    """The largest connected surface of ``inliers``, with what objects hide of it closed; None if there is none.

    ``inliers`` marks the plane's pixels and ``hidden`` those whose ray does not reach the plane (an object is in
    front, or there is no reading); every other ray passes the plane, so there is no surface there. ``points_W`` are
    the picture's points in the world [m], shape (h, w, 3).
    """
    import cv2

    xy = points_W[inliers][:, :2]
    if len(xy) < 10:
        return None
    lo, hi = np.quantile(xy, 0.002, axis=0) - 0.03, np.quantile(xy, 0.998, axis=0) + 0.03
    cell = max(finest, float((hi - lo).max()) / MAX_CELLS)
    columns, rows = (np.ceil((hi - lo) / cell).astype(int) + 1).tolist()
    to_pixel = _pixel_of_cell(X_WC, K, lo, cell)

    def cells(length: float) -> int:
        return max(1, round(length / cell))

    def seen_from_above(mask: Mask) -> Mask:
        # Linear weights, so that a border thinner than a cell does not vanish.
        picture = mask.astype(np.float32)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpPerspective(picture, to_pixel, (columns, rows), flags=flags) > 0.5)

    surface, unseen = seen_from_above(inliers), seen_from_above(hidden)
    # Specks up to 1 cm where the plane seems missing are noise of the sensor rather than holes in a table.
    specks = closed(surface, cells(0.005))
    surface = closed(surface, cells(0.015)) & (surface | unseen | specks)
    main = _largest(surface | (unseen & closed(surface, cells(SHADOW / 2))), surface)
    if main is None:
        return None
    seen = surface & main
    hull = cv2.convexHull(np.argwhere(seen)[:, ::-1].astype(np.int32))
    whole = filled(seen | (unseen & (cv2.fillConvexPoly(np.zeros(seen.shape, np.uint8), hull, 1) > 0)))
    smooth = _largest(opened(whole, disk(cells(0.01))), whole)
    return None if smooth is None else Plan(filled(smooth), lo, cell)


def polygon_of(plan: Plan) -> Array:
    """The plan's boundary in world xy [m], shape (n, 2): counter-clockwise, simple, few vertices."""
    import cv2
    from shapely.geometry import Polygon

    # Doubled and padded, the contour runs along the cells' borders instead of through their centers.
    fine = np.pad(np.kron(plan.mask, np.ones((2, 2), bool)), 1).astype(np.uint8)
    contours, _ = cv2.findContours(fine, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    contour = max(contours, key=cv2.contourArea)[:, 0, :].astype(np.float64)
    whole = Polygon(((contour - 1.5) / 2 + 0.25) * plan.cell + plan.corner).buffer(0)
    polygon = max(getattr(whole, "geoms", [whole]), key=lambda part: part.area)
    simple = simplified(polygon, OUTLINE_TOLERANCE, growth=1.3)
    ring = np.asarray(simple.exterior.coords)[:-1]
    return ring if simple.exterior.is_ccw else ring[::-1].copy()


def _pixel_of_cell(X_WC: Pose, K: Array, corner: Array, cell: float) -> Array:
    """Homography, shape (3, 3), from plan cells (column, row, 1) to pixels (u, v, 1)."""
    X_CW = X_WC.inverse()
    plane = np.column_stack([X_CW.rotation[:, 0], X_CW.rotation[:, 1], X_CW.p])
    cells = np.array([[cell, 0, corner[0]], [0, cell, corner[1]], [0, 0, 1]])
    return np.asarray(K @ plane @ cells)


def _largest(mask: Mask, measured: Mask) -> Mask | None:
    """The connected part of ``mask`` that holds most of ``measured``; None if the mask is empty."""
    labels, areas = components(mask)
    sizes = np.bincount(labels[measured], minlength=len(areas))[1:]
    return np.asarray(labels == 1 + int(np.argmax(sizes))) if len(sizes) else None
