"""Find the surface that supports the objects.

Candidate planes are found with RANSAC.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from simfoundry.capture.frame import CaptureError, Frame, SupportLevel, SupportRival, SupportSurface, depth_sigma
from simfoundry.capture.segment.levels import carries_objects
from simfoundry.capture.segment.masks import Mask, Plan, closed, components, disk, filled, opened, simplified, thinned
from simfoundry.capture.segment.planes import TOLERANCE, Plane, candidate_planes, refine, world_on
from simfoundry.capture.segment.regions import normals_of, tangents
from simfoundry.capture.segment.support_evidence import carried_pixels
from simfoundry.geometry.frames import Array, Pose, frozen_array
from simfoundry.spec.models.capture import SupportChoice

DENSE = 0.5  # minimum mean fraction of inliers within 2 px of an inlier; lower values occur by chance
CROSSING = 0.6  # minimum cosine between surface and plane normals; below this, the surface crosses the plane
FACING = 0.88  # minimum median of this cosine on a surface: 0.95 to 1.0 on real and synthetic tables, 0.71 on a cut
SURVEY_WIDTH = 240  # [px] width of the image used for comparing candidates
MIN_POINTS = 50  # minimum number of pixels in a plane
MAX_CELLS = 700  # maximum number of cells along the longer side of a plan: 5 mm cells on a table of 3.5 m
COARSE, FINE = 0.01, 0.005  # [m] cell size of a plan when comparing planes, and in the result
OUTLINE_TOLERANCE = 0.01  # [m] tolerance of the simplified outline
RIVAL = 0.1  # minimum evidence for another surface, relative to the best one, that is kept
AROUND = 4  # [px] radius around a stated pixel, in the survey's image, in which the plane is fitted
PARALLEL = 0.97  # minimum cosine between the normals of two level surfaces: noise and sagging turn one by 10 degrees
LEVEL = 0.995  # minimum cosine between the normals of levels on which objects stand: noise turns one by 5 degrees
ONE_LEVEL = 0.03  # [m] maximum distance of planes through the same surface, which is not flat
SHADOW = 0.25  # [m] maximum width of the hidden strip behind an object that is bridged to connect two visible parts


@dataclass(frozen=True, eq=False)
class _View:
    """A depth image with points and normals in the camera frame.

    Normals are NaN where depth is sparse.
    """

    depth: Array
    K: Array
    points: Array
    normals: Array


@dataclass(frozen=True, eq=False)
class _Surface:
    """The visible surface of a plane.

    It consists of its pixels, its plan in the world frame of ``X_WC``, and its score as the support.
    """

    plane: Plane
    X_WC: Pose
    inliers: Mask
    plan: Plan
    score: float


def find_support(frame: Frame) -> SupportSurface:
    """Find the surface that supports the objects in ``frame``, and define a world frame on it.

    The origin is the centroid of the visible surface, and z is the plane's normal toward the camera. x is the camera's
    viewing direction projected onto the plane (the image's up direction if the camera looks straight down), and y
    points to the left.

    Among all planes that could be a tabletop, the support is the one with the most objects and visible surface,
    weighted by proximity. A box with another box on top scores lower than the table below because the table supports
    both. The floor scores lower because it is farther away and the objects on a table are too high above the floor to
    count as standing on it.

    A person's choice in ``frame.support`` takes precedence over all evidence.

    Raises:
        CaptureError: The depth is unusable, or no plane is found.
    """
    chosen = frame.support
    frame = frame.cleaned()
    step = max(1, frame.depth.shape[1] // SURVEY_WIDTH)
    small = _view(frame, step)
    if chosen is not None:
        return _chosen(frame, small, step, chosen)
    points = small.points[np.isfinite(small.depth)]
    planes = candidate_planes(points, np.random.default_rng(0)) if len(points) >= MIN_POINTS else []
    found = [surface for plane in planes if (surface := _survey(small, plane, COARSE)) is not None]
    ranked = sorted(found, key=lambda surface: -surface.score)
    for k, surface in enumerate(ranked):
        support = _measured(_view(frame), surface)
        if support is not None:
            others = [(other, _rival(surface, other, small, step)) for other in ranked[k + 1 :]]
            rivals = tuple(rival for _, rival in others if rival.share > RIVAL)
            carrying = (other for other, rival in others if carries_objects(rival))
            return replace(support, rivals=rivals, levels=_levels(frame, support, carrying))
    hint = "show at least 10 cm of the tabletop around the objects, and hold the camera upright above it"
    raise CaptureError("SF503", "could not find a flat surface, seen from above, that objects could stand on", hint)


def _chosen(frame: Frame, small: _View, step: int, choice: SupportChoice) -> SupportSurface:
    """Return the surface that a person stated.

    Raises:
        CaptureError: There is no surface at the stated pixel or plane.
    """
    points = small.points[np.isfinite(small.depth)]
    if choice.plane is not None:
        normal, offset = np.array(choice.plane[:3]), choice.plane[3]
        length = float(np.linalg.norm(normal)) * (1 if offset < 0 else -1)  # toward the camera, which is at the origin
        plane = Plane(normal / length, offset / length)
        where = "in the stated plane"
    else:
        assert choice.pixel is not None
        u, v = (x // step for x in choice.pixel)
        where = f"at the pixel {list(choice.pixel)}"
        around = small.points[max(0, v - AROUND) : v + AROUND + 1, max(0, u - AROUND) : u + AROUND + 1]
        near = around[np.isfinite(around[..., 2])]
        if len(near) < AROUND**2:
            raise CaptureError("SF503", f"there is no depth {where}", "state another pixel on the bare surface")
        center = near.mean(axis=0)
        normal = np.linalg.eigh((near - center).T @ (near - center))[1][:, 0]
        normal = normal if normal @ center < 0 else -normal
        plane = Plane(normal, float(normal @ center))
        plane = refine(plane, near)
    surface = _survey(small, refine(plane, points), COARSE) or _survey(small, plane, COARSE)
    support = None if surface is None else _measured(_view(frame), surface)
    if support is None:
        raise CaptureError("SF503", f"there is no flat surface {where}", "state a pixel on the bare surface")
    return support


def _rival(best: _Surface, other: _Surface, view: _View, step: int) -> SupportRival:
    """Return what is known about a surface that was not chosen."""
    rows, columns = np.nonzero(other.inliers)
    middle = int(np.argmin((rows - np.median(rows)) ** 2 + (columns - np.median(columns)) ** 2))
    height = float(np.median(best.X_WC.apply(view.points[other.inliers])[:, 2]))
    area = float(other.plan.mask.sum() * other.plan.cell**2)
    pixel = int(columns[middle]) * step, int(rows[middle]) * step
    return SupportRival(other.score / max(best.score, 1e-9), height, area, pixel, _carried_apart(best, other, view))


def _levels(frame: Frame, support: SupportSurface, carrying: Iterable[_Surface]) -> tuple[SupportLevel, ...]:
    """Return surfaces as levels of the support, without those that are not level or that are seen twice."""
    out: list[SupportLevel] = []
    for surface in carrying:
        found = _measured(_view(frame), surface)
        if found is None:
            continue
        X_WL = support.X_WC @ found.X_WC.inverse()
        outline = X_WL.apply(np.column_stack([found.outline, np.zeros(len(found.outline))]))
        height = float(np.median(support.X_WC.apply(frame.points_of(found.inliers))[:, 2]))
        level = SupportLevel(height, frozen_array(outline[:, :2]), found.inliers)
        if X_WL.rotation[2, 2] > LEVEL and not any(abs(height - other.height) < ONE_LEVEL for other in out):
            out.append(level)
    return tuple(out)


def _carried_apart(best: _Surface, other: _Surface, view: _View) -> float:
    """Return the visible area [m²] of what stands on a surface and is not above the chosen one.

    It is 0 if the surfaces are not parallel.
    """
    if best.plane.normal @ other.plane.normal < PARALLEL:
        return 0.0
    on_best, on_other = (surface.X_WC.apply(view.points) for surface in (best, other))
    tolerance = TOLERANCE * depth_sigma(view.depth)
    taken = best.plan.contains(on_best[..., :2]) & (on_best[..., 2] > -tolerance)
    raised = other.plan.contains(on_other[..., :2]) & (on_other[..., 2] > 2 * tolerance) & ~taken
    if not raised.any():
        return 0.0
    share = carried_pixels(view.depth, raised, on_other) / int(raised.sum())
    return share * float((view.depth[raised] ** 2).sum() / (view.K[0, 0] * view.K[1, 1]))


def _view(frame: Frame, step: int = 1) -> _View:
    """Subsample a depth image by ``step``, and compute the points and normals of its pixels."""
    import cv2

    K = np.array(frame.K, dtype=np.float64)
    K[:2] /= step
    small = Frame(frame.color[::step, ::step], frame.depth[::step, ::step], K)
    radius = max(2, round(small.depth.shape[1] / 160))
    normals = normals_of(tangents(small.depth, radius, 1 + (radius - 1) // 2), K)
    dense = cv2.blur(np.isfinite(small.depth).astype(np.float32), (2 * radius + 1, 2 * radius + 1)) > 0.9
    return _View(small.depth, K, small.points, np.where(dense[..., None], normals, np.nan))


def _on_plane(view: _View, plane: Plane) -> Mask:
    """Return a mask of the pixels on the plane.

    Surfaces that cross the plane, such as the back of a chair, are excluded.
    """
    near = np.abs(plane.height(view.points)) < TOLERANCE * depth_sigma(view.depth)
    return np.asarray(near & ~(np.abs(view.normals @ plane.normal) < CROSSING))


def _survey(view: _View, plane: Plane, finest: float) -> _Surface | None:
    """Find the visible surface of ``plane`` and compute its score as the support.

    The result is None if the plane has no surface.
    """
    import cv2

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
    of_plane, valid = (
        cv2.blur(mask.astype(np.float32), (5, 5))[inliers] for mask in (inliers, np.isfinite(view.depth))
    )
    if inliers.sum() < 10 or float(np.mean(of_plane / valid)) < DENSE:
        return None
    # Objects on the plane count most. Its own area counts only in proportion to them, because a floor that fills the
    # image but has nothing on it is not a support. Near pixels have more weight because the subject of an image is
    # usually close to the camera. A plane that an upright camera would see as a wall straight ahead has less weight.
    area = int(inliers.sum())
    carried = carried_pixels(view.depth, above & (points_W[..., 2] > 2 * tolerance), points_W)
    amount = carried + 0.5 * min(area, 4 * carried) + 0.02 * area
    score = amount / float(np.median(view.depth[inliers])) ** 2 * (1.0 if plane.normal[1] < -0.3 else 0.3)
    # A plane that cuts off the edge of a chest meets its top and its front along lines, and has the rest of it on top.
    facing = np.abs(view.normals[inliers] @ plane.normal)
    facing = facing[np.isfinite(facing)]
    score *= 0.1 if len(facing) and float(np.median(facing)) < FACING else 1.0
    return _Surface(plane, X_WC, inliers, plan, score)


def _measured(view: _View, found: _Surface) -> SupportSurface | None:
    """Refine a plane at full resolution and extract the outline of its surface.

    Only the pixels of the plane's connected surface are used.
    """
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
    """Return a plan of the largest connected surface in ``inliers``. Areas hidden by objects are filled in.

    Args:
        inliers: Mask of the plane's pixels.
        hidden: Mask of the pixels whose rays are not known to reach the plane, because an object is in front of it or
            there is no reading. All other rays outside ``inliers`` pass through the plane, so there is no surface at
            those pixels.
        X_WC: Camera pose in the world frame on the plane.
        K: Intrinsic matrix [px].
        points_W: Points of the image in the world [m], shape (h, w, 3).
        finest: Minimum cell size of the plan [m].

    Returns:
        The plan, or None if there is no connected surface.
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
        # Interpolate linearly, so that a border thinner than a cell does not vanish.
        picture = mask.astype(np.float32)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpPerspective(picture, to_pixel, (columns, rows), flags=flags) > 0.5)

    surface, unseen = seen_from_above(inliers), seen_from_above(hidden)
    # Gaps up to 1 cm wide in the plane are sensor noise rather than holes in the table.
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
    """Return the boundary of a plan in world xy, which is a simple counterclockwise polygon.

    Returns:
        Array of shape (n, 2) [m].
    """
    import cv2
    from shapely.geometry import Polygon

    # Upsample by two and pad, so that the contour follows the borders of the cells instead of their centers.
    fine = np.pad(np.kron(plan.mask, np.ones((2, 2), bool)), 1).astype(np.uint8)
    contours, _ = cv2.findContours(fine, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    contour = max(contours, key=cv2.contourArea)[:, 0, :].astype(np.float64)
    whole = Polygon(((contour - 1.5) / 2 + 0.25) * plan.cell + plan.corner).buffer(0)
    polygon = max(getattr(whole, "geoms", [whole]), key=lambda part: part.area)
    simple = simplified(polygon, OUTLINE_TOLERANCE, growth=1.3)
    ring = np.asarray(simple.exterior.coords)[:-1]
    return ring if simple.exterior.is_ccw else ring[::-1].copy()


def _pixel_of_cell(X_WC: Pose, K: Array, corner: Array, cell: float) -> Array:
    """Return the homography from plan cells (column, row, 1) to pixels (u, v, 1).

    Returns:
        Array of shape (3, 3).
    """
    X_CW = X_WC.inverse()
    plane = np.column_stack([X_CW.rotation[:, 0], X_CW.rotation[:, 1], X_CW.p])
    cells = np.array([[cell, 0, corner[0]], [0, cell, corner[1]], [0, 0, 1]])
    return np.asarray(K @ plane @ cells)


def _largest(mask: Mask, measured: Mask) -> Mask | None:
    """Return the component of ``mask`` that contains the most pixels of ``measured``.

    The result is None if the mask is empty.
    """
    labels, areas = components(mask)
    sizes = np.bincount(labels[measured], minlength=len(areas))[1:]
    return np.asarray(labels == 1 + int(np.argmax(sizes))) if len(sizes) else None
