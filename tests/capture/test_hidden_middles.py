"""Visible parts of an object whose middle another one hides are joined, and are said to be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from simfoundry.capture.frame import Frame, SupportSurface
from simfoundry.capture.segment.decompose import decompose
from simfoundry.capture.segment.find_support import find_support
from simfoundry.capture.segment.hidden_middles import join_parts
from simfoundry.capture.segment.masks import Labels, Mask, components
from simfoundry.geometry.frames import Array
from simfoundry.spec.models.capture import Decomposition
from tests.capture.pictures import Box, Setup, photograph
from tests.corpora.segmentation import segment
from tests.corpora.synthetic_tables import synthetic_table

OCCLUDER = Box((-0.06, 0.0, 0.09), (0.05, 0.06, 0.18))


@pytest.fixture(scope="module")
def behind() -> tuple[Frame, SupportSurface, Labels, Array]:
    """A wide box whose middle a post hides, with its two sides as two regions, 1 and 3."""
    frame, labels = photograph(Setup((Box((0.08, 0.0, 0.04), (0.06, 0.24, 0.08)), OCCLUDER)))
    right = (labels == 1) & (np.arange(labels.shape[1]) > np.nonzero(labels == 2)[1].mean())
    assert right.any() and ((labels == 1) & ~right).any()
    support = find_support(frame)
    return frame, support, np.where(right, 3, labels).astype(np.int32), support.X_WC.apply(frame.points)


def test_the_sides_of_a_box_behind_a_post_are_one(behind: tuple[Frame, SupportSurface, Labels, Array]) -> None:
    frame, _, divided, points_W = behind
    joined, ((row, column),) = join_parts(divided, frame, points_W)
    assert joined.max() == 2 and (joined[divided == 1] == joined[row, column]).all()
    assert (joined == joined[row, column]).sum() == ((divided == 1) | (divided == 3)).sum()


def test_what_differs_or_has_nothing_before_it_stays_apart(
    behind: tuple[Frame, SupportSurface, Labels, Array],
) -> None:
    frame, _, divided, points_W = behind
    right = divided == 3
    higher = points_W + np.where(right, 0.01, 0.0)[..., None] * [0, 0, 1]
    painted = replace(frame, color=np.where(right[..., None], np.uint8(250), np.uint8(90)) * np.ones(3, np.uint8))
    bare = np.where(divided == 2, 0, divided).astype(np.int32)
    for labels, seen, points in ((divided, frame, higher), (divided, painted, points_W), (bare, frame, points_W)):
        after, marks = join_parts(labels, seen, points)
        assert not marks and len(np.unique(after)) == len(np.unique(labels))


@pytest.mark.slow  # 4 s: a table of full size, twice
def test_what_was_joined_is_said_unless_a_person_divides_it() -> None:
    """A plate behind another object, on a table on which nothing was tuned."""
    table = synthetic_table(30221)
    support, found = segment(table.frame)
    (k,) = found.joined
    assert found.labels.max() == len(np.unique(table.truth[table.truth > 0]))
    _, parts = components(found.labels == k)
    assert np.sort(parts)[-2] > 1000, "it has two visible parts"
    pieces = {f"part_{n}": (pixel,) for n, pixel in enumerate(middles(found.labels == k))}
    frame = replace(table.frame, decomposition=Decomposition.model_validate({"pieces": pieces}))
    divided = decompose(frame, support)
    assert divided.labels.max() == found.labels.max() + 1 and not divided.joined


def middles(mask: Mask) -> list[tuple[int, int]]:
    """A pixel (column, row) inside of each of the two largest parts of a mask."""
    parts, sizes = components(mask)
    pixels = (np.argwhere(parts == k) for k in np.argsort(sizes)[-2:])
    return [(int(column), int(row)) for row, column in (each[len(each) // 2] for each in pixels)]
