"""Accuracy of a reconstruction by the paper's measures: position, size, Chamfer distance, F1 at 1 cm."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.shapes import tessellate
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Camera, Scene, SceneObject
from simfoundry.scene.object_shapes import bounds, world_bounds

SAME_OBJECT = 0.06  # Objects whose centers are farther apart than this [m] are different ones

F1_DISTANCE = 0.01


@dataclass(frozen=True)
class ObjectAccuracy:
    """A true object and its reconstruction; ``recovered`` is empty if there is none.

    ``position`` [m] is the distance between the centers of their bounding boxes; ``size_true`` and ``size`` [m] are the
    extents of their own boxes, sorted; ``chamfer`` [m] the mean distance between their surfaces, both ways averaged;
    ``f1`` at 1 cm; masses in kg.
    """

    name: str
    recovered: str
    position: float = float("nan")
    size_true: tuple[float, ...] = ()
    size: tuple[float, ...] = ()
    mass_true: float = float("nan")
    mass: float = float("nan")
    chamfer: float = float("nan")
    f1: float = float("nan")

    def to_json(self) -> dict[str, Any]:
        """Return a JSON-ready mapping."""
        return {k: None if isinstance(v, float) and np.isnan(v) else v for k, v in asdict(self).items()}


def compare(truth: Scene, truth_camera: Camera, found: Scene, found_camera: Camera) -> list[ObjectAccuracy]:
    """Match the free objects of two scenes that one camera saw, each in a world frame of its own."""
    from scipy.optimize import linear_sum_assignment

    X_found_truth = found_camera.X_WC @ truth_camera.X_WC.inverse()
    real = [o for o in truth.objects if not o.fixed]
    seen = [o for o in found.objects if not o.fixed]
    if not real or not seen:
        return [ObjectAccuracy(o.name, "") for o in real]
    centers_real = np.array([_center(o, X_found_truth @ o.X_WO) for o in real])
    centers_seen = np.array([_center(o, o.X_WO) for o in seen])
    distance = np.linalg.norm(centers_real[:, None] - centers_seen[None], axis=2)
    # Beyond the limit all are equally wrong: otherwise an object that was not found would take a neighbor's match.
    matches = dict(zip(*(a.tolist() for a in linear_sum_assignment(np.minimum(distance, SAME_OBJECT))), strict=True))
    out = []
    for k, item in enumerate(real):
        j = matches.get(k)
        if j is None or distance[k, j] > SAME_OBJECT:
            out.append(ObjectAccuracy(item.name, ""))
        else:
            out.append(_compare(item, X_found_truth @ item.X_WO, seen[j], float(distance[k, j])))
    return out


def _compare(item: SceneObject, X_WO: Pose, found: SceneObject, distance: float) -> ObjectAccuracy:
    chamfer, f1 = surface_distance(surface(item, X_WO), surface(found, found.X_WO))
    return ObjectAccuracy(
        name=item.name,
        recovered=found.name,
        position=distance,
        size_true=_sizes(item),
        size=_sizes(found),
        mass_true=sum(link.mass for link in item.links),
        mass=sum(link.mass for link in found.links),
        chamfer=chamfer,
        f1=f1,
    )


def surface(item: SceneObject, X_WO: Pose, count: int = 4000) -> Array:
    """Points spread evenly over the visuals of an object posed at ``X_WO`` [m], shape (count, 3); deterministic."""
    poses = link_poses(item)
    triangles = []
    for link in item.links:
        for visual in link.visuals:
            mesh = tessellate(visual.geometry)
            triangles.append((X_WO @ poses[link.name] @ visual.X_LG).apply(mesh.vertices)[mesh.faces])
    corners = np.concatenate(triangles)
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    rng = np.random.default_rng(0)
    k = np.searchsorted(np.cumsum(area), (np.arange(count) + 0.5) / count * area.sum())
    u, v = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    return np.asarray((1 - u) * a[k] + u * (1 - v) * b[k] + u * v * c[k])


def surface_distance(a: Array, b: Array) -> tuple[float, float]:
    """Chamfer distance [m] (mean of the two mean nearest distances) and F1 at 1 cm of two point sets."""
    from scipy.spatial import cKDTree

    to_b, to_a = cKDTree(b).query(a)[0], cKDTree(a).query(b)[0]
    recall, precision = float((to_b < F1_DISTANCE).mean()), float((to_a < F1_DISTANCE).mean())
    f1 = 2 * precision * recall / (precision + recall) if precision + recall else 0.0
    return float((to_b.mean() + to_a.mean()) / 2), f1


def _center(item: SceneObject, X_WO: Pose) -> Array:
    low, high = world_bounds(item, X_WO)
    return (low + high) / 2


def _sizes(item: SceneObject) -> tuple[float, ...]:
    low, high = bounds(item)
    return tuple(sorted(round(float(v), 4) for v in high - low))
