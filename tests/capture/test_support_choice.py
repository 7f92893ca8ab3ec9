"""A person's choice of the support takes precedence over all evidence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from simfoundry.capture.frame import CaptureError
from simfoundry.capture.segment.find_support import find_support
from simfoundry.spec.models.capture import SupportChoice
from tests.capture.pictures import Box, Setup, Table, photograph

TRAY = Box((0.05, 0.0, 0.05), (0.3, 0.4, 0.1))
CUP = Box((0.05, 0.08, 0.14), (0.06, 0.06, 0.08))
SETUP = Setup((TRAY, CUP), table=Table(size=(0.8, 0.9)))


def pixel_at(x: float, y: float, z: float) -> tuple[int, int]:
    frame, _ = photograph(SETUP)
    p = SETUP.X_TC.inverse().apply(np.array([x, y, z]))
    u, v = frame.K[:2] @ (p / p[2])
    return round(float(u)), round(float(v))


@pytest.mark.parametrize(("x", "y", "z"), [(0.0, -0.12, 0.1), (-0.2, 0.3, 0.0)])
def test_a_pixel_chooses(x: float, y: float, z: float) -> None:
    frame, _ = photograph(SETUP)
    u, v = pixel_at(x, y, z)
    support = find_support(replace(frame, support=SupportChoice(pixel=(u, v))))
    assert support.X_WC.p[2] == pytest.approx(SETUP.eye[2] - z, abs=0.003)


def test_a_plane_chooses() -> None:
    frame, _ = photograph(SETUP)
    normal = SETUP.X_TC.rotation.T @ np.array([0.0, 0.0, 1.0])
    offset = 0.1 - SETUP.eye[2]
    for sign in (1, -2):
        a, b, c, d = (sign * np.append(normal, offset)).tolist()
        support = find_support(replace(frame, support=SupportChoice(plane=(a, b, c, d))))
        assert support.X_WC.p[2] == pytest.approx(SETUP.eye[2] - 0.1, abs=0.003)


def test_a_choice_without_a_surface_is_refused() -> None:
    frame, _ = photograph(SETUP)
    hole = replace(frame, depth=np.where(np.arange(320) < 60, np.nan, frame.depth))
    with pytest.raises(CaptureError, match=r"no depth at the pixel \[10, 100\]"):
        find_support(replace(hole, support=SupportChoice(pixel=(10, 100))))
    with pytest.raises(CaptureError, match="no flat surface in the stated plane"):
        find_support(replace(frame, support=SupportChoice(plane=(0.0, 0.0, 1.0, 0.2))))


def test_a_choice_is_one_statement() -> None:
    for wrong in ({}, {"pixel": (1, 2), "plane": (0, 0, 1, 1)}, {"plane": (0, 0, 0, 1)}):
        with pytest.raises(ValidationError):
            SupportChoice.model_validate(wrong)
