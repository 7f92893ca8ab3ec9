"""Fit boxes, cylinders and spheres.

A fit determines the pose and size that best explain the rays.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import count

import numpy as np

from simfoundry.capture.shapes.evidence import PRIOR, Evidence, FitCandidate, RayAgreement
from simfoundry.capture.shapes.solid_casts import SolidHits, cast_box, cast_cylinder, cast_sphere
from simfoundry.geometry.frames import Array, Pose, frozen_array
from simfoundry.geometry.shapes import Box, Cylinder, Sphere

SMALLEST = 0.004  # [m] minimum radius or extent, close to the depth noise at half a meter
DEPTH_PRIOR = 0.35  # ratio of depth to width for a box with one visible face; 0.25 to 0.5 for cartons and bottles
_FACE_SHARE = 0.06  # minimum fraction of the points on a face for it to measure the extent of the box along it
_WALK = (0.012, 0.006, 0.003, 0.0015, 0.0007)  # [m] step sizes for moving faces
_WORTH = 1e-5  # minimum cost reduction for accepting a step
Solid = tuple[Cylinder | Sphere, Pose]


# Number of iterations after which a search ends if it is not expected to beat its rival, and how much lower its cost
# may still become. From there, the cost of 95 of 100 upright cylinders fell by at most 0.07, and of all by 0.16.
EARLY, HOPE = 20, 0.15


def search(
    cost: Callable[[Array], float], start: Array, steps: Array, evaluations: int, most: float = math.inf
) -> tuple[float, Array]:
    """Minimize ``cost`` with the Nelder-Mead method, starting from ``start``.

    ``steps`` are the edges of the initial simplex. The search ends early if the cost remains above ``most`` for
    :data:`EARLY` iterations. The result is deterministic.

    Returns:
        The minimum cost and its parameters.
    """
    from scipy.optimize import OptimizeResult, minimize

    iterations = count(1)

    def end_early(intermediate_result: OptimizeResult) -> None:
        if next(iterations) == EARLY and intermediate_result.fun > most:
            raise StopIteration

    simplex = np.vstack([start, start + np.diag(steps)])
    options = {"initial_simplex": simplex, "maxfev": evaluations, "xatol": 2e-4, "fatol": 1e-4}
    found = minimize(cost, start, method="Nelder-Mead", options=options, callback=end_early)
    return float(found.fun), np.asarray(found.x, dtype=np.float64)


def promising_cost(family: str, rival: float) -> float:
    """Return the cost above which a search for a solid of a family is not expected to beat a rival's cost."""
    return rival - PRIOR[family] + HOPE


def start_axis(evidence: Evidence) -> tuple[Array, float]:
    """Estimate an initial vertical axis.

    The estimate is based on the width of the object across the view and on its nearest points.

    Returns:
        The position of the axis in xy [m], as an array of shape (2,), and the radius [m].
    """
    view, across = evidence.view, evidence.across
    t, s = evidence.points[:, :2] @ across, evidence.points[:, :2] @ view
    low, high = np.percentile(t, [1.5, 98.5])
    radius = max((high - low) / 2, SMALLEST)
    return across * (low + high) / 2 + view * (np.percentile(s, 2.0) + radius), float(radius)


def fit_cylinder(evidence: Evidence, rival: float = math.inf) -> FitCandidate:
    """Fit the upright cylinder on ``base_z`` that best explains the evidence."""
    axis, radius = start_axis(evidence)

    def solid(x: Array) -> Solid:
        shape = Cylinder(float(max(x[2], SMALLEST)), float(max(x[3], SMALLEST)))
        return shape, Pose.of((x[0], x[1], evidence.base_z + shape.height / 2))

    # If another object hides one side, the visible width is too small and its middle is off the axis.
    sideways = [(1.0, 0.0), (1.3, -0.3), (1.3, 0.3), (1.3, 0.0), (1.7, -0.7), (1.7, 0.7)]
    starts = []
    for growth, shift in sideways:
        middle = axis + radius * (shift * evidence.across + (growth - 1) * evidence.view)
        starts.append(np.array([*middle, growth * radius, evidence.top - evidence.base_z]))
    steps = np.array([0.25 * radius, 0.25 * radius, 0.12 * radius, 0.008])
    return _fit_round("cylinder", evidence, solid, starts, steps, 220, rival)


