from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from simfoundry.capture.frame import CaptureError, Frame, Segmentation
from simfoundry.capture.segment.decompose import decompose
from simfoundry.capture.segment.find_support import find_support
from tests.capture.pictures import Box, Cylinder, Setup, photograph
from tests.corpora.segmentation import available, matched_iou, mosd_pictures, mosd_scores, pictures, segment

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
    neighbor = Box((0.95, -0.2, -0.2), (0.3, 0.3, 1.0))  # stands on the floor behind the table and rises above it
    truth, found = segmented(Setup((item, neighbor), eye=(-0.7, 0.2, 0.7)))
    assert sorted(found.supports) == [1]
    assert number_of(truth, found, 1) == 1
    assert (found.labels[truth == 2] > 0).mean() < 0.02


def test_same_picture_same_bytes() -> None:
    frame, _ = photograph(Setup(STACK))
    support = find_support(frame)
    assert decompose(frame, support).labels.tobytes() == decompose(frame, support).labels.tobytes()


def test_lost_readings_within_a_silhouette_are_filled() -> None:
    frame, truth = photograph(Setup(STACK))
    lost = np.random.default_rng(5).random(frame.depth.shape) < 0.2
    lost[(truth == 3) & (np.arange(frame.depth.shape[0]) % 12 == 0)[:, None]] = True
    found = segment(Frame(frame.color, np.where(lost, np.nan, frame.depth), frame.K))[1]
    assert sorted(found.supports) == [1, 2, 3]
    assert (found.labels[lost & (truth > 0)] > 0).mean() > 0.85
    assert (found.labels[lost & (truth == 0)] > 0).mean() < 0.03


def painted(setup: Setup, colors: dict[int, tuple[int, int, int]]) -> tuple[np.ndarray, Segmentation]:
    """Like :func:`segmented`, with items in RGB colors."""
    frame, truth = photograph(setup)
    color = frame.color.copy()
    for item, rgb in colors.items():
        color[truth == item] = rgb
    return truth, segment(Frame(color, frame.depth, frame.K))[1]


def test_a_cap_beyond_lost_readings_is_part_of_its_bottle() -> None:
    bottle = (Cylinder((0.0, 0.02, 0.07), 0.035, 0.14), Cylinder((0.0, 0.02, 0.16), 0.018, 0.04))
    frame, truth = photograph(Setup(bottle, eye=(-0.6, 0.1, 0.25), target=(0.0, 0.02, 0.08)))
    rows = np.nonzero((truth == 2).any(axis=1))[0]
    lost = np.zeros(truth.shape, bool)
    lost[rows[-1] - 3 : rows[-1] + 4] = True
    found = segment(Frame(frame.color, np.where(lost, np.nan, frame.depth), frame.K))[1]
    assert found.supports == {1: 0}
    assert (found.labels[(truth == 2) & ~lost] == 1).mean() > 0.8


RED, BLUE = (200, 30, 25), (30, 60, 200)
# A lying bar on a thin neck: as a drill's head on its grip.
HAMMER = (Box((0.02, 0.03, 0.055), (0.035, 0.035, 0.11), 0.3), Box((0.02, 0.03, 0.135), (0.06, 0.2, 0.05), 0.3))


def test_a_wide_head_on_a_thin_neck_is_one_thing_if_of_one_hue() -> None:
    _, one = painted(Setup(HAMMER), {1: RED, 2: RED})
    truth, two = painted(Setup(HAMMER), {1: RED, 2: BLUE})
    assert one.supports == {1: 0}
    assert len(two.supports) == 2
    assert two.supports[number_of(truth, two, 2)] == number_of(truth, two, 1)


def test_equal_colors_do_not_join_what_stands_by_itself() -> None:
    truth, found = painted(Setup(STACK), {1: RED, 2: RED, 3: RED})
    assert sorted(found.supports) == [1, 2, 3]
    assert matched_iou(truth, found.labels).min() > 0.85


def test_what_a_nearer_thing_hides_does_not_stand_on_it() -> None:
    # All that is seen of the tall box begins where the top of the near one ends.
    setup = Setup(
        (Box((0.14, 0.0, 0.14), (0.06, 0.10, 0.28)), Box((-0.02, 0.0, 0.09), (0.06, 0.2, 0.18))),
        eye=(-0.75, 0.05, 0.4),
        target=(0.05, 0.0, 0.08),
    )
    truth, found = segmented(setup)
    assert len(found.supports) == 2
    assert set(found.supports.values()) == {0}
    assert matched_iou(truth, found.labels).min() > 0.85


