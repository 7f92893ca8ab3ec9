"""A small project with a capture of two boxes, and the scene that was reconstructed from it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from simfoundry.capture.outputs.overlay import SEGMENTS, segment_image
from simfoundry.capture.segment.masks import Labels
from simfoundry.geometry.frames import Pose
from tests.capture.pictures import FOCAL, Box, Setup, photograph

SETUP = Setup((Box((0.08, 0.02, 0.06), (0.08, 0.16, 0.12), 0.5), Box((-0.08, -0.06, 0.04), (0.06, 0.09, 0.08), -0.3)))

CAPTURE = f"""\
# Filmed on Monday.
simfoundry: capture/1
name: desk
frames:
  view:
    color: color.png  # the left camera
    depth: {{image: depth.png, scale: 0.0001}}
    camera: {{fx: {FOCAL:g}, fy: {FOCAL + 1:g}, cx: 158, cy: 121}}
"""

SCENE = """\
# Estimated from one picture.
simfoundry: scene/1
name: desk
viewpoint: view

objects:
  table:
    fixed: true
    shape: {{box: [1.2, 0.9, 0.04]}}
    pose: {{xyz: [0, 0, -0.02]}}
  carton:  # the large one
    shape: {{box: [0.08, 0.16, 0.12]}}
    mass: 0.4
    pose: {{xyz: [0.08, 0.02, 0.06], yaw_deg: {first:.2f}}}
    origin: {{capture: desk, fit_error: 0.0013, confidence: 0.9, segment: 1}}
  tin:
    shape: {{box: [0.06, 0.09, 0.08]}}
    mass: 0.2
    pose: {{xyz: [-0.08, -0.06, 0.04], yaw_deg: {second:.2f}}}
    origin: {{capture: desk, fit_error: 0.0011, segment: 2}}

cameras:
  other: {{size: [320, 240], fov_deg: 50, pose: {{xyz: [1, 0, 1], look_at: [0, 0, 0]}}}}
  view:
    size: [320, 240]
    fx: {focal:g}
    fy: {focal_y:g}
    pose: {{xyz: {xyz}, quat_wxyz: {quat}}}

relations: [OnTop(carton, table), OnTop(tin, table)]
origin: {{capture: desk}}
"""


def write_project(folder: Path) -> tuple[Path, Path, Labels]:
    """Write a project; returns the scene, the capture, and the true number of the object at each pixel."""
    (folder / "simfoundry.yaml").touch()
    capture, scene = folder / "captures" / "desk" / "capture.yaml", folder / "build" / "desk" / "desk.scene.yaml"
    frame, truth = photograph(SETUP)
    capture.parent.mkdir(parents=True)
    scene.parent.mkdir(parents=True)
    capture.write_text(CAPTURE, encoding="utf-8")
    Image.fromarray(frame.color).save(capture.with_name("color.png"))
    depth = np.nan_to_num(np.rint(frame.depth * 10_000)).astype(np.uint16)
    Image.fromarray(depth).save(capture.with_name("depth.png"))
    scene.with_name(SEGMENTS).write_bytes(segment_image(truth))
    X_WC: Pose = SETUP.X_TC
    text = SCENE.format(
        first=np.degrees(0.5), second=np.degrees(-0.3), focal=FOCAL, focal_y=FOCAL + 1,
        xyz=[round(float(v), 4) for v in X_WC.p], quat=[round(float(v), 6) for v in X_WC.q],
    )  # fmt: skip
    scene.write_text(text, encoding="utf-8")
    return scene, capture, truth


def yawed(X_WO: Pose, by: tuple[float, float, float], yaw: float) -> Pose:
    """The pose after a turn about the vertical [rad], and a shift [m]."""
    turned = Pose.about(np.array([0.0, 0.0, 1.0]), yaw) @ Pose.of(q=X_WO.q)
    return Pose.of(X_WO.p + np.array(by), turned.q)
