"""Similarity transforms, and their fit to paired points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simfoundry.geometry.frames import Pose, quat_from_rpy
from simfoundry.geometry.similarity import Similarity, fit_similarity

S_AB = Similarity(Pose.of((0.3, -1.2, 0.7), quat_from_rpy(0.4, -0.9, 2.1)), 2.5)
S_BC = Similarity(Pose.of((-2.0, 0.1, 0.4), quat_from_rpy(-1.4, 0.2, 0.7)), 0.3)
CORNERS = np.array([[0.1, 0.0, 0.2], [1.0, 0.3, -0.1], [0.2, 0.8, 0.5]])


def assert_same(one: Similarity, other: Similarity) -> None:
    assert one.scale == pytest.approx(other.scale, rel=1e-12)
    np.testing.assert_allclose(one.X_AB.p, other.X_AB.p, atol=1e-12)
    np.testing.assert_allclose(one.X_AB.rotation, other.X_AB.rotation, atol=1e-12)


def test_composition_and_inverse_act_on_points_in_order() -> None:
    np.testing.assert_allclose((S_AB @ S_BC).apply(CORNERS), S_AB.apply(S_BC.apply(CORNERS)), atol=1e-12)
    np.testing.assert_allclose(S_AB.inverse().apply(S_AB.apply(CORNERS)), CORNERS, atol=1e-12)
    assert_same(S_AB @ S_AB.inverse(), Similarity(Pose.of()))


def test_three_pairs_determine_the_similarity_exactly() -> None:
    found = fit_similarity(CORNERS, S_AB.apply(CORNERS))
    assert_same(found, S_AB)
    assert found.residuals(CORNERS, S_AB.apply(CORNERS)).max() < 1e-12


@given(
    rpy=st.tuples(*[st.floats(-3.1, 3.1)] * 3),
    p=st.tuples(*[st.floats(-20.0, 20.0)] * 3),
    scale=st.floats(0.01, 100.0),
)
def test_any_rotation_translation_and_scale_is_recovered(
    rpy: tuple[float, float, float], p: tuple[float, float, float], scale: float
) -> None:
    true = Similarity(Pose.of(p, quat_from_rpy(*rpy)), scale)
    found = fit_similarity(CORNERS, true.apply(CORNERS))
    assert found.scale == pytest.approx(scale, rel=1e-9)
    np.testing.assert_allclose(found.X_AB.rotation, true.X_AB.rotation, atol=1e-9)
    np.testing.assert_allclose(found.X_AB.p, true.X_AB.p, atol=1e-9 * (1 + scale))


def test_noisy_pairs_are_fitted_better_than_by_any_neighbor() -> None:
    rng = np.random.default_rng(3)
    b = rng.normal(size=(8, 3))
    a = S_AB.apply(b) + rng.normal(scale=0.05, size=b.shape)
    found = fit_similarity(b, a)

    def cost(s: Similarity) -> float:
        return float((s.residuals(b, a) ** 2).sum())

    for step in np.vstack([np.eye(7), -np.eye(7)]) * 1e-3:
        moved = Similarity(
            Pose.of(found.X_AB.p + step[:3], (Pose.of(q=quat_from_rpy(*step[3:6])) @ found.X_AB).q),
            found.scale * (1 + step[6]),
        )
        assert cost(moved) > cost(found)


def test_mirrored_points_are_never_explained_by_a_mirror() -> None:
    found = fit_similarity(np.vstack([CORNERS, [[0, 0, 0.9]]]), np.vstack([CORNERS, [[0, 0, 0.9]]]) * (1, 1, -1))
    assert np.linalg.det(found.X_AB.rotation) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((3, 3)),
        np.array([[0.0, 0, 0], [1, 1, 0], [2, 2, 0.0005]]),
        np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 0]]),
        np.array([[0.0, 0, 0], [1, 0, 0]]),
        np.array([[0.0, 0, np.nan], [1, 0, 0], [0, 1, 0]]),
    ],
)
def test_points_that_determine_no_rotation_are_refused(points: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"point|pair"):
        fit_similarity(points, S_AB.apply(points))
    if len(points) == 3:
        with pytest.raises(ValueError, match=r"point|pair"):
            fit_similarity(CORNERS, points)
