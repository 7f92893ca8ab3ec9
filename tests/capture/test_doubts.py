"""Doubts about an image: each damage is reported where it is, and an undamaged image gives rise to none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from simfoundry.capture.doubts.color_match import color_match
from simfoundry.capture.doubts.depth_faults import depth_faults, depth_noise, repeated_edges, support_curve
from simfoundry.capture.doubts.depth_steps import depth_steps
from simfoundry.capture.doubts.image_doubts import image_doubts
from simfoundry.capture.doubts.intrinsics import focal_fit
from simfoundry.capture.doubts.object_normals import object_normals
from simfoundry.capture.doubts.seams import roll_gain, seam_doubts, seams
from simfoundry.capture.doubts.size_priors import scale_doubt, support_width
from simfoundry.capture.findings import (
    BORDER,
    HOLE,
    IMPLAUSIBLE,
    JOINED,
    MERGED,
    NOISY,
    OFFSET,
    PARTS,
    REPEATED,
    SUPPORT_DOUBT,
    UNEXPLAINED,
    CaptureFinding,
)
from simfoundry.capture.frame import Frame, Segmentation, SupportRival, SupportSurface
from simfoundry.capture.segment.find_support import find_support
from tests.capture.pictures import Box, Cylinder, Setup, photograph

SETUP = Setup((Box((0.05, 0.12, 0.06), (0.10, 0.07, 0.12), 0.4), Cylinder((0.0, -0.14, 0.05), 0.035, 0.10)))


@pytest.fixture(scope="module")
def seen() -> tuple[Frame, SupportSurface, Segmentation]:
    frame, labels = photograph(SETUP)
    noise = np.random.default_rng(0).normal(0, 2, frame.color.shape)
    tones = np.array([[120, 90, 60], [200, 40, 30], [30, 60, 190]])[labels]
    frame = replace(frame, color=np.clip(tones + noise, 0, 255).astype(np.uint8))
    return frame, find_support(frame), Segmentation(labels, {1: 0, 2: 0})


def codes(found: tuple[CaptureFinding, ...]) -> list[str]:
    return [f.code for f in found]


def test_an_undamaged_image_is_not_doubted(seen: tuple[Frame, SupportSurface, Segmentation]) -> None:
    assert image_doubts(*seen) == ()


def test_a_hole_in_the_depth_is_outlined(seen: tuple[Frame, SupportSurface, Segmentation]) -> None:
    frame, support, segmentation = seen
    v, u = np.indices(frame.depth.shape)
    depth = np.where((u - 150) ** 2 + (v - 175) ** 2 < 15**2, np.nan, frame.depth)
    (hole,) = image_doubts(replace(frame, depth=depth), support, segmentation)
    assert hole.code == HOLE
    center = np.mean(hole.outline, axis=0)
    assert np.abs(center - (150, 175)).max() < 4


def test_what_belongs_to_no_object_is_outlined(seen: tuple[Frame, SupportSurface, Segmentation]) -> None:
    frame, support, segmentation = seen
    labels = np.where(segmentation.labels == 1, 0, segmentation.labels)
    (missing,) = image_doubts(frame, support, replace(segmentation, labels=labels))
    assert missing.code == UNEXPLAINED and "12 cm" in missing.message
    rows, columns = np.nonzero(segmentation.labels == 1)
    assert np.abs(np.mean(missing.outline, axis=0) - (columns.mean(), rows.mean())).max() < 12


def test_an_object_at_the_border(seen: tuple[Frame, SupportSurface, Segmentation]) -> None:
    frame, support, segmentation = seen
    middle = int(np.nonzero(segmentation.labels == 2)[1].mean())
    part = np.s_[:, :middle]
    cut = Frame(frame.color[part], frame.depth[part], frame.K)
    found = image_doubts(cut, replace(support, inliers=support.inliers[part]), replace(
        segmentation, labels=segmentation.labels[part]
    ))  # fmt: skip
    assert BORDER in codes(found)


def test_color_beside_depth(seen: tuple[Frame, SupportSurface, Segmentation]) -> None:
    frame, support, segmentation = seen
    shifted = replace(frame, color=np.roll(frame.color, (6, -14), axis=(0, 1)))
    (offset,) = image_doubts(shifted, support, segmentation)
    assert offset.code == OFFSET and "(-14, 6)" in offset.message
    assert image_doubts(replace(frame, color=np.full_like(frame.color, 90)), support, segmentation) == ()


def test_color_of_something_else(seen: tuple[Frame, SupportSurface, Segmentation]) -> None:
    frame, support, segmentation = seen
    patches = np.random.default_rng(2).integers(0, 255, (30, 40, 3), np.uint8)
    other = replace(frame, color=np.kron(patches, np.ones((8, 8, 1), np.uint8)))
    (mismatch,) = (f for f in image_doubts(other, support, segmentation) if f.code == OFFSET)
    assert "not in the color image" in mismatch.message


def test_an_object_that_is_not_in_the_color_image(seen: tuple[Frame, SupportSurface, Segmentation]) -> None:
    frame, support, segmentation = seen
    wrong = np.where((segmentation.labels == 1)[..., None], [[120, 90, 60]], frame.color).astype(np.uint8)
    match = color_match(replace(frame, color=wrong), segmentation.labels)
    assert match is not None and 0.3 < match.unmatched < 0.8
    (mismatch,) = image_doubts(replace(frame, color=wrong), support, segmentation)
    assert mismatch.code == OFFSET
    in_place = color_match(frame, segmentation.labels)
    assert in_place is not None and in_place.unmatched == 0


@pytest.mark.parametrize("factor", [0.2, 4.0])
def test_a_wrong_unit(seen: tuple[Frame, SupportSurface, Segmentation], factor: float) -> None:
    frame, _, segmentation = seen
    scaled = replace(frame, depth=frame.depth * factor)
    assert IMPLAUSIBLE in codes(image_doubts(scaled, find_support(scaled), segmentation))


def test_a_support_that_is_too_wide_for_a_table(seen: tuple[Frame, SupportSurface, Segmentation]) -> None:
    frame, support, segmentation = seen
    assert 0.5 < support_width(support) < 1.1
    scaled = replace(frame, depth=frame.depth * 1.25)  # by itself plausible
    points_W = support.X_WC.apply(frame.points) * 1.25
    assert not list(scale_doubt(scaled, support, segmentation.labels, points_W))
    wide = replace(support, outline=support.outline * 1.5 / support_width(support))
    (doubt,) = scale_doubt(scaled, wide, segmentation.labels, points_W)
    assert doubt.code == IMPLAUSIBLE and "1.5 m wide" in doubt.message


@pytest.mark.parametrize("added", [-0.03, 0.04])
def test_depth_with_a_constant_error(seen: tuple[Frame, SupportSurface, Segmentation], added: float) -> None:
    """The readings of a Kinect, in steps of an eighth of a pixel, stored in millimeters."""
    frame, support, segmentation = seen
    spacing = 0.125 / (575 * 0.075)
    measured = 1 / (np.round(1 / frame.depth / spacing) * spacing)
    stored = replace(frame, depth=np.round(measured, 3))
    steps = depth_steps(stored.depth)
    assert steps is not None and steps.is_certain and steps.added == 0
    off = replace(frame, depth=np.round(measured + added, 3))
    steps = depth_steps(off.depth)
    assert steps is not None and steps.is_certain and steps.added == pytest.approx(added, abs=0.006)
    found = image_doubts(off, support, segmentation)
    assert any(f"{abs(steps.added) * 100:.1f} cm too" in f.message for f in found if f.code == IMPLAUSIBLE)


def test_depth_without_steps_has_no_constant_error(seen: tuple[Frame, SupportSurface, Segmentation]) -> None:
    for depth in (seen[0].depth, np.round(seen[0].depth, 3), np.round(seen[0].depth + 0.03, 2)):
        steps = depth_steps(depth)
        assert steps is not None and not steps.is_certain


def test_intrinsics_of_no_camera(seen: tuple[Frame, SupportSurface, Segmentation]) -> None:
    frame, support, segmentation = seen
    K = frame.K + np.array([[0, 0, 60], [0, 0, 0], [0, 0, 0]])
    (odd,) = (f for f in image_doubts(replace(frame, K=K), support, segmentation) if f.code == IMPLAUSIBLE)
    assert "principal point" in odd.message


@pytest.mark.parametrize("factor", [0.7, 1.4])
def test_the_factor_of_a_wrong_focal_length_is_found(
    seen: tuple[Frame, SupportSurface, Segmentation], factor: float
) -> None:
    frame, support, segmentation = seen
    assert focal_fit(support, object_normals(frame, segmentation.labels)).factor == 1
    wrong = replace(frame, K=np.diag([factor, factor, 1.0]) @ (frame.K - [[0, 0, 158], [0, 0, 121], [0, 0, 0]])
                    + [[0, 0, 158], [0, 0, 121], [0, 0, 0]])  # fmt: skip
    support = find_support(wrong)
    assert abs(focal_fit(support, object_normals(wrong, segmentation.labels)).factor * factor - 1) < 0.1
    found = image_doubts(wrong, support, segmentation)
    assert any("focal length" in f.message for f in found) and PARTS not in codes(found)


def test_round_objects_alone_tell_the_focal_length() -> None:
    frame, labels = photograph(
        Setup((Cylinder((0.05, 0.1, 0.015), 0.07, 0.03), Cylinder((0.0, -0.12, 0.01), 0.08, 0.02)))
    )
    K = np.array([[0.7 * frame.K[0, 0], 0, frame.K[0, 2]], [0, 0.7 * frame.K[1, 1], frame.K[1, 2]], [0, 0, 1]])
    wrong = replace(frame, K=K)
    assert abs(focal_fit(find_support(wrong), object_normals(wrong, labels)).factor * 0.7 - 1) < 0.15


@pytest.mark.parametrize("spoiled", ["noise", "steps"])
def test_noise(seen: tuple[Frame, SupportSurface, Segmentation], spoiled: str) -> None:
    frame, support, segmentation = seen
    noise = np.random.default_rng(1).normal(0, 0.006, frame.depth.shape)
    depth = frame.depth + noise if spoiled == "noise" else np.round(frame.depth / 0.02) * 0.02
    assert NOISY in codes(image_doubts(replace(frame, depth=depth), support, segmentation))
    assert depth_noise(replace(frame, depth=frame.depth + noise), support) == pytest.approx(0.0061, abs=4e-4)


def test_a_support_that_is_not_flat(seen: tuple[Frame, SupportSurface, Segmentation]) -> None:
    frame, support, segmentation = seen
    (bent,) = image_doubts(frame, replace(support, residual=0.008), segmentation)
    assert bent.code == NOISY and "not flat" in bent.message


@pytest.mark.parametrize("shift", [(0, 9), (-11, 7)])
def test_an_image_exposed_twice(seen: tuple[Frame, SupportSurface, Segmentation], shift: tuple[int, int]) -> None:
    frame, support, segmentation = seen
    assert repeated_edges(frame.depth)[1] < 0.1
    depth = (frame.depth + np.roll(frame.depth, shift, axis=(0, 1))) / 2
    assert REPEATED in codes(image_doubts(replace(frame, depth=depth), support, segmentation))
    (du, dv), share = repeated_edges(depth)
    assert (dv, du) in (shift, (-shift[0], -shift[1])) and 0.3 < share < 0.6


def test_a_support_of_which_little_is_visible(seen: tuple[Frame, SupportSurface, Segmentation]) -> None:
    frame, support, segmentation = seen
    rows, columns = np.nonzero(support.inliers)
    near = np.hypot(rows - np.median(rows), columns - np.median(columns)) < 16
    inliers = np.zeros_like(support.inliers)
    inliers[rows[near], columns[near]] = True
    found = image_doubts(frame, replace(support, inliers=inliers), segmentation)
    assert [f.code for f in found if "visible" in f.message] == [SUPPORT_DOUBT]


def test_another_support(seen: tuple[Frame, SupportSurface, Segmentation]) -> None:
    frame, support, segmentation = seen
    rivals = SupportRival(0.8, -0.4, 0.6, (12, 200)), SupportRival(0.7, 0.05, 0.02, (150, 90))
    (doubt,) = image_doubts(frame, replace(support, rivals=rivals), segmentation)
    assert doubt.code == SUPPORT_DOUBT and "40 cm below" in doubt.message and "[12, 200]" in doubt.hint


def test_a_second_surface_that_carries_objects(seen: tuple[Frame, SupportSurface, Segmentation]) -> None:
    """A floor, planes through parts of the support, and a shelf with next to nothing on it are no such surface."""
    frame, support, segmentation = seen
    side = SupportRival(0.2, -0.25, 0.3, (12, 200), carried=0.004)
    none = replace(side, height=-0.7), replace(side, height=0.02), replace(side, carried=0.001)
    (doubt,) = image_doubts(frame, replace(support, rivals=(*none, side)), segmentation)
    assert doubt.code == SUPPORT_DOUBT and "25 cm below the support carries objects" in doubt.message
    assert "[12, 200]" in doubt.hint


@pytest.mark.parametrize(("axis", "border"), [(1, "left and right borders meet at column 110"),
                                              (0, "upper and lower borders meet at row 110")])  # fmt: skip
def test_a_rolled_image(seen: tuple[Frame, SupportSurface, Segmentation], axis: int, border: str) -> None:
    frame, support, segmentation = seen
    shade = np.linspace(0, 90, frame.color.shape[axis]).astype(np.uint8)  # the borders of the image differ
    color = frame.color + (shade[:, None, None] if axis == 0 else shade[None, :, None])
    image = replace(frame, color=color)
    assert PARTS not in codes(image_doubts(image, support, segmentation))
    rolled = Frame(np.roll(color, 110, axis), np.roll(frame.depth, 110, axis), frame.K)
    moved = replace(segmentation, labels=np.roll(segmentation.labels, 110, axis))
    found = image_doubts(rolled, replace(support, inliers=np.roll(support.inliers, 110, axis)), moved)
    assert next(f.message for f in found if f.code == PARTS).endswith(border)


def test_objects_in_a_rolled_image_lean(seen: tuple[Frame, SupportSurface, Segmentation]) -> None:
    frame, support, segmentation = seen
    normals = object_normals(frame, segmentation.labels)
    assert roll_gain(normals, support.X_WC.rotation[2], 160) < -20
    rolled = replace(frame, depth=np.roll(frame.depth, 160, axis=1))
    normals = object_normals(rolled, np.roll(segmentation.labels, 160, axis=1))
    gains = {place: roll_gain(normals, support.X_WC.rotation[2], place) for place in range(40, 320, 40)}
    assert max(gains, key=lambda place: gains[place]) == 160 and gains[160] > 20


def test_an_image_of_two_parts(seen: tuple[Frame, SupportSurface, Segmentation]) -> None:
    frame, support, segmentation = seen
    depth = frame.depth.copy()
    depth[:, 200:] *= 1.1
    found = image_doubts(replace(frame, depth=depth), support, segmentation)
    assert next(f.message for f in found if f.code == PARTS).endswith("two parts that meet at column 200")


def test_a_warped_support(seen: tuple[Frame, SupportSurface, Segmentation]) -> None:
    frame, support, _ = seen
    assert support_curve(frame, support) < 5e-4
    bent = replace(frame, depth=frame.depth * (1 + 0.1 * (np.arange(frame.depth.shape[1]) / 160 - 1) ** 2))
    (doubt,) = depth_faults(bent, support)
    assert doubt.code == NOISY and "warped" in doubt.message


def test_something_at_the_border_that_hides_the_support(seen: tuple[Frame, SupportSurface, Segmentation]) -> None:
    """What reaches over the border of the image in front of the table is no object, and may hide some."""
    frame, support, segmentation = seen
    rows, columns = np.nonzero(support.inliers & (np.indices(frame.depth.shape)[0] > 200))
    left = int(np.median(columns)) - 20
    depth = frame.depth.copy()
    depth[190:, left : left + 40] = float(np.nanmin(frame.depth[rows, columns])) - 0.12
    found = image_doubts(replace(frame, depth=depth), support, segmentation)
    (border,) = (f for f in found if f.code == BORDER)
    assert "hides a part of the support" in border.message
    assert left - 3 < np.mean(border.outline, axis=0)[0] < left + 43


def test_an_object_that_may_be_two(seen: tuple[Frame, SupportSurface, Segmentation]) -> None:
    frame, support, segmentation = seen
    (doubt,) = image_doubts(frame, support, replace(segmentation, doubted=(2,)))
    assert doubt.code == MERGED and "the number 2" in doubt.message
    rows, columns = np.nonzero(segmentation.labels == 2)
    assert np.abs(np.mean(doubt.outline, axis=0) - (columns.mean(), rows.mean())).max() < 8


def test_an_object_of_parts_that_may_be_several(seen: tuple[Frame, SupportSurface, Segmentation]) -> None:
    frame, support, segmentation = seen
    (doubt,) = image_doubts(frame, support, replace(segmentation, joined=(1,)))
    assert doubt.code == JOINED and "the number 1" in doubt.message


@pytest.mark.parametrize("axis", [0, 1])
def test_the_edge_of_a_box_on_an_even_table_is_no_seam(
    seen: tuple[Frame, SupportSurface, Segmentation], axis: int
) -> None:
    """Both borders of the image look alike, and a long edge is as straight as a row or column."""
    frame, support, _ = seen
    labels = np.zeros(frame.depth.shape, np.int32)
    labels[60:180, 80:240] = 1
    color = np.where(labels[..., None], np.uint8(30), np.uint8(90)) * np.ones(3, np.uint8)
    even = Frame(color, np.full(labels.shape, 0.8), frame.K)
    edge, outside = seams(even, labels, axis)
    assert edge.share == 0.5 and edge.wrapped == 0 and outside.share == 0
    assert not list(seam_doubts(even, support, labels, object_normals(even, labels)))
