"""A small capture with its output, to change in one way at a time."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from simfoundry.capture.synthesize import synthesize
from simfoundry.scene.lower import lower_file
from tests.capture.runs import again

SCENE = """\
simfoundry: scene/1
name: two
objects:
  desk: {fixed: true, shape: {box: [0.9, 0.7, 0.03]}, color: [0.7, 0.55, 0.4], pose: {xyz: [0, 0, -0.015]}}
  tea: {shape: {box: [0.12, 0.09, 0.1]}, mass: 0.2, color: [0.2, 0.5, 0.25], pose: {xyz: [0.05, 0.15, 0.05]}}
  jam: {shape: {box: [0.08, 0.1, 0.08]}, mass: 0.2, color: [0.7, 0.1, 0.1], pose: {xyz: [0.05, -0.15, 0.04]}}
cameras:
  view: {size: [240, 180], fx: 229, fy: 229, pose: {xyz: [-0.6, 0.1, 0.6], look_at: [0.02, 0, 0.02]}}
lights: {key: {type: distant, direction: [0.5, -0.35, -1]}, sky: {type: dome, intensity: 0.45}}
"""


@pytest.fixture(scope="session")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a capture, `capture`, and its output, `out`."""
    tmp = tmp_path_factory.mktemp("stages")
    (tmp / "two.scene.yaml").write_text(SCENE)
    scene = lower_file(tmp / "two.scene.yaml")
    synthesize(scene, scene.cameras[0], tmp / "capture", seed=0, masks=True)
    again(tmp)
    return tmp


@pytest.fixture
def folder(first: Path, tmp_path: Path) -> Path:
    """A copy of :func:`first` that a test may change."""
    shutil.copytree(first, tmp_path / "copy")
    for file in (tmp_path / "copy" / "out" / "stages").glob("source.json"):
        file.write_text(file.read_text().replace(str(first), str(tmp_path / "copy")))
    return tmp_path / "copy"
