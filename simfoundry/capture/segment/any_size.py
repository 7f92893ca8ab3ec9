"""Support and segmentation of images of any size: large ones are examined at a lower resolution."""

from __future__ import annotations

from dataclasses import replace

from simfoundry.capture.frame import Frame, Segmentation, SupportSurface
from simfoundry.capture.frames.reduced import enlarged, reduced_frame, reduced_support, reduction
from simfoundry.capture.segment.decompose import decompose
from simfoundry.capture.segment.find_support import find_support


def support_of(frame: Frame) -> SupportSurface:
    """Find the surface that supports the objects, as :func:`find_support` does.

    A surface that a person states by one of its pixels is examined in the image itself.

    Raises:
        CaptureError: The depth is unusable, or no plane is found.
    """
    step = reduction(frame.depth.shape)
    if step == 1 or frame.support is not None:
        return find_support(frame)
    found = find_support(reduced_frame(frame, step))
    middle = step // 2
    rivals = tuple(
        replace(rival, pixel=(rival.pixel[0] * step + middle, rival.pixel[1] * step + middle)) for rival in found.rivals
    )
    shape = frame.depth.shape
    levels = tuple(replace(level, inliers=enlarged(level.inliers, step, shape)) for level in found.levels)
    return replace(found, inliers=enlarged(found.inliers, step, shape), rivals=rivals, levels=levels)


def segmentation_of(frame: Frame, support: SupportSurface) -> Segmentation:
    """Segment the objects on ``support``, as :func:`decompose` does.

    Given masks, and constraints that name pixels, are followed in the image itself.

    Raises:
        CaptureError: The depth is unusable, or no object is found.
    """
    step = reduction(frame.depth.shape)
    if step == 1 or frame.instances is not None or frame.decomposition is not None:
        return decompose(frame, support)
    found = decompose(reduced_frame(frame, step), reduced_support(support, step))
    return replace(found, labels=enlarged(found.labels, step, frame.depth.shape))
