from __future__ import annotations

import numpy as np
import pytest

from simfoundry.capture.errors import CaptureError
from simfoundry.capture.frame import Frame, Segmentation
from simfoundry.capture.segment.decompose import decompose
from simfoundry.capture.segment.ground import find_support
from tests.capture.pictures import Box, Cylinder, Setup, photograph
from tests.corpora.segmentation import available, matched_iou, mosd_scores, pictures, segment

STACK = (
    Box((0.03, 0.11, 0.04), (0.16, 0.20, 0.08), 0.5),
    Box((0.04, 0.10, 0.115), (0.08, 0.09, 0.07), 0.1),
    Cylinder((-0.05, -0.13, 0.06), 0.04, 0.12),
)


def number_of(truth: np.ndarray, found: Segmentation, item: int) -> int:
    """The number that most pixels of a true item have been given."""
    return int(np.bincount(found.labels[truth == item]).argmax())


def segmented(setup: Setup) -> tuple[np.ndarray, Segmentation]:
    frame, truth = photograph(setup)
    return truth, segment(frame)[1]


def test_stack_and_cylinder() -> None:
    truth, found = segmented(Setup(STACK))
    assert sorted(found.supports) == [1, 2, 3]
    assert matched_iou(truth, found.labels).min() > 0.85
    lower, upper, can = (number_of(truth, found, k) for k in (1, 2, 3))
    assert found.supports == {lower: 0, upper: lower, can: 0}


def test_labels_are_dense_and_supports_complete() -> None:
    truth, found = segmented(Setup(STACK, eye=(-0.5, -0.45, 0.6)))
    assert found.labels.dtype == np.int32 and found.labels.shape == truth.shape
    assert sorted(found.supports) == np.unique(found.labels[found.labels > 0]).tolist()


def test_one_box_with_three_faces_is_one_object() -> None:
    truth, found = segmented(Setup((Box((0.0, 0.0, 0.07), (0.12, 0.16, 0.14), 0.6),)))
    assert sorted(found.supports) == [1]
    assert matched_iou(truth, found.labels)[0] > 0.9


def test_can_on_a_tin() -> None:
    truth, found = segmented(
        Setup((Cylinder((0.0, 0.0, 0.035), 0.10, 0.07), Cylinder((0.02, -0.01, 0.15), 0.035, 0.16)))
    )
    tin, can = number_of(truth, found, 1), number_of(truth, found, 2)
    assert found.supports == {tin: 0, can: tin}
    assert matched_iou(truth, found.labels).min() > 0.85


def test_box_in_front_of_a_box() -> None:
    truth, found = segmented(
        Setup((Box((0.12, 0.0, 0.09), (0.06, 0.26, 0.18)), Box((-0.06, 0.0, 0.08), (0.05, 0.09, 0.16))))
    )
    back, front = number_of(truth, found, 1), number_of(truth, found, 2)
    assert found.supports == {back: 0, front: 0}
    assert matched_iou(truth, found.labels).min() > 0.85


def test_an_occluder_does_not_cut_a_box_in_two() -> None:
    # The pillar is as tall as the box behind it appears, so that this shows in two unconnected parts.
    setup = Setup(
        (Box((0.12, 0.0, 0.05), (0.06, 0.34, 0.10)), Box((-0.12, 0.03, 0.14), (0.05, 0.06, 0.28))),
        eye=(-0.8, 0.06, 0.5),
        target=(0.0, 0.0, 0.05),
    )
    truth, found = segmented(setup)
    assert len(found.supports) == 2
    assert matched_iou(truth, found.labels).min() > 0.85


def test_given_masks_are_kept_and_cleaned() -> None:
    frame, truth = photograph(Setup(STACK))
    masks = np.where(truth > 0, truth * 10, 0).astype(np.int32)
    masks[5:8, 5:8] = 10  # a speck of the first far away
    masks[200:215, 150:165] = 77  # a mask on the bare table
    found = decompose(Frame(frame.color, frame.depth, frame.K, masks), find_support(frame))
    assert matched_iou(truth, found.labels).min() > 0.98
    assert (found.labels[5:8, 5:8] == 0).all()
    assert sorted(found.supports.values()) == [0, 0, 1]


def test_nothing_on_the_table() -> None:
    frame, _ = photograph(Setup(()))
    support = find_support(frame)
    with pytest.raises(CaptureError) as caught:
        decompose(frame, support)
    assert caught.value.code == "SF504" and caught.value.hint


def test_things_beside_the_table_are_left_out() -> None:
    item = Box((0.0, 0.0, 0.05), (0.1, 0.1, 0.1), 0.3)
    neighbour = Box((0.95, -0.2, -0.2), (0.3, 0.3, 1.0))  # stands on the floor behind the table and rises above it
    truth, found = segmented(Setup((item, neighbour), eye=(-0.7, 0.2, 0.7)))
    assert sorted(found.supports) == [1]
    assert number_of(truth, found, 1) == 1
    assert (found.labels[truth == 2] > 0).mean() < 0.02


def test_same_picture_same_bytes() -> None:
    frame, _ = photograph(Setup(STACK))
    support = find_support(frame)
    assert decompose(frame, support).labels.tobytes() == decompose(frame, support).labels.tobytes()


@pytest.mark.skipif(not available("mosd_dev"), reason="needs ../shared/data/mosd_dev")
def test_real_tables_with_known_instances() -> None:
    scores = mosd_scores()
    off = [abs(s.true - s.found) for s in scores]
    assert len(scores) == 12
    assert sum(d <= 1 for d in off) >= 12
    assert sum(d == 0 for d in off) >= 10
    assert np.mean([s.iou for s in scores]) > 0.93


@pytest.mark.skipif(not available("graspnet6dof"), reason="needs ../shared/data/graspnet6dof")
def test_one_object_on_a_real_table() -> None:
    for name, frame, _ in pictures("graspnet6dof"):
        assert len(segment(frame)[1].supports) == 1, name


@pytest.mark.skipif(not available("posecnn_demo"), reason="needs ../shared/data/posecnn_demo")
def test_noisy_scenes_of_household_objects() -> None:
    counts = {name: len(segment(frame)[1].supports) for name, frame, _ in pictures("posecnn_demo")}
    near = {"000001": 5, "000002": 5, "000003": 3, "000005": 5}
    assert all(abs(counts[name] - count) <= 1 for name, count in near.items()), counts


@pytest.mark.skipif(not available("m3t_desk"), reason="needs ../shared/data/m3t_desk")
def test_bottle_before_a_window() -> None:
    _, frame, entry = next(pictures("m3t_desk"))
    support, found = segment(frame)
    bottle = next(o for o in entry["objects"] if o["name"] == "shampoo_bottle")
    X_CB = np.array(bottle["T_cam_obj"])
    label = int(found.labels[tuple(np.round((frame.K @ X_CB[:3, 3] / X_CB[2, 3])[[1, 0]]).astype(int))])
    assert label > 0
    seen_W = support.X_WC.apply(frame.points[found.labels == label])
    bottle_W = support.X_WC.apply(X_CB[:3, 3])
    lo, hi = np.quantile(seen_W[:, 2], [0.02, 0.98])
    assert hi == pytest.approx(0.192, abs=0.02) and lo < 0.03, "the bottle is 19.2 cm tall"
    # The camera sees one side of a bottle 3.4 x 7.5 cm wide.
    assert np.linalg.norm(np.median(seen_W[:, :2], axis=0) - bottle_W[:2]) < 0.025
