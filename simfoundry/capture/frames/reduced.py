"""Large images at a lower resolution.

Geometry is found at the resolution of depth cameras, because their noise and not the number of pixels limits it. Only
colors, masks and pictures have all pixels.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import Frame, Segmentation, SupportSurface

T = TypeVar("T", bound=np.generic)

# Largest number of pixels whose geometry is examined one by one: depth cameras have 1280 x 720 (RealSense) to
# 1024 x 1024 (Azure Kinect). The time and the memory of everything else grow with it.
MOST_PIXELS = 1280 * 1024


def reduction(shape: tuple[int, ...]) -> int:
    """Return the step between the rows and columns of an image of shape (h, w) that are examined; 1 means all."""
    step = 1
    while (shape[0] // step) * (shape[1] // step) > MOST_PIXELS:
        step += 1
    return step


def reduced(image: NDArray[T], step: int) -> NDArray[T]:
    """Return the middle pixel of each block of ``step`` x ``step`` pixels of an image of shape (h, w, ...)."""
    return image if step == 1 else np.ascontiguousarray(image[step // 2 :: step, step // 2 :: step])


def enlarged(image: NDArray[T], step: int, shape: tuple[int, ...]) -> NDArray[T]:
    """Return a reduced image at its original shape (h, w), with equal pixels in each block."""
    rows = np.minimum(np.arange(shape[0]) // step, image.shape[0] - 1)
    columns = np.minimum(np.arange(shape[1]) // step, image.shape[1] - 1)
    return np.ascontiguousarray(image[rows[:, None], columns])


def reduced_frame(frame: Frame, step: int) -> Frame:
    """Return every ``step``-th pixel of a frame, with its intrinsics."""
    if step == 1:
        return frame
    K = frame.K.copy()
    K[:2, 2] -= step // 2
    K[:2] /= step
    instances = None if frame.instances is None else reduced(frame.instances, step)
    return replace(frame, color=reduced(frame.color, step), depth=reduced(frame.depth, step), K=K, instances=instances)


def reduced_support(support: SupportSurface, step: int) -> SupportSurface:
    """Return a surface in a reduced image."""
    levels = tuple(replace(level, inliers=reduced(level.inliers, step)) for level in support.levels)
    return replace(support, inliers=reduced(support.inliers, step), levels=levels)


def reduced_segmentation(segmentation: Segmentation, step: int) -> Segmentation:
    """Return a segmentation in a reduced image. Objects without a pixel in it remain, without pixels."""
    return replace(segmentation, labels=reduced(segmentation.labels, step))
