"""Joints from two captures: type, axis, hinge and range against the truth, the asset, and what is refused."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

import simfoundry as sf
from simfoundry.capture.articulation.run import Articulated, articulate
from simfoundry.errors import SimfoundryError
from simfoundry.scene.model import JointType
from tests.capture.furniture import Captured, captured
from tests.cli.command import run

# Half of the usual width, which a test renders and judges in a fifth of the time.
WIDTH = 320


def errors(found: Articulated, truth: Captured) -> tuple[float, float]:
    """Return the angle between the axes [deg] and the distance between the hinges [m], in the frame of the camera."""
    motion, X_WC, X_VC = found.estimate.motion, truth.X_WC[0], found.X_WC
    axis = X_WC.rotation.T @ truth.axis
    pivot = X_WC.inverse().apply(truth.pivot[None])[0]
    estimated = X_VC.rotation.T @ motion.axis
    off = X_VC.inverse().apply(motion.pivot[None])[0] - pivot
    angle = math.degrees(math.acos(min(1.0, float(estimated @ axis))))
    return angle, 0.0 if motion.kind is JointType.PRISMATIC else float(np.linalg.norm(np.cross(off, axis)))


def test_a_drawer_becomes_an_asset(tmp_path: Path) -> None:
    truth = captured(tmp_path, "drawer", 5000, WIDTH)
    result = run("articulate", truth.shut, truth.opened, "-o", tmp_path / "chest.asset.yaml", "--json")
    assert result.code == 0, result.err
    said = json.loads(result.out)
    assert said["type"] == "prismatic" and said["range"][1] == pytest.approx(truth.furniture.opened, abs=0.005)
    np.testing.assert_allclose(said["axis"], [1, 0, 0], atol=0.05)
    scene = tmp_path / "chest.scene.yaml"
    scene.write_text(
        "simfoundry: scene/1\nname: chest\nobjects:\n"
        "  chest: {asset: chest.asset.yaml, fixed: true, joints: {joint: 0.05}, pose: {}}\n"
    )
    document = sf.load(scene)
    assert document.check() == []
    world = document.open()
    before = world.state().joints["chest.joint"]
    for _ in range(100):
        world.step()
    assert before == pytest.approx(0.05) and abs(world.state().joints["chest.joint"] - 0.05) < 0.01  # it does not jam
    (tmp_path / "chest.asset.yaml").write_text("mine\n")
    refused = run("articulate", truth.shut, truth.opened, "-o", tmp_path / "chest.asset.yaml")
    assert refused.code == 2 and (tmp_path / "chest.asset.yaml").read_text() == "mine\n"


@pytest.mark.slow  # 4 s: it looks for a joint twice
def test_a_door_is_found_from_a_camera_that_moved(tmp_path: Path) -> None:
    truth = captured(tmp_path, "door", 5001, WIDTH, moves=True)
    found = articulate(truth.shut, truth.opened, tmp_path / "door.asset.yaml")
    angle, off = errors(found, truth)
    assert found.estimate.motion.kind is JointType.REVOLUTE and found.estimate.is_snapped
    assert angle < 2 and off < 0.02
    assert found.estimate.motion.q == pytest.approx(truth.furniture.opened, abs=0.05)
    again = articulate(truth.shut, truth.opened, tmp_path / "again" / "door.asset.yaml")
    assert again.path.read_bytes() == found.path.read_bytes()


@pytest.mark.slow  # 3 s
def test_a_drawer_that_leaves_the_image_is_doubtful(tmp_path: Path) -> None:
    truth = captured(tmp_path, "drawer", 0, WIDTH)
    result = run("articulate", truth.shut, truth.opened, "-o", tmp_path / "chest.asset.yaml")
    assert result.code == 1 and "doubtful: the part reaches the border of the second image" in result.out
    assert (tmp_path / "chest.png").is_file()


def test_what_does_not_belong_together_is_refused(tmp_path: Path) -> None:
    truth = captured(tmp_path, "lid", 3, WIDTH, moves=True)
    out = tmp_path / "a.asset.yaml"
    with pytest.raises(SimfoundryError, match="no part of the object moved"):
        articulate(truth.shut, truth.shut, out)
    stated = truth.opened / "capture.yaml"
    stated.write_text("".join(line for line in stated.open() if not line.startswith("    pose:")))
    with pytest.raises(SimfoundryError, match="one capture states the `pose`"):
        articulate(truth.shut, truth.opened, out)
    first = truth.shut / "capture.yaml"
    first.write_text("".join(line for line in first.open() if not line.startswith("    pose:")))
    with pytest.raises(SimfoundryError, match="leave the camera where it is"):
        articulate(truth.shut, truth.opened, out)
    missing = run("articulate", tmp_path / "nowhere", truth.opened, "-o", out)
    assert missing.code == 2 and "does not exist" in missing.err
    assert not out.exists()
