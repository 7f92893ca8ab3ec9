"""Depth from what sensors provide: distorted images, stereo pairs, and color alone with a model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import FARTHEST, NEAREST, in_range
from simfoundry.geometry.frames import Array
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
