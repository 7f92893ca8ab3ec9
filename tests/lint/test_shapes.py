"""Profiles and outlines are refused by a check exactly where lowering refuses them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simfoundry.assets.errors import MeshError
from simfoundry.assets.lathe import checked_profile
from simfoundry.assets.prism import checked_outline
from simfoundry.lint.meshes import shape_fault
from simfoundry.spec.models.base import Lathe, LatheShape, Prism, PrismShape

steps = st.integers(-3, 3).map(lambda k: k / 100)
corners = st.lists(st.tuples(steps, steps), min_size=3, max_size=7)


def refused(points: list[tuple[float, float]]) -> str:
    try:
        checked_outline(np.array(points))
    except MeshError as error:
        return error.message
    return ""


@given(points=corners)
def test_an_outline(points: list[tuple[float, float]]) -> None:
    fault = shape_fault(PrismShape(prism=Prism(outline=tuple(points), height=0.1)))
    expected = refused(points)
    if fault is not None:
        assert fault.message == expected
    else:
        assert expected == "" or _is_spike(points)


def _is_spike(points: list[tuple[float, float]]) -> bool:
    """Whether a side runs back along the one before it: lowering alone finds that."""
    ring = [p for k, p in enumerate(points) if p != points[k - 1]]
    triples = zip(ring, (*ring[1:], ring[0]), (*ring[2:], *ring[:2]), strict=True)
    for a, b, c in triples:
        u, v = np.subtract(b, a), np.subtract(c, b)
        if abs(u[0] * v[1] - u[1] * v[0]) < 1e-12 and u @ v < 0:
            return True
    return False


PROFILES: list[tuple[tuple[tuple[float, float], ...], str]] = [
    (((0, 0), (0.05, 0), (0.05, 0.1), (0, 0.1)), ""),
    (((0.01, 0), (0.05, 0), (0.05, 0.1), (0, 0.1)), "a profile starts and ends on the axis"),
    (((0, 0), (0.05, 0), (0.05, 0.1)), "a profile starts and ends on the axis"),
    (((0, 0), (0.05, 0), (0, 0.05), (0.05, 0.1), (0, 0.1)), "a profile touches the axis only at its ends"),
    (((0, 0), (0.05, 0.1), (0.05, 0), (0, 0.1)), "the profile crosses itself or has no area"),
    (((0, 0), (0.05, 0.1), (0, 0)), "the profile crosses itself or has no area"),
]


@pytest.mark.parametrize(("profile", "message"), PROFILES)
def test_a_profile(profile: tuple[tuple[float, float], ...], message: str) -> None:
    fault = shape_fault(LatheShape(lathe=Lathe(profile=profile)))
    assert (fault.message if fault is not None else "") == message
    try:
        checked_profile(np.array(profile, dtype=np.float64))
        found = ""
    except MeshError as error:
        found = error.message
    assert found == message
