"""Boxes without a lid: their rim, and the division from what is in them."""

from __future__ import annotations

import numpy as np
import pytest

from simfoundry.capture.frame import Frame, Segmentation, SupportSurface
from simfoundry.capture.segment.decompose import decompose
from simfoundry.capture.segment.open_boxes import RimRectangle
from simfoundry.capture.shapes.fit_open_box import open_box_mesh
from simfoundry.geometry.frames import Pose
from simfoundry.geometry.shapes import Box, Cylinder
from tests.capture.depth_camera import Solid, see, yaw_pose

SIZE, WALL = np.array([0.24, 0.18, 0.07]), 0.006
BIN: Solid = (open_box_mesh(SIZE, WALL), yaw_pose(0.03, 0.0, SIZE[2] / 2, 25))
# In the frame of the bin: against its far long wall, and in the middle.
AT_WALL: Solid = (Box(np.array([0.05, 0.04, 0.1])), BIN[1] @ Pose.of((0.02, 0.063, 0.016 + WALL)))
FREE: Solid = (Cylinder(0.025, 0.05), BIN[1] @ Pose.of((-0.06, -0.02, WALL - 0.01)))


def found(solids: list[Solid]) -> tuple[Frame, SupportSurface, Segmentation, np.ndarray]:
    frame, support, truth = see(solids)
    return frame, support, decompose(frame, support), truth


def test_a_point_is_as_far_from_a_rim_as_its_nearest_side() -> None:
    rim = RimRectangle(np.zeros(2), np.eye(2), np.array([0.2, 0.1]))
    points = np.array([[0.0, 0.0, 1.0], [0.19, 0.0, 0.0], [0.23, 0.14, 0.0], [0.0, -0.13, 0.0]])
    assert np.allclose(rim.beyond(points), [-0.1, -0.01, 0.05, 0.03])
    assert rim.overlaps(RimRectangle(np.array([0.1, 0.0]), np.eye(2), np.array([0.05, 0.05])))
    assert not rim.overlaps(RimRectangle(np.array([0.4, 0.0]), np.eye(2), np.array([0.1, 0.1])))


@pytest.mark.slow
def test_a_bin_is_divided_from_what_touches_its_wall() -> None:
    _, _, segmentation, truth = found([BIN, AT_WALL, FREE])
    labels, supports = segmentation.labels, segmentation.supports
    assert labels.max() == 3
    number = {k: int(np.bincount(labels[truth == k]).argmax()) for k in (1, 2, 3)}
    for k, own in number.items():
        union = (truth == k) | (labels == own)
        assert own > 0 and ((truth == k) & (labels == own)).sum() > 0.75 * union.sum(), k
    assert supports == {number[1]: 0, number[2]: number[1], number[3]: number[1]}


@pytest.mark.slow
def test_a_closed_box_of_the_same_size_is_no_bin() -> None:
    closed: Solid = (Box(SIZE), BIN[1])
    on_it: Solid = (Cylinder(0.025, 0.05), BIN[1] @ Pose.of((0.0, 0.0, SIZE[2] / 2 + 0.025)))
    _, _, segmentation, truth = found([closed, on_it])
    assert segmentation.labels.max() == 2
    assert (segmentation.labels[truth == 1] == 0).mean() < 0.2
    lower, upper = (int(np.bincount(segmentation.labels[truth == k]).argmax()) for k in (1, 2))
    assert segmentation.supports == {lower: 0, upper: lower}
