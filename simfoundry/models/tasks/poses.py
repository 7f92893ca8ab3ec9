"""The pose of an object whose mesh is known, from an image with depth (V_pose)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from simfoundry.models.client import Members, ModelClient
from simfoundry.models.contract import CAMERA, MESH, ConventionError, Member, ModelError, ModelTask
from simfoundry.models.geometry_checks import OPENGL_TO_OPENCV, Floats, check_transform
from simfoundry.models.provenance import ModelIdentity
from simfoundry.models.tasks.depth import DEPTH_OF_IMAGE, IMAGE, Depth, Mask, Pixels
from simfoundry.models.tasks.meshes import parse_glb
from simfoundry.models.wire import Bundle, BundleFile, BundleImage

# Rotates the axes of a GLB (y up) into ours (z up): p_ours = Z_UP @ p_glb.
Z_UP = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])

# Least fraction of the mask's box that the projected box of the posed mesh must cover, and conversely. A pose that is a
# centimeter off on a mug covers 0.8; a pose in another convention lies beside the mask or behind the camera.
BOX_OVERLAP = 0.1

# Largest ratio of the distance of the object's center to the depth in its mask, and conversely.
DISTANCE_RATIO = 1.5

FEWEST_DEPTHS = 4  # FoundationPose returns the identity silently for fewer pixels with depth


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """Poses of an object, best first.

    Attributes:
        object_to_camera: Transforms from the mesh's frame (z up) to the camera's (x right, y down, z forward), shape
            (N, 4, 4) [m].
        scores: Quality of the poses, in descending order, shape (N,), in a unit of the model.
        scale: Factors on the size of the mesh, shape (N,); 1 if the model does not estimate it.
        made_by: The model.
    """

    object_to_camera: Floats
    scores: Floats
    scale: Floats
    made_by: ModelIdentity


class PoseModel(Protocol):
    """The pose of a known mesh in an image (V_pose)."""

    def estimate_pose(self, image: Pixels, depth: Depth, K: Floats, mask: Mask, glb: bytes) -> PoseEstimate:
        """Estimate the pose of an object.

        Args:
            image: RGB image, shape (H, W, 3).
            depth: Depth [m], shape (H, W), 0 where unknown.
            K: Intrinsic matrix [px], shape (3, 3).
            mask: Pixels of the object, shape (H, W).
            glb: Mesh in meters.
        """


def _check_pose(request: Bundle, answer: Bundle) -> None:
    X_CO, scores = answer.members["object_to_camera"], answer.members["scores"]
    assert isinstance(X_CO, np.ndarray) and isinstance(scores, np.ndarray)
    if not len(X_CO):
        raise ConventionError("has no pose")
    check_transform(X_CO, "object_to_camera")
    if (np.diff(scores) > 0).any():
        raise ConventionError("has poses that are not sorted by `scores`, best first")
    blob, depth, K, mask = (request.members[name] for name in ("mesh", "depth", "K", "mask"))
    assert isinstance(blob, BundleFile) and isinstance(depth, np.ndarray)
    assert isinstance(K, np.ndarray) and isinstance(mask, np.ndarray)
    points = np.concatenate([part.vertices for part in parse_glb(blob.data)]) @ Z_UP[:3, :3]
    scale = answer.members.get("scale")
    low, high = points.min(axis=0), points.max(axis=0)
    corners = np.stack(np.meshgrid(*np.stack([low, high], axis=1), indexing="ij"), axis=-1).reshape(-1, 3)
    corners = corners * (float(scale[0]) if isinstance(scale, np.ndarray) else 1.0)
    millimeters = X_CO[0].copy()
    millimeters[:3, 3] /= 1000
    readings = {
        "": X_CO[0],
        "camera_to_object": np.linalg.inv(X_CO[0]),
        "the axes of an OpenGL camera": OPENGL_TO_OPENCV @ X_CO[0],
        "camera_to_object with the axes of an OpenGL camera": OPENGL_TO_OPENCV @ np.linalg.inv(X_CO[0]),
        "millimeters": millimeters,
    }
    wrong = {name: _misfit(reading, corners, depth, K, mask) for name, reading in readings.items()}
    if wrong[""]:
        fitting = next((name for name, misfit in wrong.items() if not misfit), "")
        raise ConventionError(f"has a pose {wrong['']}{f'; it fits as {fitting}' * bool(fitting)}")


def _misfit(X_CO: Floats, corners: Floats, depth: Depth, K: Floats, mask: Mask) -> str:
    """Return what is wrong with the place of a posed box, or an empty string."""
    seen = corners @ X_CO[:3, :3].T + X_CO[:3, 3]
    center = seen.mean(axis=0)
    if center[2] <= 0:
        return "behind the camera"
    known = depth[mask & (depth > 0)]
    size = float(np.linalg.norm(corners.max(axis=0) - corners.min(axis=0)))
    distance = float(np.median(known)) if known.size else float(center[2])
    if abs(center[2] - distance) > size + (DISTANCE_RATIO - 1) * distance:
        return f"at a distance of {center[2]:.3g} m, where the depth is {distance:.3g} m"
    pixels = seen[:, :2] / np.maximum(seen[:, 2:], 1e-3) * [K[0, 0], K[1, 1]] + [K[0, 2], K[1, 2]]
    rows, columns = np.nonzero(mask)
    low = np.maximum(pixels.min(axis=0), [columns.min(), rows.min()])
    high = np.minimum(pixels.max(axis=0), [columns.max() + 1, rows.max() + 1])
    inner = float(np.prod(np.maximum(high - low, 0)))
    of_mask = float((np.ptp(columns) + 1) * (np.ptp(rows) + 1))
    of_box = float(np.prod(np.ptp(pixels, axis=0)))
    return "" if inner > BOX_OVERLAP * max(of_mask, min(of_box, 1 / BOX_OVERLAP * of_mask)) else "beside its mask"


POSE = ModelTask(
    "pose", "V_pose", "the pose of a known mesh in an image with depth",
    (
        IMAGE, DEPTH_OF_IMAGE, Member("K", "array", "intrinsic matrix", (3, 3), "float64", unit="px"),
        Member("mask", "array", "pixels of the object", ("H", "W"), "bool"),
        Member("mesh", "glb", "mesh in meters, in the axes of the file", frame=MESH),
    ),
    (
        Member("object_to_camera", "array", "poses of the axes of the GLB file, best first", ("N", 4, 4), "float64",
               unit="m", frame=CAMERA),
        Member("scores", "array", "quality, descending", ("N",), "float64"),
        Member("scale", "array", "factor on the size of the mesh", ("N",), "float64", low=1e-3, high=1e3,
               is_optional=True),
    ),
    checks=(_check_pose,),
)  # fmt: skip


@dataclass(frozen=True)
class BundlePoses:
    """The task about poses, solved by servers that speak ``bundle/1``."""

    client: ModelClient

    def estimate_pose(self, image: Pixels, depth: Depth, K: Floats, mask: Mask, glb: bytes) -> PoseEstimate:
        """Estimate the pose of an object; see :class:`PoseModel`."""
        known = np.nan_to_num(np.asarray(depth, dtype=np.float32), nan=0.0, posinf=0.0, neginf=0.0)
        if np.count_nonzero(known[mask] > 0) < FEWEST_DEPTHS:
            raise ModelError(f"a pose needs at least {FEWEST_DEPTHS} pixels with depth in the mask of the object")
        arrays: Members = {"depth": known, "K": np.asarray(K, dtype=np.float64), "mask": mask.astype(np.bool_)}
        got = self.client.ask(POSE, {"image": BundleImage(image), **arrays, "mesh": BundleFile("glb", glb)})
        scores, scale = got.array("scores"), got.optional("scale")
        scale = np.ones(len(scores)) if scale is None else scale
        return PoseEstimate(got.array("object_to_camera") @ np.linalg.inv(Z_UP), scores, scale, got.made_by)
