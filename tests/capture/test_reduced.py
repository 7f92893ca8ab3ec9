"""Large images: their geometry is found at a lower resolution, and fits all of their pixels."""

from dataclasses import replace

import numpy as np
import pytest

from simfoundry.capture.frame import Frame, Segmentation
from simfoundry.capture.frames.reduced import (
    MOST_PIXELS,
    enlarged,
    reduced,
    reduced_frame,
    reduced_segmentation,
    reduction,
)
from simfoundry.capture.reconstruct import fit_segments
from simfoundry.capture.segment.any_size import segmentation_of, support_of
from simfoundry.geometry.shapes import Box
from tests.capture.depth_camera import see, yaw_pose


@pytest.mark.parametrize(
    ("shape", "step"), [((480, 640), 1), ((720, 1280), 1), ((1024, 1280), 1), ((1080, 1920), 2), ((2160, 3840), 3)]
)
def test_only_images_beyond_those_of_depth_cameras_are_reduced(shape: tuple[int, int], step: int) -> None:
    assert reduction(shape) == step
    h, w = shape
    assert (h // step) * (w // step) <= MOST_PIXELS


@pytest.mark.parametrize("step", [1, 2, 3, 5])
@pytest.mark.parametrize("shape", [(30, 45), (31, 44), (32, 47)])
def test_points_of_a_reduced_frame_are_points_of_the_frame(shape: tuple[int, int], step: int) -> None:
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.5, 2.0, shape)
    K = np.array([[40.0, 0, 21.3], [0, 41.0, 14.9], [0, 0, 1]])
    color = rng.integers(0, 256, (*shape, 3)).astype(np.uint8)
    frame = Frame(color, depth, K, rng.integers(0, 9, shape).astype(np.int32))
    small = reduced_frame(frame, step)
    assert np.allclose(small.points, reduced(frame.points, step), atol=1e-12)
    assert np.array_equal(small.color, reduced(color, step)) and frame.K[0, 2] == 21.3
    assert small.instances is not None and frame.instances is not None
    assert np.array_equal(reduced(enlarged(small.instances, step, shape), step), small.instances)
    assert enlarged(small.depth, step, shape).shape == shape
    labels = frame.instances
    assert reduced_segmentation(Segmentation(labels, {1: 0}), step).supports == {1: 0}


def test_points_under_a_mask_are_those_of_the_image() -> None:
    rng = np.random.default_rng(1)
    depth = np.where(rng.random((20, 30)) < 0.2, np.nan, rng.uniform(0.5, 2.0, (20, 30)))
    frame = Frame(np.zeros((20, 30, 3), np.uint8), depth, np.array([[40.0, 0, 15], [0, 40, 10], [0, 0, 1]]))
    for mask in (rng.random((20, 30)) < 0.5, np.zeros((20, 30), bool)):
        assert np.array_equal(frame.points_of(mask), frame.points[mask], equal_nan=True)


@pytest.mark.slow  # 2 s: an image of 1280 x 960 pixels
def test_a_large_image_has_the_scene_of_a_small_one(monkeypatch: pytest.MonkeyPatch) -> None:
    size = np.array([0.1, 0.07, 0.12])
    frame, _, truth = see([(Box(size), yaw_pose(0.03, 0.02, 0.06, 25))])
    step, shape = 4, (4 * truth.shape[0], 4 * truth.shape[1])
    K = frame.K.copy()
    K[:2] *= step
    K[:2, 2] += step // 2
    large = Frame(enlarged(frame.color, step, shape), enlarged(frame.depth, step, shape), K)
    monkeypatch.setattr("simfoundry.capture.frames.reduced.MOST_PIXELS", truth.size)
    assert np.array_equal(reduced_frame(large, step).depth, frame.depth, equal_nan=True)
    support = support_of(large)
    assert support.inliers.shape == shape
    segmentation = segmentation_of(large, support)
    assert segmentation.labels.shape == shape and set(np.unique(segmentation.labels)) == {0, 1}
    both = np.logical_and(reduced(segmentation.labels, step) > 0, truth > 0).sum()
    assert both > 0.9 * max((truth > 0).sum(), (reduced(segmentation.labels, step) > 0).sum())
    shapes, _, findings = fit_segments(large, support, segmentation, lambda stage, share: None)
    small = replace(segmentation, labels=reduced(segmentation.labels, step))
    same, _, _ = fit_segments(frame, support, small, lambda stage, share: None)
    assert not findings and isinstance(shapes[1].geometry, Box)
    assert np.abs(np.sort(shapes[1].geometry.size) - np.sort(size)).max() < 0.006
    assert np.array_equal(shapes[1].X_WO.p, same[1].X_WO.p)