def fit_lying_cylinder(evidence: Evidence, rival: float = math.inf) -> FitCandidate:
    """Fit the cylinder lying on ``base_z`` that best explains the evidence.

    The axis of the cylinder is horizontal.
    """

    def solid(x: Array) -> Solid:
        shape = Cylinder(float(max(x[3], SMALLEST)), float(max(x[4], SMALLEST)))
        yaw = Pose.of(q=(math.cos(x[2] / 2), 0, 0, math.sin(x[2] / 2)))
        along = yaw @ Pose.of(q=(math.sqrt(0.5), 0, math.sqrt(0.5), 0))
        return shape, Pose.of((x[0], x[1], evidence.base_z + shape.radius), along.q)

    radius = max((evidence.top - evidence.base_z) / 2, SMALLEST)
    # The ridge of a lying cylinder is its highest line, which is right above the axis.
    ridge = evidence.points[evidence.points[:, 2] > evidence.top - 0.15 * radius]
    ridge = ridge if len(ridge) > 5 else evidence.points
    starts = []
    for yaw in np.deg2rad(np.arange(0.0, 180.0, 15.0)):
        along, side = np.array([math.cos(yaw), math.sin(yaw)]), np.array([-math.sin(yaw), math.cos(yaw)])
        low, high = np.percentile(evidence.points[:, :2] @ along, [1.0, 99.0])
        offset = float(np.median(ridge[:, :2] @ side))
        starts.append(np.array([*(along * (low + high) / 2 + side * offset), yaw, radius, high - low]))
    steps = np.array([0.008, 0.008, 0.12, 0.15 * radius, 0.01])
    return _fit_round("lying", evidence, solid, starts, steps, 220, rival)


def fit_sphere(evidence: Evidence, rival: float = math.inf) -> FitCandidate:
    """Fit the sphere resting on ``base_z`` that best explains the evidence."""
    axis, radius = start_axis(evidence)

    def solid(x: Array) -> Solid:
        shape = Sphere(float(max(x[2], SMALLEST)))
        return shape, Pose.of((x[0], x[1], evidence.base_z + shape.radius))

    starts = [np.array([*axis, r]) for r in (radius, max((evidence.top - evidence.base_z) / 2, SMALLEST))]
    steps = np.array([0.25 * radius, 0.25 * radius, 0.12 * radius])
    return _fit_round("sphere", evidence, solid, starts, steps, 150, rival)


def _fit_round(
    family: str,
    evidence: Evidence,
    solid: Callable[[Array], Solid],
    starts: list[Array],
    steps: Array,
    evaluations: int,
    rival: float,
) -> FitCandidate:
    """Optimize the parameters of ``solid``, starting from the best of ``starts``."""

    def cast(eye: Array, rays: Array, shape: Cylinder | Sphere, X_WO: Pose) -> SolidHits:
        if isinstance(shape, Sphere):
            return cast_sphere(eye, rays, shape.radius, X_WO.p)
        return cast_cylinder(eye, rays, shape.radius, shape.height, X_WO)

    def cost(x: Array) -> float:
        return evidence.cost(cast, *solid(x))

    _, best = search(cost, min(starts, key=cost), steps, evaluations, promising_cost(family, rival))
    return FitCandidate(family, *solid(best), evidence.judge(cast, *solid(best)))


def fit_box(evidence: Evidence, rival: float = math.inf) -> FitCandidate:
    """Fit the upright box on ``base_z`` that best explains the evidence."""

    def cost(x: Array) -> float:
        small = float(np.maximum(SMALLEST - x[3:6], 0).sum()) / evidence.scale
        return evidence.cost(cast_box, *upright_box(x, evidence.base_z)) + small

    yaws = (box_around(evidence, yaw) for yaw in np.deg2rad(np.arange(0.0, 90.0, 3.0)))
    starts = sorted(((cost(x), x) for x in yaws), key=lambda start: start[0])
    steps = np.array([0.006, 0.006, math.radians(4), 0.008, 0.008, 0.008])
    most = promising_cost("box", rival)
    tried = [search(cost, start, steps, 260, most) for start in _distinct([x for _, x in starts])]
    value, best = min(tried, key=lambda found: found[0])
    best = walk(cost, value, best) if value <= most else best
    guessed, best = _supply_depth(evidence, best)
    size, X_WO = upright_box(best, evidence.base_z)
    return FitCandidate("box", Box(size), X_WO, _box_agreement(evidence, best), guessed)


