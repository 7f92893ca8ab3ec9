"""A camera that moves around a table is tracked by its depth alone; one that could slide unnoticed is lost."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from simfoundry.capture.recordings.odometry import DepthOdometry
from simfoundry.capture.synthesize import simulate_frame
from simfoundry.geometry.frames import Pose, look_at
from simfoundry.render.raycast import raycast
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene
from tests.capture import captures
from tests.capture.conftest import SCENE
from tests.corpora.segmentation import DATA, available


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    path = tmp_path_factory.mktemp("odometry") / "two.scene.yaml"
    path.write_text(SCENE)
    return lower_file(path)


def test_a_moving_camera_is_tracked(scene: Scene) -> None:
    """A camera that goes round the table in steps of 4 cm, with the noise of a sensor."""
    odometry, first = DepthOdometry(), Pose.of()
    for k in range(5):
        angle = math.radians(180 + 3.5 * k)
        eye = np.array([0.7 * math.cos(angle), 0.7 * math.sin(angle), 0.6 - 0.005 * k])
        camera = replace(scene.cameras[0], X_WC=look_at(eye, np.array([0.02, 0.0, 0.02])))
        frame = simulate_frame(raycast(scene, camera), np.random.default_rng(k))
        first = camera.X_WC if k == 0 else first
        found = odometry.track(frame.depth, frame.K)
        assert found is not None
        error = (first.inverse() @ camera.X_WC).inverse() @ found
        assert np.linalg.norm(error.p) < 0.008 and math.degrees(error.angle_to(Pose.of())) < 0.7, k


def test_what_gives_no_hold_is_lost() -> None:
    K = np.array([[150.0, 0, 79.5], [0, 150, 59.5], [0, 0, 1]])
    for second in (captures.plane(), np.full((120, 160), np.nan), np.full((120, 160), 3.0)):
        odometry = DepthOdometry()
        assert odometry.track(captures.plane(), K) is not None
        assert odometry.track(second, K) is None


@pytest.mark.skipif(not available("redkitchen"), reason="needs ../shared/data/redkitchen")
def test_a_real_camera_is_tracked_over_steps_of_8_cm() -> None:
    """Frames of a third of a second, as after a recording was thinned out; the poses are those of KinectFusion."""
    from PIL import Image

    folder = DATA / "redkitchen"
    K = np.array([[585.0, 0, 320], [0, 585, 240], [0, 0, 1]])
    odometry, first = DepthOdometry(), Pose.of()
    for k in range(6):
        stem = folder / f"frame-{500 + 10 * k:06d}"
        raw = np.array(Image.open(f"{stem}.depth.png")).astype(np.float64)
        X_WC = Pose.from_matrix(np.loadtxt(f"{stem}.pose.txt"))
        first = X_WC if k == 0 else first
        found = odometry.track(np.where((raw > 0) & (raw < 65535), raw / 1000, np.nan), K)
        assert found is not None
        error = (first.inverse() @ X_WC).inverse() @ found
        assert np.linalg.norm(error.p) < 0.02 and math.degrees(error.angle_to(Pose.of())) < 1.0, k
