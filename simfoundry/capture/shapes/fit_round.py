"""Round shapes: upright and lying cylinders, spheres."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from simfoundry.capture.shapes.evidence import Evidence
from simfoundry.capture.shapes.ray_agreement import RayAgreement, agreement, cast_lathe, cast_sphere
from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.shapes import Cylinder, Sphere

SMALLEST = 0.004  # [m] least radius: below the depth noise at half a meter


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
