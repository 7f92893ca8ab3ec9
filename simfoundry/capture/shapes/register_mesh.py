"""Find the pose, and if need be the scale, at which a given mesh explains the camera's view of an object.

Starts cover all sides on which the mesh may lie, turned all around. All of them are moved onto the visible surface at
once, by matching observed points with points of the mesh that face the same way (iterative closest points). The best
of them are judged by ray casts, which also see free space and the silhouette, and the best of those are refined by
the same measure. Nothing is random, so equal evidence has equal results.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.segment.masks import Mask
from simfoundry.capture.shapes.closest_points import States, matched_states, point_distances, rotations_about
from simfoundry.capture.shapes.evidence import Evidence, RayAgreement, agreement
from simfoundry.capture.shapes.fit_primitives import search
from simfoundry.capture.shapes.mesh_template import MeshTemplate
from simfoundry.capture.shapes.solid_casts import cast_mesh
from simfoundry.capture.shapes.visible_cloud import VisibleCloud
from simfoundry.geometry.frames import Array, Pose

# Vertices [m], shape (n, 3), and faces, shape (k, 3).
Surface = tuple[Array, NDArray[np.int32]]

# Edges of the initial simplex of a refinement: translation [m], rotation [rad], and logarithm of the scale.
STEP_M, STEP_RAD, STEP_SCALE = 0.005, 0.06, 0.04

# Two poses are one if they are closer than this [m], [rad], so that not all refined starts end in the same pose.
SAME_M, SAME_RAD = 0.01, 0.2

# Cost of reaching below the table by the scale of the noise, and the most that it costs. The hidden part of
# a wrong model may be there.
SINK_COST, MAX_SINK_COST = 0.1, 0.5

# Cost of floating above what the object stands on by the scale of the noise, and the most that it costs: little,
# because what it stands on may be another object.
FLOAT_COST, MAX_FLOAT_COST = 0.02, 0.1

# Least decrease of the cost for which a mesh is laid on another side than that on which it stands.
UPRIGHT_WORTH = 0.02

# Local registration: edges of the simplex [m, rad], evaluations, turns about the vertical axis from which it starts
# [deg], and the least decrease of the cost for which an object is moved. Below it, turns of round objects differ only
# by their facets.
LOCAL_STEPS, LOCAL_EVALUATIONS = (0.006, 0.006, 0.003, 0.08), 160
LOCAL_STARTS_DEG, LOCAL_WORTH = (0.0, 12.0, -12.0), 0.005


@dataclass(frozen=True)
class RegistrationEffort:
    """Settings that decide how thorough a registration is.

    The defaults find isolated YCB objects in any pose, in 0.7 s of processor time.

    Attributes:
        yaws: Turns about the vertical axis from which it starts; it turns an object by more than half of 30 degrees.
        points: Observed points that are matched.
        rounds: Rounds of matching. Most starts rest after six.
        judged: Starts that are judged by ray casts.
        rays: Rays for it, and for the refinement.
        refined: Starts that are refined.
        evaluations: Evaluations for each unknown and each of two simplices of a refinement.
    """

    yaws: int = 12
    points: int = 120
    rounds: int = 8
    judged: int = 16
    rays: int = 700
    refined: int = 2
    evaluations: int = 16


THOROUGH = RegistrationEffort()


@dataclass(frozen=True, eq=False)
class RegisteredMesh:
    """A mesh at the pose at which it agrees best with the image.

    Attributes:
        X_WO: Pose of the mesh in the world.
        scale: Factor by which the mesh is scaled about its own origin first; 1 if its size is known.
        agreement: Agreement of the mesh with the image.
        cost: Its cost, and that of a place below the table or in the air.
    """

    X_WO: Pose
    scale: float
    agreement: RayAgreement
    cost: float


def pose_agreement(evidence: Evidence, surface: Surface, X_WO: Pose) -> RayAgreement:
    """Compare a surface at a pose with the evidence, by the measure of the reconstruction."""
    vertices, faces = surface
    return agreement(evidence, cast_mesh(evidence.eye, evidence.rays, X_WO.apply(vertices), faces))


def registered_pose(evidence: Evidence, surface: Surface, X_WO: Pose) -> Pose:
    """Return the pose near ``X_WO`` at which a surface agrees best with the evidence.

    The object is moved and turned about the vertical axis through its middle, so that it stays as upright as it is. The
    cost is that of the reconstruction, and the result is never worse than ``X_WO``.
    """
    middle = X_WO.apply(surface[0].mean(axis=0))

    def moved(x: Array) -> Pose:
        turn = Pose.about(np.array([0.0, 0.0, 1.0]), float(x[3]))
        return Pose.of(middle + x[:3]) @ turn @ Pose.of(-middle) @ X_WO

    def cost(x: Array) -> float:
        return pose_agreement(evidence, surface, moved(x)).cost

    start = np.zeros(4)
    best, least = start, cost(start)
    for degrees in LOCAL_STARTS_DEG:
        turned = start + np.array([0, 0, 0, np.radians(degrees)])
        value, found = search(cost, turned, np.array(LOCAL_STEPS), LOCAL_EVALUATIONS)
        if value < least - LOCAL_WORTH:
            best, least = found, value
    return moved(best)


def register_mesh(
    evidence: Evidence,
    template: MeshTemplate,
    *,
    scale: float | None = 1.0,
    upright: bool = False,
    effort: RegistrationEffort = THOROUGH,
) -> RegisteredMesh:
    """Return the pose in the world at which a mesh explains the evidence for an object best.

    Args:
        evidence: What the camera sees of the object.
        template: The mesh.
        scale: Known factor from the units of the mesh to meters, or None to estimate it.
        upright: True if the mesh certainly stands as it is, with z up.
        effort: Settings that decide how thorough the search is.
    """
    sides = template.sides[:1] if upright else template.sides
    cloud = VisibleCloud.of(evidence, effort.points)
    state = matched_states(
        cloud, template, _starts(cloud, template, sides, scale, effort.yaws), scale is None, effort.rounds
    )
    few = _fewer_rays(evidence, effort.rays)
    placed = [_Placed(R, t, s) for R, t, s in zip(*state, strict=True)]
    order = np.argsort(point_distances(cloud, template, state), kind="stable")
    judged = _distinct([placed[k] for k in order], template, effort.judged)
    costs = [_cost(few, template, one) for one in judged]
    ranked = [judged[k] for k in np.argsort(costs, kind="stable")]
    best, least = ranked[0], min(costs)
    for one in ranked[: effort.refined]:
        value, found = _refined(few, template, one, scale is None, effort.evaluations)
        if value < least:
            best, least = found, value
    return _registered(evidence, template, best)


def _registered(evidence: Evidence, template: MeshTemplate, best: _Placed) -> RegisteredMesh:
    """Judge a mesh at a pose with all rays."""
    mesh = template.mesh
    X_WO = Pose.from_matrix(best.R)
    X_WO = Pose.of(best.t, X_WO.q)
    surface = (mesh.vertices * best.scale, mesh.faces)
    result = pose_agreement(evidence, surface, X_WO)
    low = float(X_WO.apply(surface[0])[:, 2].min())
    return RegisteredMesh(X_WO, best.scale, result, result.cost + misplacement(evidence, low))


def refine_registration(evidence: Evidence, template: MeshTemplate, X_WO: Pose) -> RegisteredMesh:
    """Return the pose near ``X_WO`` at which a mesh of known size explains the evidence best, which is never worse."""
    few = _fewer_rays(evidence, THOROUGH.rays)
    start = _Placed(X_WO.rotation, X_WO.p, 1.0)
    value, found = _refined(few, template, start, False, THOROUGH.evaluations)
    best = found if value < _cost(few, template, start) else start
    return _registered(evidence, template, best)


def register_upright(evidence: Evidence, template: MeshTemplate, scale: float | None = 1.0) -> RegisteredMesh:
    """Return the mesh as it stands, with z up, unless it fits clearly better on another side."""
    upright = register_mesh(evidence, template, scale=scale, upright=True)
    anyhow = register_mesh(evidence, template, scale=scale)
    return anyhow if anyhow.cost < upright.cost - UPRIGHT_WORTH else upright


@dataclass(frozen=True, eq=False)
class _Placed:
    """A scaled mesh at a pose: a point p of it is at ``R @ (scale * p) + t``."""

    R: Array
    t: Array
    scale: float


def _starts(cloud: VisibleCloud, template: MeshTemplate, sides: Array, scale: float | None, yaws: int) -> States:
    """Return each side of the mesh, turned all around, where its visible part has the middle of the observed points.

    If the scale is unknown, the visible part also gets the size of the observed one, as seen across the view.
    """
    yaw = np.arange(yaws) * (2 * math.pi / yaws)
    c, s, o, e = np.cos(yaw), np.sin(yaw), np.zeros(yaws), np.ones(yaws)
    turns = np.array([[c, -s, o], [s, c, o], [o, o, e]]).transpose(2, 0, 1)
    turned = np.einsum("aij,bjk->baik", turns, sides).reshape(-1, 3, 3)
    visible = np.einsum("nij,mj,i->nm", turned, template.normals, cloud.ray) < -0.1  # not edge-on
    weight = visible / np.maximum(visible.sum(axis=1, keepdims=True), 1)
    points = np.einsum("nij,mj->nmi", turned, template.points)
    middle = np.einsum("nm,nmi->ni", weight, points)
    factor = np.full(len(turned), 1.0 if scale is None else scale)
    if scale is None:
        own = _spread_across(cloud.points - cloud.points.mean(axis=0), np.full(len(cloud.points), 1.0), cloud.ray)
        for k in range(len(turned)):
            factor[k] = own / max(_spread_across(points[k] - middle[k], weight[k], cloud.ray), 1e-9)
    return turned, cloud.points.mean(axis=0) - factor[:, None] * middle, factor


def _spread_across(offsets: Array, weight: Array, ray: Array) -> float:
    """Return the root mean square of offsets [m], shape (n, 3), perpendicular to a ray."""
    squares = (offsets**2).sum(axis=1) - (offsets @ ray) ** 2
    return float(np.sqrt(max((weight * squares).sum() / max(weight.sum(), 1e-12), 0.0)))


def _distinct(placed: list[_Placed], template: MeshTemplate, count: int) -> list[_Placed]:
    """Return the first ``count`` that differ from each other."""
    out: list[_Placed] = []
    for one in placed:
        center = one.R @ (one.scale * template.center) + one.t
        for other in out:
            cosine = (np.trace(one.R.T @ other.R) - 1) / 2
            apart = float(np.linalg.norm(other.R @ (other.scale * template.center) + other.t - center))
            if apart < SAME_M and cosine > math.cos(SAME_RAD):
                break
        else:
            out.append(one)
        if len(out) == count:
            break
    return out


def _fewer_rays(evidence: Evidence, count: int) -> Evidence:
    """Return the evidence with about ``count`` of its rays, spread evenly over its grid."""
    step = max(1, round(len(evidence.rays) / count))
    step += step % 2 == 0 and step > 1  # an odd step visits other columns in each row of a grid
    chosen: Mask = np.zeros(len(evidence.rays), dtype=bool)
    chosen[::step] = True
    return replace(
        evidence,
        rays=evidence.rays[chosen],
        depth=evidence.depth[chosen],
        inside=evidence.inside[chosen],
        hidden=evidence.hidden[chosen],
    )


def _cost(evidence: Evidence, template: MeshTemplate, placed: _Placed) -> float:
    """Return the cost of the reconstruction, and that of a place below or above what the object stands on."""
    vertices = placed.scale * template.vertices @ placed.R.T + placed.t
    result = agreement(evidence, cast_mesh(evidence.eye, evidence.rays, vertices, template.faces))
    return result.cost + misplacement(evidence, float(vertices[:, 2].min()))


def misplacement(evidence: Evidence, low: float) -> float:
    """Return the cost of an object whose lowest point, at height ``low`` [m], is below the table or in the air."""
    sink = min(MAX_SINK_COST, SINK_COST * max(0.0, -low) / evidence.scale)
    return sink + min(MAX_FLOAT_COST, FLOAT_COST * abs(low - evidence.base_z) / evidence.scale)


def _refined(
    evidence: Evidence, template: MeshTemplate, start: _Placed, free_scale: bool, evaluations: int
) -> tuple[float, _Placed]:
    """Move, turn and if need be scale the mesh about the middle of the observed points until the cost is least."""
    pivot = evidence.points.mean(axis=0)

    def moved(x: Array) -> _Placed:
        turn = rotations_about(x[None, 3:6])[0]
        factor = math.exp(float(np.clip(x[6], -1, 1))) if free_scale else 1.0
        shift = pivot + x[:3] + turn @ (factor * (start.t - pivot))
        return _Placed(turn @ start.R, shift, factor * start.scale)

    def cost(x: Array) -> float:
        return _cost(evidence, template, moved(x))

    steps = np.array([STEP_M] * 3 + [STEP_RAD] * 3 + [STEP_SCALE] * free_scale)
    x = np.zeros(len(steps))
    for size in (1.0, 0.5):  # a simplex that has collapsed goes on from a fresh one
        value, x = search(cost, x, size * steps, evaluations * len(steps))
    return value, moved(x)
