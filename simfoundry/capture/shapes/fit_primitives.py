"""Round shapes: upright and lying cylinders, spheres."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from simfoundry.capture.shapes.evidence import Evidence, RayAgreement, agreement, cast_box, cast_lathe, cast_sphere
from simfoundry.geometry.frames import Array, Pose, frozen_array
from simfoundry.geometry.shapes import Box, Cylinder, Sphere

SMALLEST = 0.004  # [m] least radius or extent: below the depth noise at half a meter


@dataclass(frozen=True, eq=False)
class RoundFit:
    """A cylinder or sphere in the world and its agreement with the rays."""

    shape: Cylinder | Sphere
    X_WO: Pose
    agreement: RayAgreement


def search(cost: Callable[[Array], float], start: Array, steps: Array, evaluations: int) -> tuple[float, Array]:
    """Nelder-Mead from ``start`` with a first simplex of ``steps``: (cost, parameters). Deterministic."""
    from scipy.optimize import minimize

    found = minimize(
        cost,
        start,
        method="Nelder-Mead",
        options={
            "initial_simplex": np.vstack([start, start + np.diag(steps)]),
            "maxfev": evaluations,
            "xatol": 2e-4,
            "fatol": 1e-4,
        },
    )
    return float(found.fun), np.asarray(found.x, dtype=np.float64)


def start_axis(evidence: Evidence) -> tuple[Array, float]:
    """First vertical axis: (xy [m], shape (2,), radius [m]), from the width across the view and the nearest points."""
    view = evidence.view
    across = np.array([-view[1], view[0]])
    t, s = evidence.points[:, :2] @ across, evidence.points[:, :2] @ view
    low, high = np.percentile(t, [1.5, 98.5])
    radius = max((high - low) / 2, SMALLEST)
    return across * (low + high) / 2 + view * (np.percentile(s, 2.0) + radius), float(radius)


def cylinder_profile(radius: float, height: float) -> Array:
    """The closed profile of a cylinder centered on its frame, shape (4, 2)."""
    return np.array([[0.0, height / 2], [radius, height / 2], [radius, -height / 2], [0.0, -height / 2]])


def fit_cylinder(evidence: Evidence) -> RoundFit:
    """The upright cylinder on ``base_z`` that explains the evidence best."""
    axis, radius = start_axis(evidence)

    def solid(x: Array) -> tuple[Cylinder, Pose]:
        shape = Cylinder(float(max(x[2], SMALLEST)), float(max(x[3], SMALLEST)))
        return shape, Pose.of((x[0], x[1], evidence.base_z + shape.height / 2))

    # Where another object hides one side, the width seen is too small and its middle off the axis.
    across = np.array([-evidence.view[1], evidence.view[0]])
    sideways = [(1.0, 0.0), (1.3, -0.3), (1.3, 0.3), (1.3, 0.0), (1.7, -0.7), (1.7, 0.7)]
    starts = [
        np.array(
            [
                *(axis + radius * (shift * across + (growth - 1) * evidence.view)),
                growth * radius,
                evidence.top - evidence.base_z,
            ]
        )
        for growth, shift in sideways
    ]
    start = min(starts, key=lambda x: _cylinder_agreement(evidence, *solid(x)).cost)
    steps = np.array([0.25 * radius, 0.25 * radius, 0.12 * radius, 0.008])
    return _fit_cylinder(evidence, solid, start, steps)


def fit_lying_cylinder(evidence: Evidence) -> RoundFit:
    """The cylinder lying on ``base_z``, its axis horizontal, that explains the evidence best."""

    def solid(x: Array) -> tuple[Cylinder, Pose]:
        shape = Cylinder(float(max(x[3], SMALLEST)), float(max(x[4], SMALLEST)))
        along = Pose.of(q=(math.cos(x[2] / 2), 0, 0, math.sin(x[2] / 2))) @ Pose.of(
            q=(math.sqrt(0.5), 0, math.sqrt(0.5), 0)
        )
        return shape, Pose.of((x[0], x[1], evidence.base_z + shape.radius), along.q)

    radius = max((evidence.top - evidence.base_z) / 2, SMALLEST)
    starts = [_lying_start(evidence, yaw, radius) for yaw in np.deg2rad(np.arange(0.0, 180.0, 15.0))]
    best = min(starts, key=lambda x: _cylinder_agreement(evidence, *solid(x)).cost)
    return _fit_cylinder(evidence, solid, best, np.array([0.008, 0.008, 0.12, 0.15 * radius, 0.01]))


def _lying_start(evidence: Evidence, yaw: float, radius: float) -> Array:
    along = np.array([math.cos(yaw), math.sin(yaw)])
    side = np.array([-along[1], along[0]])
    low, high = np.percentile(evidence.points[:, :2] @ along, [1.0, 99.0])
    # The ridge of a lying cylinder is its highest line: it lies above the axis.
    ridge = evidence.points[evidence.points[:, 2] > evidence.top - 0.15 * radius]
    offset = float(np.median((ridge if len(ridge) > 5 else evidence.points)[:, :2] @ side))
    return np.array([*(along * (low + high) / 2 + side * offset), yaw, radius, high - low])


def _cylinder_agreement(evidence: Evidence, shape: Cylinder, X_WO: Pose) -> RayAgreement:
    profile = cylinder_profile(shape.radius, shape.height)
    return agreement(evidence, cast_lathe(evidence.eye, evidence.rays, profile, X_WO))


def _fit_cylinder(
    evidence: Evidence, solid: Callable[[Array], tuple[Cylinder, Pose]], start: Array, steps: Array
) -> RoundFit:
    _, best = search(lambda x: _cylinder_agreement(evidence, *solid(x)).cost, start, steps, 220)
    shape, X_WO = solid(best)
    return RoundFit(shape, X_WO, _cylinder_agreement(evidence, shape, X_WO))


def fit_sphere(evidence: Evidence) -> RoundFit:
    """The sphere resting on ``base_z`` that explains the evidence best."""
    axis, radius = start_axis(evidence)

    def solid(x: Array) -> tuple[float, Array]:
        r = float(max(x[2], SMALLEST))
        return r, np.array([x[0], x[1], evidence.base_z + r])

    def judge(x: Array) -> RayAgreement:
        return agreement(evidence, cast_sphere(evidence.eye, evidence.rays, *solid(x)))

    starts = [np.array([*axis, r]) for r in (radius, max((evidence.top - evidence.base_z) / 2, SMALLEST))]
    start = min(starts, key=lambda x: judge(x).cost)
    steps = np.array([0.25 * radius, 0.25 * radius, 0.12 * radius])
    _, best = search(lambda x: judge(x).cost, start, steps, 150)
    r, center = solid(best)
    return RoundFit(Sphere(r), Pose.of(center), judge(best))


DEPTH_PRIOR = 0.35  # depth over width of a box that shows one face only: cartons and bottles run from 0.25 to 0.5
_FACE_SHARE = 0.06  # of the points: with fewer, a face does not measure how far the box extends along it
_WALK = (0.012, 0.006, 0.003, 0.0015, 0.0007)  # [m]
_WORTH = 1e-5  # of cost, that a step must save


@dataclass(frozen=True, eq=False)
class BoxFit:
    """A box in the world and its agreement with the rays; ``guessed_depth`` if the prior had to supply one extent."""

    box: Box
    X_WO: Pose
    agreement: RayAgreement
    guessed_depth: bool


def fit_box(evidence: Evidence) -> BoxFit:
    """Fit the upright box on ``base_z`` that best explains the evidence."""
    starts = sorted((_start(evidence, yaw) for yaw in np.deg2rad(np.arange(0.0, 90.0, 3.0))), key=lambda s: s[0])
    steps = np.array([0.006, 0.006, math.radians(4), 0.008, 0.008, 0.008])
    tried = [search(lambda x: _cost(evidence, x), start, steps, 260) for _, start in _distinct(starts)]
    best = _walk_faces(evidence, *min(tried, key=lambda found: found[0]))
    guessed, best = _supply_depth(evidence, best)
    size, X_WO = _unpack(best, evidence.base_z)
    return BoxFit(Box(size), X_WO, agreement(evidence, cast_box(evidence.eye, evidence.rays, size, X_WO)), guessed)


def _start(evidence: Evidence, yaw: float) -> tuple[float, Array]:
    """The box around the points at one yaw, as (cost, parameters)."""
    c, s = math.cos(yaw), math.sin(yaw)
    local = evidence.points[:, :2] @ np.array([[c, -s], [s, c]])
    low, high = np.percentile(local, [1.0, 99.0], axis=0)
    center = np.array([[c, -s], [s, c]]) @ ((low + high) / 2)
    extents = np.maximum(high - low, SMALLEST)
    x = np.array([*center, yaw, *extents, max(evidence.top - evidence.base_z, SMALLEST)])
    return _cost(evidence, x), x


def _distinct(starts: list[tuple[float, Array]], count: int = 2) -> list[tuple[float, Array]]:
    """The cheapest starts whose yaws differ by more than 10 degrees (modulo a quarter turn)."""
    chosen: list[tuple[float, Array]] = []
    for start in starts:
        turns = [abs((start[1][2] - other[1][2] + math.pi / 4) % (math.pi / 2) - math.pi / 4) for other in chosen]
        if all(turn > math.radians(10) for turn in turns):
            chosen.append(start)
        if len(chosen) == count:
            break
    return chosen


def _unpack(x: Array, base_z: float) -> tuple[Array, Pose]:
    """Full extents [m] and pose of parameters (x, y, yaw, three extents)."""
    size = np.maximum(x[3:6], SMALLEST)
    yaw = float(x[2])
    return frozen_array(size), Pose.of((x[0], x[1], base_z + size[2] / 2), (math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)))


def _cost(evidence: Evidence, x: Array) -> float:
    size, X_WO = _unpack(x, evidence.base_z)
    small = float(np.maximum(SMALLEST - x[3:6], 0).sum()) / evidence.scale
    return agreement(evidence, cast_box(evidence.eye, evidence.rays, size, X_WO)).cost + small


def _walk_faces(evidence: Evidence, cost: float, x: Array) -> Array:
    """Move one face or the yaw at a time for as long as that helps, in ever smaller steps.

    Nelder-Mead stalls on the ledges that single pixels make, above all where a band of pixels without depth lies
    between the object and what is behind it: there no small move of all parameters at once pays.
    """
    for step in _WALK:
        moved = True
        while moved:
            moved = False
            for trial in _moves(x, step):
                better = _cost(evidence, trial)
                if better < cost - _WORTH:
                    cost, x, moved = better, trial, True
                    break
    return x


def _moves(x: Array, step: float) -> Iterator[Array]:
    """Boxes with one face moved by ``step`` [m] outward or inward, or turned so that a corner moves about as far."""
    c, s = math.cos(x[2]), math.sin(x[2])
    for sign in (step, -step):
        for axis, direction in ((0, (c, s)), (1, (-s, c))):
            for side in (0.5, -0.5):
                out = x.copy()
                out[3 + axis] += sign
                out[:2] += side * sign * np.array(direction)
                yield out
        out = x.copy()
        out[5] += sign
        yield out
        out = x.copy()
        out[2] += 2 * sign / max(x[3], x[4], SMALLEST)
        yield out


def _supply_depth(evidence: Evidence, x: Array) -> tuple[bool, Array]:
    """Extend a box that shows only one upright face away from the camera by the prior, as far as free space allows.

    An extent is measured if enough points lie on a face along it; a box that faces the camera shows none for its depth.
    """
    size, X_WO = _unpack(x, evidence.base_z)
    local = X_WO.inverse().apply(evidence.points)
    face = np.argmin(np.abs(np.abs(local) - size / 2), axis=1)
    for axis in (0, 1):
        across = 1 - axis
        on_sides = float(np.mean(face != axis))  # the top and the other pair of faces measure this extent
        if on_sides >= _FACE_SHARE or size[axis] > DEPTH_PRIOR * size[across]:
            continue
        wanted = DEPTH_PRIOR * min(size[across], max(size[2], 0.03))
        direction = X_WO.rotation[:2, axis] * np.sign(X_WO.rotation[:2, axis] @ evidence.view)
        before = agreement(evidence, cast_box(evidence.eye, evidence.rays, size, X_WO)).intrusion
        while wanted > size[axis]:
            longer = x.copy()
            longer[3 + axis] = wanted
            longer[:2] += direction * (wanted - size[axis]) / 2
            trial, X_trial = _unpack(longer, evidence.base_z)
            now = agreement(evidence, cast_box(evidence.eye, evidence.rays, trial, X_trial)).intrusion
            if now <= before + 0.02:
                return True, longer
            wanted *= 0.85
    return False, x
