"""Splats without a model: what the offline renderer answers satisfies the contract that servers must satisfy."""

from __future__ import annotations

import numpy as np
import pytest

from simfoundry.geometry.frames import look_at
from simfoundry.models.contract import ModelError
from simfoundry.models.offline_splats import OfflineSplats
from simfoundry.models.open import open_model
from simfoundry.models.setup import ModelSetup
from simfoundry.models.tasks.splats import _check_view
from simfoundry.models.wire import Bundle
from simfoundry.splats.files import splat_bytes
from tests.splats.random_splats import random_splat

K = np.array([[60.0, 0, 23.5], [0, 64.0, 17.5], [0, 0, 1]])


def test_the_offline_renderer_keeps_the_contract(tmp_path: object) -> None:
    from pathlib import Path

    splat = random_splat(300, 1, 3, spread=0.4)
    pose = look_at(np.array([1.6, -1.0, 0.9]), np.zeros(3)).inverse().matrix
    renderer = open_model(ModelSetup(Path(str(tmp_path))), "splat_image")
    view = renderer.render_splat(splat_bytes(splat, "a.ply"), K, pose, (48, 36))
    assert view.image.shape == (36, 48, 3) and view.image.dtype == np.uint8 and view.made_by.commercial
    assert view.depth.dtype == view.alpha.dtype == np.float32 and 0.5 < view.alpha.max() <= 1.0
    answer = {"depth": view.depth, "alpha": view.alpha}
    _check_view(Bundle({}, {"world_to_camera": pose}), Bundle({}, answer))
    at = np.unravel_index(view.alpha.argmax(), view.alpha.shape)
    assert 0.5 < view.depth[at] < 3.5


def test_cameras_that_are_no_pinholes_are_refused() -> None:
    data = splat_bytes(random_splat(3, 0, 0), "a.ply")
    for wrong in (np.zeros((3, 3)), K + [[0, 1, 0], [0, 0, 0], [0, 0, 0]], K * np.nan):
        with pytest.raises(ModelError, match="two focal lengths and no skew"):
            OfflineSplats().render_splat(data, wrong, np.eye(4), (8, 8))
    with pytest.raises(ModelError, match="unusable splat"):
        OfflineSplats().render_splat(b"no ply", K, np.eye(4), (8, 8))
