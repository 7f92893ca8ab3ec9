"""Handles of standing mugs: seen beside the body, and part of the solid and of the spec."""

from __future__ import annotations

import numpy as np
import pytest

from simfoundry.capture.description.describe import shape_spec
from simfoundry.capture.shapes.fit import fit_shape
from simfoundry.capture.shapes.fit_handle import FittedHandle, _outer_radius
from simfoundry.capture.stages.codec import decode, encode
from simfoundry.geometry.frames import Pose
from simfoundry.geometry.shapes import Box, closed_mesh, revolved, tessellate
from simfoundry.spec.models.shapes import CompoundShape, LatheShape
from tests.capture.depth_camera import Solid, see

R, H = 0.042, 0.1
PROFILE = [(0.0, 0.004), (R - 0.004, 0.004), (R - 0.004, H), (R, H), (R, 0.0), (0.0, 0.0)]
BARS = (((0.03, 0.009, 0.009), (R + 0.01, 0, 0.075)), ((0.03, 0.009, 0.009), (R + 0.01, 0, 0.025)),
        ((0.009, 0.009, 0.059), (R + 0.022, 0, 0.05)))  # fmt: skip


def mug(yaw_deg: float, bars: tuple[tuple[tuple[float, ...], tuple[float, ...]], ...] = BARS) -> Solid:
    """A mug whose handle points in a direction of the world."""
    body = revolved(PROFILE)
    vertices, faces, count = [np.asarray(body.vertices)], [body.faces], len(body.vertices)
    for size, at in bars:
        bar = tessellate(Box(np.array(size)))
        vertices.append(np.asarray(bar.vertices) + at)
        faces.append(bar.faces + count)
        count += len(bar.vertices)
    half = np.deg2rad(yaw_deg) / 2
    pose = Pose.of((0.03, 0.0, 0.0), (np.cos(half), 0, 0, np.sin(half)))
    return closed_mesh(np.concatenate(vertices), np.concatenate(faces)), pose


def test_the_outer_radius_is_that_of_the_wall() -> None:
    z = np.array([-0.01, 0.0, 0.05, 0.1, 0.2])
    assert np.allclose(_outer_radius(np.array(PROFILE), z), R)
    cone = np.array([(0.0, 0.1), (0.02, 0.1), (0.04, 0.0), (0.0, 0.0)])
    assert np.allclose(_outer_radius(cone, np.array([0.0, 0.05, 0.1])), [0.04, 0.03, 0.02])


def test_a_handle_stands_in_the_plane_through_the_axis() -> None:
    handle = FittedHandle(np.array([[0.04, 0.0], [0.06, 0.0], [0.06, 0.05]]), np.pi / 2, 0.01)
    assert np.allclose(handle.X_OH.apply(np.array([[0.06, 0.05, 0.0]])), [[0.0, 0.06, 0.05]])
    assert np.isclose(np.linalg.det(handle.X_OH.rotation), 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("yaw", [110.0, -60.0])
def test_a_mug_has_the_handle_that_was_seen(yaw: float) -> None:
    frame, support, labels = see([mug(yaw)])
    shape = fit_shape(frame, support, labels == 1, 0.0, labels=labels)
    assert shape.handle is not None and shape.hollow
    turn = float(
        np.arctan2(*(shape.X_WO.rotation @ [np.cos(shape.handle.angle), np.sin(shape.handle.angle), 0])[1::-1])
    )
    assert np.cos(turn - np.deg2rad(yaw)) > np.cos(np.deg2rad(12))
    reach = shape.handle.outline[:, 0].max()
    assert reach == pytest.approx(R + 0.0265, abs=0.006)
    extent = np.linalg.norm(np.asarray(shape.geometry.vertices)[:, :2], axis=1).max()  # type: ignore[union-attr]
    assert extent > R + 0.015
    spec = shape_spec(shape)
    assert isinstance(spec, CompoundShape) and isinstance(spec.compound["body"].shape, LatheShape)
    again = decode(encode(shape))
    assert np.allclose(again.handle.outline, shape.handle.outline) and again.handle.angle == shape.handle.angle


@pytest.mark.slow
def test_a_cup_without_a_handle_has_none() -> None:
    frame, support, labels = see([mug(0.0, ())])
    shape = fit_shape(frame, support, labels == 1, 0.0, labels=labels)
    assert shape.handle is None and isinstance(shape_spec(shape), LatheShape)
