"""Named frames, and poses and places that refer to them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from simfoundry.scene.lower import lower, lower_file
from simfoundry.scene.model import Scene
from simfoundry.spec.diagnostics import SpecError
from tests.spec.compose.documents import loaded, messages, written

BALL = "shape: {sphere: 0.03}, mass: 0.2"
FRAMES = "frames: {corner: {xyz: [1, 0, 0], yaw_deg: 90}, tip: {frame: corner, xyz: [0.1, 0, 0]}}\n"
DESK = "  desk: {fixed: true, shape: {box: [1, 1, 0.04]}, pose: {frame: tip, xyz: [0.5, 0, -0.02]}}\n"


def scene(folder: Path, body: str) -> Scene:
    return lower(loaded(folder, body))


def test_poses_and_places_are_relative_to_frames(tmp_path: Path) -> None:
    objects = f"""\
objects:
{DESK}  ball: {{{BALL}, pose: {{frame: desk, xyz: [0.1, 0.2, 0.05], yaw_deg: 30}}}}
  a: {{{BALL}, place: {{on: desk, xy: [0.5, 0.1], frame: tip}}}}
  b: {{{BALL}, place: {{on: desk, offset: [0.2, 0], frame: tip}}}}
  c: {{{BALL}, place: {{on: desk, offset: [0.2, 0]}}}}
  d: {{{BALL}, place: {{on: desk, left_of: a, seen_from: corner}}}}
cameras: {{cam: {{size: [64, 48], fx: 60, fy: 60, pose: {{frame: corner, xyz: [0, 0, 1], look_at: [0.6, 0, 0]}}}}}}
lights: {{lamp: {{type: distant, direction: [1, 0, 0], frame: corner}}}}
"""
    found = scene(tmp_path, FRAMES + objects)
    at = {name: item.X_WO.p[:2].tolist() for name, item in found.by_name.items()}
    assert at["desk"] == pytest.approx([1, 0.6]) and at["ball"] == pytest.approx([0.8, 0.7])
    assert (
        at["a"] == pytest.approx([0.9, 0.6])
        and at["b"] == pytest.approx([1, 0.8])
        and at["c"] == pytest.approx([1.2, 0.6])
    )
    assert at["d"] == pytest.approx([0.9 - 0.09, 0.6], abs=1e-6)  # left of a, for a viewer who looks along +y
    (camera,), (light,) = found.cameras, found.lights
    assert camera.X_WC.p == pytest.approx([1, 0, 1]) and camera.X_WC.rotation[:2, 2] == pytest.approx(
        [0, 0.6 / np.hypot(1, 0.6)]
    )
    assert -light.X_WL.rotation[:, 2] == pytest.approx([0, 1, 0], abs=1e-9)


def test_a_frame_on_a_part_moves_with_it(tmp_path: Path) -> None:
    (tmp_path / "shelf.asset.yaml").write_text("""\
simfoundry: asset/1
name: shelf
links:
  base:
    density: 500
    parts:
      low: {shape: {box: [0.6, 0.2, 0.02]}, pose: {xyz: [0, 0, 0.1]}}
      high: {shape: {box: [0.6, 0.2, 0.02]}, pose: {xyz: [0, 0, 0.5]}}
""")
    body = f"""\
frames: {{top: {{on: shelf.high, xyz: [0.1, 0, 0]}}}}
objects:
  shelf: {{fixed: true, asset: shelf.asset.yaml, pose: {{xyz: [1, 0, 0], yaw_deg: 90}}}}
  a: {{{BALL}, place: {{on: shelf.low}}}}
  b: {{{BALL}, pose: {{frame: top, xyz: [0, 0, 0.03]}}}}
"""
    at = {name: item.X_WO.p for name, item in scene(tmp_path, body).by_name.items()}
    assert at["a"] == pytest.approx([1, 0, 0.1401], abs=1e-6) and at["b"] == pytest.approx([1, 0.1, 0.54], abs=1e-6)
    assert (
        "no link or part of `shelf` is called `middle`"
        in messages(tmp_path, body.replace("shelf.low", "shelf.middle"))[0]
    )


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("frames: {a: {frame: b}, b: {frame: a}}\n", "SF208 the frame `a` depends on itself: `a` → `b` → `a`"),
        (
            f"frames: {{f: {{on: a}}}}\nobjects: {{a: {{{BALL}, pose: {{frame: f}}}}}}\n",
            "SF208 the place of `a` depends",
        ),
        (f"objects: {{a: {{{BALL}, pose: {{frame: b}}}}}}\n", "SF201 no frame or object is called `b`"),
        (f"frames: {{a: {{}}}}\nobjects: {{a: {{{BALL}}}}}\n", "SF213 a frame and an object are both called `a`"),
        (
            f"objects: {{a: {{{BALL}}}}}\nrobots: {{r: {{model: franka_panda, pose: {{frame: a}}}}}}\n",
            "SF107 the base of a robot is fixed, but this frame moves with `a`",
        ),
        (
            f"objects: {{a: {{{BALL}}}}}\ncameras: {{c: {{size: [9, 9], fx: 60, fy: 60, mount: a, "
            "pose: {frame: a, look_at: [1, 0, 0]}}}\n",
            "SF107 the pose of a mounted camera is relative to its mount",
        ),
        (
            "frames: {" + ", ".join(f"f{k}: {{frame: f{k + 1}}}" for k in range(99)) + ", f99: {}}\n",
            "SF005 the chain of `frame` has more than 32 frames",
        ),
    ],
)
def test_wrong_frames_are_said(tmp_path: Path, body: str, said: str) -> None:
    assert any(said in message for message in messages(tmp_path, body)), messages(tmp_path, body)


def test_a_place_needs_a_level_frame(tmp_path: Path) -> None:
    body = f"frames: {{f: {{rpy_deg: [10, 0, 0]}}}}\nobjects:\n{DESK.replace('frame: tip, ', '')}"
    path = written(tmp_path, body + f"  a: {{{BALL}, place: {{on: desk, frame: f}}}}\n")
    with pytest.raises(SpecError, match="the z axis of the frame `f` is not vertical"):
        lower_file(path)
