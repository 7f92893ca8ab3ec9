"""Measure the accuracy of a reconstruction.

The measures of objects are position, size, mass, Chamfer distance, and F1 score at 1 cm. The measures of images are
those of :mod:`simfoundry.capture.accuracy.image_metrics`.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.accuracy.image_metrics import ImageAgreement, image_agreement
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.shapes import tessellate
from simfoundry.render.raycast import Raycast
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Camera, Scene, SceneObject
from simfoundry.scene.object_shapes import bounds, world_bounds

SAME_OBJECT = 0.06  # Maximum distance [m] between the centers of an object and its reconstruction

F1_DISTANCE = 0.01  # Distance [m] within which two surface points count as equal


@dataclass(frozen=True)
class ObjectAccuracy:
    """A comparison of a ground-truth object with its reconstruction.

    ``recovered`` is the name of the reconstructed object, or an empty string if there is none. ``position`` [m] is the
    distance between the centers of the two bounding boxes. ``size_true`` and ``size`` [m] are the sorted extents of the
    bounding boxes of the two objects. ``chamfer`` [m] is the mean distance between the two surfaces, averaged over both
    directions, and ``f1`` is the F1 score at 1 cm. Masses are in kg.
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
        """Return the comparison as plain data for JSON."""
        return {k: None if isinstance(v, float) and np.isnan(v) else v for k, v in asdict(self).items()}


@dataclass(frozen=True)
class SceneAccuracy:
    """A comparison of a reconstruction with the ground truth.

    Attributes:
        objects: The free objects in the ground truth, with their reconstructions.
        extra: Names of free objects in the reconstruction that correspond to none of them.
        image: Agreement of the rendered reconstruction with the color image, over all pixels.
        scene_image: The same over the pixels at which the reconstruction has a surface; the background has none.
    """

    objects: tuple[ObjectAccuracy, ...]
    extra: tuple[str, ...]
    image: ImageAgreement
    scene_image: ImageAgreement | None

    @property
    def found(self) -> list[ObjectAccuracy]:
        """The objects that have a reconstruction."""
        return [o for o in self.objects if o.recovered]

    def spread(self, measure: str) -> tuple[float, float]:
        """Return the mean and the standard deviation of ``chamfer``, ``f1`` or ``position`` over the found objects.

        Both are NaN if none was found.
        """
        values = [float(getattr(o, measure)) for o in self.found]
        return (float(np.mean(values)), float(np.std(values))) if values else (float("nan"), float("nan"))

    def to_json(self) -> dict[str, Any]:
        """Return the comparison as plain data for JSON."""
        summary: dict[str, Any] = {"true": len(self.objects), "found": len(self.found), "extra": list(self.extra)}
        for measure in ("chamfer", "f1", "position"):
            mean, deviation = self.spread(measure)
            known = bool(self.found)
            summary[measure] = {"mean": round(mean, 6), "std": round(deviation, 6)} if known else None
        return {
            "summary": summary,
            "objects": [o.to_json() for o in self.objects],
            "image": self.image.to_json(),
            "scene_image": None if self.scene_image is None else self.scene_image.to_json(),
        }


def scene_accuracy(
    truth: Scene, truth_camera: Camera, found: Scene, rendered: Raycast, color: NDArray[np.uint8]
) -> SceneAccuracy:
    """Compare a reconstruction with the ground truth, and with the image that it was made from.

    Args:
        truth: The ground truth.
        truth_camera: The camera in the ground truth that took the image.
        found: The reconstruction, whose world frame differs from that of the ground truth.
        rendered: The reconstruction as seen by the same camera.
        color: The image, shape (h, w, 3).
    """
    objects = compare(truth, truth_camera, found, rendered.camera)
    recovered = {o.recovered for o in objects}
    extra = tuple(o.name for o in found.objects if not o.fixed and o.name not in recovered)
    surface = rendered.objects > 0
    inside = image_agreement(rendered.color, color, surface) if surface.any() else None
    return SceneAccuracy(tuple(objects), extra, image_agreement(rendered.color, color), inside)


def difference_image(rendered: NDArray[np.uint8], color: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the absolute difference of two images in shades of gray, inverted: white where they agree."""
    difference = np.abs(rendered.astype(np.float64) - color).mean(axis=2)
    return np.repeat(np.rint(255.0 - difference).astype(np.uint8)[..., None], 3, axis=2)


def truth_camera(truth: Scene, frame: str) -> Camera:
    """Return the camera in the ground truth that took the frame: that of the same name, or the only one.

    Raises:
        SimfoundryError: There is no such camera.
    """
    named = next((c for c in truth.cameras if c.name == frame), None)
    if named is not None:
        return named
    if len(truth.cameras) == 1:
        return truth.cameras[0]
    names = ", ".join(f"`{c.name}`" for c in truth.cameras) or "none"
    raise SimfoundryError(
        f"the ground truth {truth.name} has no camera `{frame}`, which would relate it to the frame of this name; its "
        f"cameras: {names}"
    )


def compare(truth: Scene, truth_camera: Camera, found: Scene, found_camera: Camera) -> list[ObjectAccuracy]:
    """Compare the free objects in the ground-truth scene ``truth`` with those in its reconstruction ``found``.

    Both scenes are seen by the same camera, but their world frames differ.
    """
    from scipy.optimize import linear_sum_assignment

    X_found_truth = found_camera.X_WC @ truth_camera.X_WC.inverse()
    real = [o for o in truth.objects if not o.fixed]
    seen = [o for o in found.objects if not o.fixed]
    out = [ObjectAccuracy(o.name, "") for o in real]
    if not real or not seen:
        return out
    centers_real = np.array([_center(o, X_found_truth @ o.X_WO) for o in real])
    centers_seen = np.array([_center(o, o.X_WO) for o in seen])
    distance = np.linalg.norm(centers_real[:, None] - centers_seen[None], axis=2)
    # Clip distances at the limit: otherwise, an object that was not found could take its neighbor's match.
    for k, j in zip(*linear_sum_assignment(np.minimum(distance, SAME_OBJECT)), strict=True):
        if distance[k, j] <= SAME_OBJECT:
            out[k] = _compare(real[k], X_found_truth @ real[k].X_WO, seen[j], float(distance[k, j]))
    return out


def _compare(item: SceneObject, X_WO: Pose, found: SceneObject, distance: float) -> ObjectAccuracy:
    chamfer, f1 = surface_distance(surface(item, X_WO), surface(found, found.X_WO))
    true_mass, mass = (sum(link.mass for link in each.links) for each in (item, found))
    return ObjectAccuracy(item.name, found.name, distance, _sizes(item), _sizes(found), true_mass, mass, chamfer, f1)


def surface(item: SceneObject, X_WO: Pose, count: int = 4000) -> Array:
    """Return points that are distributed evenly over the visuals of an object at ``X_WO``.

    The result is deterministic.

    Returns:
        Array of shape (count, 3) [m].
    """
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
    """Return the Chamfer distance [m] between two point sets and their F1 score at 1 cm.

    The Chamfer distance is the mean nearest-neighbor distance, averaged over both directions.
    """
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
