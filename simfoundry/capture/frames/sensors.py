"""Depth from what sensors provide: distorted and unregistered images, stereo pairs, and color alone with a model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import FARTHEST, NEAREST, Frame, in_range
from simfoundry.geometry.frames import Array, Pose
from simfoundry.models.contract import ModelError
from simfoundry.models.open import open_model
from simfoundry.models.provenance import ModelIdentity
from simfoundry.models.setup import ModelSetup

T = TypeVar("T", bound=np.generic)


def undistorted(image: NDArray[T], K: Array, distortion: Sequence[float], smooth: bool = False) -> NDArray[T]:
    """Return an image as a pinhole camera with the same intrinsics would see it.

    Args:
        image: The image, shape (h, w) or (h, w, 3).
        K: Intrinsic matrix [px], shape (3, 3).
        distortion: Coefficients of the lens in the order of OpenCV; none for an image that is not distorted.
        smooth: Whether to interpolate, as is right for colors. Depth and labels are taken from the nearest pixel.

    Returns:
        The image, in which pixels that the camera does not see are 0, or NaN for floating-point numbers.
    """
    if not any(distortion):
        return image
    import cv2

    height, width = image.shape[:2]
    u, v = cv2.initUndistortRectifyMap(K, np.array(distortion), None, K, (width, height), cv2.CV_32FC1)
    outside = float("nan") if image.dtype.kind == "f" else 0
    interpolation = cv2.INTER_LINEAR if smooth else cv2.INTER_NEAREST
    # OpenCV does not resample 64-bit numbers; depth is as exact in 32 bits as any sensor, and labels are small.
    source = image if image.dtype == np.uint8 else image.astype(np.float32)
    out = cv2.remap(source, u, v, interpolation, borderMode=cv2.BORDER_CONSTANT, borderValue=outside)
    return np.asarray(out, dtype=image.dtype)


def register(depth: Array, K_depth: Array, X_color_depth: Pose, K_color: Array, size: tuple[int, int]) -> Array:
    """Reproject depth [m] into the color camera.

    Each measurement covers the area of its pixel, projected into the color image. If several measurements cover the
    same pixel, the nearest one is used.

    Returns:
        Depth [m] of shape ``size`` (height, width). Pixels that no measurement covers are NaN.
    """
    height, width = size
    points = Frame(np.zeros((*depth.shape, 3), np.uint8), depth, K_depth).points[np.isfinite(depth)]
    x, y, z = X_color_depth.apply(points).T
    ahead = z > NEAREST
    x, y, z = x[ahead], y[ahead], z[ahead]
    u, v = x / z * K_color[0, 0] + K_color[0, 2], y / z * K_color[1, 1] + K_color[1, 2]
    half = 0.5 * max(K_color[0, 0] / K_depth[0, 0], K_color[1, 1] / K_depth[1, 1])
    out = np.full(height * width, np.inf)
    reach = int(np.ceil(2 * half))
    left, top = np.ceil(u - half).astype(int), np.ceil(v - half).astype(int)
    for dv in range(reach):
        for du in range(reach):
            column, row = left + du, top + dv
            inside = (
                (column < u + half) & (row < v + half) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
            )
            np.minimum.at(out, row[inside] * width + column[inside], z[inside])
    return np.where(np.isfinite(out), out, np.nan).reshape(height, width)


def stereo_depth(
    left: NDArray[np.uint8], right: NDArray[np.uint8], K: Array, baseline: float, setup: ModelSetup
) -> tuple[Array, ModelIdentity]:
    """Return the depth [m] of the left image of a rectified stereo pair, and what found it.

    The model of the task `stereo` is used if one is configured, and otherwise semi-global matching with a check that
    both images agree. Pixels without depth are NaN.

    Raises:
        ModelError: No depth was found.
    """
    found = open_model(setup, "stereo").match_stereo(left, right, K, baseline)
    return _in_range(np.where(found.valid, found.depth, np.nan), "stereo matching"), found.made_by


def estimated_depth(color: NDArray[np.uint8], K: Array, setup: ModelSetup) -> tuple[Array, ModelIdentity]:
    """Return the depth [m] of an image, and the model of the task `depth` that estimates it.

    Pixels without depth are NaN.

    Raises:
        ModelError: No model is configured, or it found no depth.
    """
    found = open_model(setup, "depth").estimate_depth(color, K)
    depth = _in_range(np.where(found.depth > 0, found.depth, np.nan), "the model of the task `depth`")
    return depth, found.made_by


def _in_range(depth: NDArray[np.floating], who: str) -> Array:
    values: Array = np.asarray(depth, dtype=np.float64)
    with np.errstate(invalid="ignore"):
        values = np.where(in_range(values), values, np.nan)
    if not np.isfinite(values).any():
        raise ModelError(f"{who} found no depth between {NEAREST:g} and {FARTHEST:g} m")
    return values
