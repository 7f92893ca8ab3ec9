"""Doubts about an image: each damage is reported where it is, and an undamaged image gives rise to none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from simfoundry.capture.doubts import image_doubts
from simfoundry.capture.findings import (
    BORDER,
    HOLE,
    IMPLAUSIBLE,
    NOISY,
    OFFSET,
    SUPPORT_DOUBT,
    UNEXPLAINED,
    CaptureFinding,
)
from simfoundry.capture.frame import Frame, Segmentation, SupportRival, SupportSurface
from simfoundry.capture.intrinsics import common_tilt
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


@pytest.mark.parametrize("factor", [0.2, 4.0])
def test_a_wrong_unit(seen: tuple[Frame, SupportSurface, Segmentation], factor: float) -> None:
    frame, _, segmentation = seen
    scaled = replace(frame, depth=frame.depth * factor)
    assert IMPLAUSIBLE in codes(image_doubts(scaled, find_support(scaled), segmentation))


def test_intrinsics_of_no_camera(seen: tuple[Frame, SupportSurface, Segmentation]) -> None:
    frame, support, segmentation = seen
    K = frame.K + np.array([[0, 0, 60], [0, 0, 0], [0, 0, 0]])
    (odd,) = image_doubts(replace(frame, K=K), support, segmentation)[-1:]
    assert odd.code == IMPLAUSIBLE and "principal point" in odd.message


@pytest.mark.parametrize("factor", [0.7, 1.4])
def test_a_wrong_focal_length_tilts_what_is_upright(
    seen: tuple[Frame, SupportSurface, Segmentation], factor: float
) -> None:
    frame, support, segmentation = seen
    assert common_tilt(frame, support, segmentation.labels) == 0
    wrong = replace(frame, K=np.diag([factor, factor, 1.0]) @ (frame.K - [[0, 0, 158], [0, 0, 121], [0, 0, 0]])
                    + [[0, 0, 158], [0, 0, 121], [0, 0, 0]])  # fmt: skip
    tilt = common_tilt(wrong, find_support(wrong), segmentation.labels)
    assert 8 < abs(tilt) < 26 and (tilt > 0) == (factor < 1)


def test_noise(seen: tuple[Frame, SupportSurface, Segmentation]) -> None:
    frame, support, segmentation = seen
    assert codes(image_doubts(frame, replace(support, residual=0.008), segmentation)) == [NOISY]


def test_another_support(seen: tuple[Frame, SupportSurface, Segmentation]) -> None:
    frame, support, segmentation = seen
    rivals = SupportRival(0.8, -0.4, 0.6, (12, 200)), SupportRival(0.7, 0.05, 0.02, (150, 90))
    (doubt,) = image_doubts(frame, replace(support, rivals=rivals), segmentation)
    assert doubt.code == SUPPORT_DOUBT and "40 cm below" in doubt.message and "[12, 200]" in doubt.hint
