"""Depth from one image, from several, from a stereo pair, and depth maps with holes (V_im2depth, V_inpaint^depth)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from simfoundry.models.client import ModelClient
from simfoundry.models.contract import CAMERA, ConventionError, Member, ModelTask
from simfoundry.models.geometry_checks import (
    OPENGL_TO_OPENCV,
    check_depth_unit,
    check_intrinsics,
    check_transform,
    overlap,
    points_of,
)
from simfoundry.models.provenance import ModelIdentity
from simfoundry.models.wire import Bundle, BundleImage

Floats = NDArray[np.float64]
Depth = NDArray[np.float32]
Pixels = NDArray[np.uint8]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class DepthEstimate:
    """Depth of an image.

    Attributes:
        depth: Distance along the optical axis [m], shape (H, W), 0 where unknown.
        confidence: Confidence, 0 to 1, shape (H, W), or None.
        K: Intrinsic matrix [px] for the image, shape (3, 3), or None if the model neither needs nor estimates it.
        made_by: The model.
    """

    depth: Depth
    confidence: Depth | None
    K: Floats | None
    made_by: ModelIdentity


class DepthModel(Protocol):
    """Metric depth from a single image."""

    def estimate_depth(self, image: Pixels, K: Floats | None = None) -> DepthEstimate:
        """Estimate the depth of an image.

        Args:
            image: RGB image, shape (H, W, 3).
            K: Intrinsic matrix [px], shape (3, 3), if it is known.

        Raises:
            ModelError: If there is no usable answer.
        """


@dataclass(frozen=True, eq=False)
class MultiviewEstimate:
    """Depth and cameras of several images of one scene.

    Attributes:
        depth: Distances along the optical axes [m], shape (N, H, W), 0 where unknown.
        confidence: Confidence, 0 to 1, shape (N, H, W), or None.
        K: Intrinsic matrices [px], shape (N, 3, 3).
        world_to_camera: Transforms from the first camera's frame, or any other common frame, into each camera's frame
            (x right, y down, z forward), shape (N, 4, 4) [m].
        made_by: The model.
    """

    depth: Depth
    confidence: Depth | None
    K: Floats
    world_to_camera: Floats
    made_by: ModelIdentity


class MultiviewModel(Protocol):
    """Metric depth and poses from several images."""

    def estimate_views(self, images: Sequence[Pixels]) -> MultiviewEstimate:
        """Estimate depth and cameras. ``images`` are RGB, of one shape (H, W, 3)."""


@dataclass(frozen=True, eq=False)
class StereoEstimate:
    """Depth of the left image of a rectified stereo pair.

    Attributes:
        disparity: Shift to the left from the left to the right image [px], shape (H, W), 0 where unknown.
        depth: ``fx * baseline / disparity`` [m], shape (H, W), 0 where unknown.
        valid: Pixels whose depth is known, shape (H, W).
        made_by: The model.
    """

    disparity: Depth
    depth: Depth
    valid: Mask
    made_by: ModelIdentity


class StereoModel(Protocol):
    """Depth from a rectified stereo pair."""

    def match_stereo(self, left: Pixels, right: Pixels, K: Floats, baseline_m: float) -> StereoEstimate:
        """Estimate the depth of the left image.

        Args:
            left: RGB image of the left camera, shape (H, W, 3).
            right: RGB image of the right camera, rectified to the left one, shape (H, W, 3).
            K: Intrinsic matrix of both images [px], shape (3, 3).
            baseline_m: Distance between the cameras [m].
        """


class DepthCompletionModel(Protocol):
    """Depth in the holes of a measured depth map (V_inpaint^depth)."""

    def complete_depth(self, image: Pixels, depth: Depth, mask: Mask) -> DepthEstimate:
        """Fill the holes of a depth map.

        Args:
            image: RGB image, shape (H, W, 3).
            depth: Depth [m], shape (H, W), 0 where unknown.
            mask: Pixels whose depth is wanted, whatever ``depth`` contains there, shape (H, W).
        """


IMAGE = Member("image", "image", "RGB image", ("H", "W"))
CONFIDENCE = Member("confidence", "array", "confidence", ("H", "W"), low=0, high=1, is_optional=True)
DEPTH_OF_IMAGE = Member(
    "depth", "array", "distance along the optical axis, 0 where unknown", ("H", "W"), unit="m", frame=CAMERA
)
K_OPTIONAL = Member("K", "array", "intrinsic matrix for the image", (3, 3), "float64", unit="px", is_optional=True)
# Fraction of points that must agree better in another convention before an answer counts as wrong. Depth of real images
# agrees with itself on 60 to 95 % of the points; a wrong convention on below 10 %.
CLEARLY_BETTER = 2.0


def _array(bundle: Bundle, name: str) -> Any:
    return bundle.members[name]


def _check_depth(request: Bundle, answer: Bundle) -> None:
    depth = _array(answer, "depth")
    check_depth_unit(depth)
    K = answer.members.get("K")
    if isinstance(K, np.ndarray):
        check_intrinsics(K, depth.shape[1], depth.shape[0])
        given = request.members.get("K")
        if isinstance(given, np.ndarray) and not np.allclose(K, given, rtol=0.02, atol=2.0):
            raise ConventionError("has a `K` that differs from the one in the request; is it for a resized image?")


def _check_views(_: Bundle, answer: Bundle) -> None:
    depth, K, X_CW = (_array(answer, name) for name in ("depth", "K", "world_to_camera"))
    for k in range(len(depth)):
        check_depth_unit(depth[k])
        check_intrinsics(K[k], depth.shape[2], depth.shape[1])
    check_transform(X_CW, "world_to_camera")
    if len(depth) < 2:
        return
    flip = OPENGL_TO_OPENCV
    conventions = {
        "": X_CW,
        "camera_to_world instead of world_to_camera": np.linalg.inv(X_CW),
        "the axes of OpenGL cameras": flip @ X_CW,
        "camera_to_world with the axes of OpenGL cameras": flip @ np.linalg.inv(X_CW),
    }
    agreement = {name: _agreement(depth, K, matrices) for name, matrices in conventions.items()}
    best = max(agreement, key=lambda name: agreement[name])
    if best and agreement[best] > max(0.3, CLEARLY_BETTER * agreement[""]):
        raise ConventionError(
            f"has poses whose views agree on {agreement['']:.0%} of their points, but on {agreement[best]:.0%} if they "
            f"are read as {best}"
        )


def _agreement(depth: Depth, K: Floats, X_CW: Floats) -> float:
    """Return the mean overlap of each view with the next one."""
    step = max(1, int(np.sqrt(depth[0].size / 2000)))  # about 2000 points per view
    pairs = []
    for k in range(len(depth) - 1):
        points = points_of(depth[k], K[k], step)
        X_next = X_CW[k + 1] @ np.linalg.inv(X_CW[k])
        moved = points @ X_next[:3, :3].T + X_next[:3, 3]
        pairs.append(overlap(depth[k + 1], K[k + 1], moved))
    return float(np.mean(pairs))


def _check_stereo(request: Bundle, answer: Bundle) -> None:
    disparity, depth, valid = (_array(answer, name) for name in ("disparity", "depth", "valid"))
    if not valid.any():
        raise ConventionError("has no valid pixel")
    if (disparity[valid] <= 0).any():
        raise ConventionError("has `disparity` that is not positive at valid pixels; are left and right swapped?")
    product = float(_array(request, "K")[0, 0] * _array(request, "baseline")[0])
    ratio = float(np.median(depth[valid] * disparity[valid])) / product
    if not 0.98 < ratio < 1.02:
        unit = "; is the depth in millimeters?" if 900 < ratio < 1100 else ""
        raise ConventionError(f"has `depth` that is {ratio:.4g} times fx * baseline / disparity{unit}")
    check_depth_unit(np.where(valid, depth, 0))
    left, right = (request.members[name] for name in ("left", "right"))
    assert isinstance(left, BundleImage) and isinstance(right, BundleImage)
    errors = {sign: _warp_error(left.pixels, right.pixels, sign * disparity, valid) for sign in (1, -1)}
    if errors[1] > 3 + 2 * errors[-1]:  # 3 of 255 gray levels are noise
        raise ConventionError(
            "has `disparity` that matches the images only in the other direction; are left and right swapped?"
        )


def _warp_error(left: Pixels, right: Pixels, shift: Depth, valid: Mask) -> float:
    """Return the median difference between the left image and the shifted right image, in gray levels of 0 to 255."""
    v, u = np.nonzero(valid)
    step = max(1, len(v) // 20_000)
    v, u = v[::step], u[::step]
    source = np.rint(u - shift[v, u]).astype(np.int64)
    inside = (source >= 0) & (source < left.shape[1])
    if not inside.any():
        return 255.0
    a, b = left[v[inside], u[inside]].astype(np.float64), right[v[inside], source[inside]]
    return float(np.median(np.abs(a - b).mean(axis=1)))


def _check_completion(request: Bundle, answer: Bundle) -> None:
    prior, mask, depth = _array(request, "depth"), _array(request, "mask"), _array(answer, "depth")
    check_depth_unit(depth)
    known = (prior > 0) & ~mask & (depth > 0)
    if known.any():
        ratio = float(np.median(depth[known] / prior[known]))
        if not 0.9 < ratio < 1.1:
            raise ConventionError(f"has `depth` that is {ratio:.4g} times the measured depth where it was measured")
    if mask.any() and (depth[mask] > 0).mean() < 0.5:
        raise ConventionError(f"has depth in only {(depth[mask] > 0).mean():.0%} of the hole that it was to fill")


DEPTH = ModelTask(
    "depth", "V_im2depth", "metric depth from one image", (IMAGE, K_OPTIONAL),
    (DEPTH_OF_IMAGE, CONFIDENCE, K_OPTIONAL), checks=(_check_depth,),
)  # fmt: skip

MULTIVIEW = ModelTask(
    "multiview", "V_im2depth", "metric depth and camera poses from several images",
    (Member("images", "images", "RGB images of one size", ("N", "H", "W")),),
    (
        Member("depth", "array", "distance along the optical axis, 0 where unknown", ("N", "H", "W"), unit="m",
               frame=CAMERA),
        Member("confidence", "array", "confidence", ("N", "H", "W"), low=0, high=1, is_optional=True),
        Member("K", "array", "intrinsic matrices for the images", ("N", 3, 3), "float64", unit="px"),
        Member("world_to_camera", "array", "poses", ("N", 4, 4), "float64", unit="m", frame=CAMERA),
    ),
    checks=(_check_views,),
)  # fmt: skip

STEREO = ModelTask(
    "stereo", "V_im2depth", "depth of the left image of a rectified stereo pair",
    (
        Member("left", "image", "left RGB image", ("H", "W")),
        Member("right", "image", "right RGB image", ("H", "W")),
        Member("K", "array", "intrinsic matrix of both images", (3, 3), "float64", unit="px"),
        Member("baseline", "array", "distance between the cameras", (1,), "float64", unit="m", low=1e-4, high=10),
    ),
    (
        Member("disparity", "array", "shift to the left from left to right", ("H", "W"), unit="px"),
        DEPTH_OF_IMAGE,
        Member("valid", "array", "pixels whose depth is known", ("H", "W"), "bool"),
    ),
    checks=(_check_stereo,),
)  # fmt: skip

COMPLETE_DEPTH = ModelTask(
    "complete_depth", "V_inpaint^depth", "depth in the holes of a measured depth map",
    (IMAGE, DEPTH_OF_IMAGE, Member("mask", "array", "pixels whose depth is wanted", ("H", "W"), "bool")),
    (DEPTH_OF_IMAGE, CONFIDENCE), checks=(_check_completion,),
)  # fmt: skip


@dataclass(frozen=True)
class BundleDepth:
    """All tasks about depth, solved by servers that speak ``bundle/1``."""

    client: ModelClient

    def estimate_depth(self, image: Pixels, K: Floats | None = None) -> DepthEstimate:
        """Estimate the depth of an image; see :class:`DepthModel`."""
        given = None if K is None else np.asarray(K, dtype=np.float64)
        got = self.client.ask(DEPTH, {"image": BundleImage(image), "K": given})
        return DepthEstimate(got.array("depth"), got.optional("confidence"), got.optional("K"), got.made_by)

    def estimate_views(self, images: Sequence[Pixels]) -> MultiviewEstimate:
        """Estimate depth and cameras; see :class:`MultiviewModel`."""
        got = self.client.ask(MULTIVIEW, {"images": tuple(map(BundleImage, images))})
        depth, K, poses = (got.array(name) for name in ("depth", "K", "world_to_camera"))
        return MultiviewEstimate(depth, got.optional("confidence"), K, poses, got.made_by)

    def match_stereo(self, left: Pixels, right: Pixels, K: Floats, baseline_m: float) -> StereoEstimate:
        """Estimate the depth of the left image; see :class:`StereoModel`."""
        numbers = {"K": np.asarray(K, dtype=np.float64), "baseline": np.array([baseline_m], dtype=np.float64)}
        got = self.client.ask(STEREO, {"left": BundleImage(left), "right": BundleImage(right), **numbers})
        return StereoEstimate(got.array("disparity"), got.array("depth"), got.array("valid"), got.made_by)

    def complete_depth(self, image: Pixels, depth: Depth, mask: Mask) -> DepthEstimate:
        """Fill the holes of a depth map; see :class:`DepthCompletionModel`."""
        prior = np.nan_to_num(np.asarray(depth, dtype=np.float32), nan=0.0, posinf=0.0, neginf=0.0)
        got = self.client.ask(
            COMPLETE_DEPTH, {"image": BundleImage(image), "depth": prior, "mask": mask.astype(np.bool_)}
        )
        return DepthEstimate(got.array("depth"), got.optional("confidence"), None, got.made_by)