# Some scenes only; all of them: python -m tests.corpora.segmentation --perturb
@pytest.mark.skipif(not available("mosd_dev"), reason="needs ../shared/data/mosd_dev")
@pytest.mark.parametrize(
    ("perturbation", "name"),
    [
        pytest.param("none", "test5", marks=pytest.mark.slow),
        pytest.param("sparser", "learn33", marks=pytest.mark.slow),
        pytest.param("mirrored", "learn17", marks=pytest.mark.slow),
    ],
)
def test_real_tables_with_known_instances(perturbation: str, name: str) -> None:
    (score,) = mosd_scores([name], perturbation)
    assert score.found == score.true
    assert score.iou > 0.85


# True stackings, by eye: what stands on what, by the numbers of the true masks; the bag of test44 bridges two things.
STACKED: dict[str, dict[int, set[int]]] = {
    "learn25": {2: {1}},
    "test16": {2: {1}, 3: {2}},
    "test20": {2: {1}},
    "test44": {3: {1}, 4: {1, 2}, 5: {2}},
    "test45": {3: {1}, 7: {6}},
}


@pytest.mark.skipif(not available("mosd_dev"), reason="needs ../shared/data/mosd_dev")
@pytest.mark.parametrize("name", [n if n == "learn25" else pytest.param(n, marks=pytest.mark.slow) for n in STACKED])
def test_real_stacks(name: str) -> None:
    ((_, frame),) = mosd_pictures([name])
    truth = frame.instances
    assert truth is not None
    found = segment(replace(frame, instances=None))[1]
    numbers = {int(k): number_of(truth, found, int(k)) for k in np.unique(truth[truth > 0])}
    assert sorted(numbers.values()) == sorted(found.supports)
    assert matched_iou(truth, found.labels).mean() > 0.85
    true_of = {number: k for k, number in numbers.items()} | {0: 0}
    for item, number in numbers.items():
        assert true_of[found.supports[number]] in STACKED[name].get(item, {0}), f"{name}: item {item}"


@pytest.mark.skipif(not available("graspnet6dof"), reason="needs ../shared/data/graspnet6dof")
@pytest.mark.parametrize("name", ["red_mug", pytest.param("green_bowl", marks=pytest.mark.slow)])
def test_one_object_on_a_real_table(name: str) -> None:
    ((_, frame, _),) = pictures("graspnet6dof", [name])
    assert len(segment(frame)[1].supports) == 1


# Household objects by eye, as the index of the data lists them: a drill in two poses, a clamp that touches it, a
# pitcher with a sunk lid and a handle, a bowl. In the last image, a carton is seen on both sides of a bottle and counts
# twice.
@pytest.mark.skipif(not available("posecnn_demo"), reason="needs ../shared/data/posecnn_demo")
@pytest.mark.parametrize(
    ("name", "count"),
    [
        pytest.param("000001", 5, marks=pytest.mark.slow),
        ("000003", 3),
        pytest.param("000004", 3, marks=pytest.mark.slow),
        pytest.param("000005", 6, marks=pytest.mark.slow),
    ],
)
def test_noisy_scenes_of_household_objects(name: str, count: int) -> None:
    ((_, frame, _),) = pictures("posecnn_demo", [name])
    support, found = segment(frame)
    assert set(found.supports.values()) == {0}
    assert len(found.supports) == count
    if name == "000003":
        bowl = found.labels == found.labels[320, 360]
        height = support.X_WC.apply(frame.points)[..., 2]
        assert (bowl & (height < 0.005)).sum() > 5000, "the bottom of the bowl is the bowl's"


@pytest.mark.slow
@pytest.mark.skipif(not available("m3t_desk"), reason="needs ../shared/data/m3t_desk")
def test_bottle_before_a_window() -> None:
    ((_, frame, entry),) = pictures("m3t_desk", ["color_200"])
    support, found = segment(frame)
    assert set(found.supports.values()) == {0}, "nothing on this desk stands on anything else"
    assert len(found.supports) <= 7, "can, bottle, block, brush, green piece, and what lies at the back of the desk"
    bottle = next(o for o in entry["objects"] if o["name"] == "shampoo_bottle")
    X_CB = np.array(bottle["T_cam_obj"])
    label = int(found.labels[tuple(np.round((frame.K @ X_CB[:3, 3] / X_CB[2, 3])[[1, 0]]).astype(int))])
    assert label > 0
    seen_W = support.X_WC.apply(frame.points[(found.labels == label) & np.isfinite(frame.depth)])
    bottle_W = support.X_WC.apply(X_CB[:3, 3])
    lo, hi = np.quantile(seen_W[:, 2], [0.02, 0.98])
    assert hi == pytest.approx(0.192, abs=0.02) and lo < 0.03, "the bottle is 19.2 cm tall"
    # The camera sees one side of a bottle 3.4 x 7.5 cm wide; the brush behind it is not the bottle's.
    assert np.linalg.norm(np.median(seen_W[:, :2], axis=0) - bottle_W[:2]) < 0.025
    assert (np.linalg.norm(seen_W[:, :2] - bottle_W[:2], axis=1) > 0.06).mean() < 0.05