def box_around(evidence: Evidence, yaw: float) -> Array:
    """Return the parameters (x, y, yaw, three extents) of the box around the points for a given yaw."""
    c, s = math.cos(yaw), math.sin(yaw)
    local = evidence.points[:, :2] @ np.array([[c, -s], [s, c]])
    low, high = np.percentile(local, [1.0, 99.0], axis=0)
    center = np.array([[c, -s], [s, c]]) @ ((low + high) / 2)
    extents = np.maximum(high - low, SMALLEST)
    return np.array([*center, yaw, *extents, max(evidence.top - evidence.base_z, SMALLEST)])


def _distinct(starts: list[Array], count: int = 2) -> list[Array]:
    """Return the first ``count`` starts whose yaws differ by more than 10 degrees.

    Yaws are compared modulo a quarter turn.
    """
    chosen: list[Array] = []
    for start in starts:
        turns = [abs((start[2] - other[2] + math.pi / 4) % (math.pi / 2) - math.pi / 4) for other in chosen]
        if len(chosen) < count and all(turn > math.radians(10) for turn in turns):
            chosen.append(start)
    return chosen


def upright_box(x: Array, base_z: float) -> tuple[Array, Pose]:
    """Convert parameters (x, y, yaw, three extents) to the full extents of a box [m] and its pose."""
    size = np.maximum(x[3:6], SMALLEST)
    yaw = float(x[2])
    return frozen_array(size), Pose.of((x[0], x[1], base_z + size[2] / 2), (math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)))


def _box_agreement(evidence: Evidence, x: Array) -> RayAgreement:
    return evidence.judge(cast_box, *upright_box(x, evidence.base_z))


def walk(cost: Callable[[Array], float], lowest: float, x: Array) -> Array:
    """Move a face of a box or change its yaw, in progressively smaller steps, as long as the cost decreases.

    The Nelder-Mead method stalls at discontinuities caused by individual pixels, especially if a band of pixels without
    depth separates the object from the background. In that case, no small change to all parameters reduces the cost.
    """
    for step in _WALK:
        while True:
            trials = ((cost(trial), trial) for trial in _moves(x, step))
            better = next((found for found in trials if found[0] < lowest - _WORTH), None)
            if better is None:
                break
            lowest, x = better
    return x


def _moves(x: Array, step: float) -> Iterator[Array]:
    """Yield boxes in which one face has been moved by ``step`` [m], and boxes that have been rotated.

    A rotation moves a corner about as far as ``step``.
    """
    c, s = math.cos(x[2]), math.sin(x[2])
    for sign in (step, -step):
        for axis, direction in ((0, (c, s)), (1, (-s, c))):
            for side in (0.5, -0.5):
                out = x.copy()
                out[3 + axis] += sign
                out[:2] += side * sign * np.array(direction)
                yield out
        for parameter, change in ((5, sign), (2, 2 * sign / max(x[3], x[4], SMALLEST))):
            out = x.copy()
            out[parameter] += change
            yield out


def _supply_depth(evidence: Evidence, x: Array) -> tuple[bool, Array]:
    """Extend a box with only one visible upright face away from the camera, based on the depth prior.

    The extension is limited by observed free space. An extent counts as measured if enough points are on faces along
    that extent. If a box squarely faces the camera, no points measure its depth.

    Returns:
        A flag that is True if an extent was guessed, and the parameters of the box.
    """
    size, X_WO = upright_box(x, evidence.base_z)
    local = X_WO.inverse().apply(evidence.points)
    face = np.argmin(np.abs(np.abs(local) - size / 2), axis=1)
    for axis in (0, 1):
        across = 1 - axis
        on_sides = float(np.mean(face != axis))  # the top and the other pair of sides measure this extent
        if on_sides >= _FACE_SHARE or size[axis] > DEPTH_PRIOR * size[across]:
            continue
        wanted = DEPTH_PRIOR * min(size[across], max(size[2], 0.03))
        direction = X_WO.rotation[:2, axis] * np.sign(X_WO.rotation[:2, axis] @ evidence.view)
        before = _box_agreement(evidence, x).intrusion
        while wanted > size[axis]:
            longer = x.copy()
            longer[3 + axis] = wanted
            longer[:2] += direction * (wanted - size[axis]) / 2
            if _box_agreement(evidence, longer).intrusion <= before + 0.02:
                return True, longer
            wanted *= 0.85
    return False, x
