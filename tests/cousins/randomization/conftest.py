"""A room in which every kind of value varies, and cousins of it."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from simfoundry.cousins.recipe.candidate import Candidate
from simfoundry.cousins.run.candidates import CandidateSampler
from tests.conftest import REPOSITORY

ROOM = """\
simfoundry: scene/1
name: room
viewpoint: eye
parameters: {gap: 0.2}
materials:
  wood: {density: 600, friction: 0.5, color: [0.6, 0.4, 0.2]}
  steel: {density: 7800, friction: 0.3}
include:
  side: {scene: side.scene.yaml, pose: {xyz: [0, -1.5, 0]}}
objects:
  table: {fixed: true, shape: {box: [1.0, 0.8, 0.04]}, material: wood, pose: {xyz: [0, 0, -0.02]}}
  can:
    shape: {cylinder: {radius: 0.03, height: 0.1}}
    material: wood
    mass: {value: 0.3, range: [0.2, 0.5]}
    place: {on: table, xy: [$gap, 0.2]}
  brick: {shape: {box: [0.08, 0.04, 0.03]}, material: wood, pose: {xyz: [-0.3, 0.2, 0.015], yaw_deg: 30}}
  peg:
    repeat: {count: 2, step: 0.1}
    shape: {box: [0.03, 0.03, 0.06]}
    material: wood
    place: {on: table, xy: [-0.3, -0.2]}
  tee:
    shape:
      compound:
        bar: {shape: {box: [0.1, 0.02, 0.02]}, pose: {xyz: [0, 0, 0.05]}, color: [1, 0, 0]}
        foot: {shape: {box: [0.04, 0.04, 0.04]}, pose: {xyz: [0, 0, 0.02]}}
    mass: 0.2
    friction: 0.6
    place: {on: table, xy: [0.3, -0.2]}
  cube:
    shape: {box: [0.05, 0.05, 0.05]}
    mass: 0.1
    variants: {heavy: {mass: 0.8, material: steel}}
    variant: heavy
    place: {on: table, xy: [0, 0.3]}
  cabinet: {asset: assets/cabinet.asset.yaml, fixed: true, pose: {xyz: [0.2, -0.05, 0], yaw_deg: 180}}
cameras:
  eye: {size: [320, 240], fx: 200, fy: 200, pose: {xyz: [-0.9, 0, 0.7], look_at: [0, 0, 0]}}
  far_left: {size: [320, 240], fov_deg: 60, pose: {xyz: [0, 1, 0.7], look_at: can}}
  far_right: {size: [320, 240], fov_deg: 50, pose: {xyz: [0, -1, 0.7], look_at: [0, 0, 0]}}
lights:
  key: {type: distant, intensity: 0.9, direction: [0.5, 0.3, -1]}
  lamp: {type: point, intensity: 0.4, xyz: [0, 0, 1.5], color: [1, 0.9, 0.8]}
relations: [OnTop(can, table), Closed(cabinet.drawer)]
"""

SIDE = """\
simfoundry: scene/1
name: side
objects:
  stool: {fixed: true, shape: {box: [0.3, 0.3, 0.4]}, density: 500, pose: {xyz: [0, 0, 0.2]}}
"""

TASK = """\
simfoundry: task/1
name: can_away
scene: room.scene.yaml
instruction: Put the can next to the brick.
goal: NextTo(can, brick)
"""


@pytest.fixture
def room(tmp_path: Path) -> Path:
    """A project with the scene, a task in it, and textures."""
    (tmp_path / "simfoundry.yaml").write_text("")
    (tmp_path / "room.scene.yaml").write_text(ROOM)
    (tmp_path / "side.scene.yaml").write_text(SIDE)
    (tmp_path / "away.task.yaml").write_text(TASK)
    (tmp_path / "assets").mkdir()
    shutil.copy(REPOSITORY / "specs" / "assets" / "cabinet.asset.yaml", tmp_path / "assets")
    return tmp_path


Sampler = Callable[..., CandidateSampler]


@pytest.fixture
def sampler(room: Path) -> Sampler:
    """A function that returns the sampler of a recipe with the entries ``vary``."""

    def made(
        vary: str, more: str = "", twin: str = "room.scene.yaml", seed: int = 0, split: str = ""
    ) -> CandidateSampler:
        path = room / "rooms.cousins.yaml"
        text = f"simfoundry: cousins/1\nname: rooms\ntwin: {twin}\nvary:\n"
        path.write_text(text + "".join(f"  {line.strip()}\n" for line in vary.strip().splitlines()) + more)
        return CandidateSampler.load(path, room / "out", seed, "", split)

    return made


def write(room: Path, one: Candidate) -> dict[str, Path]:
    """Write a cousin's documents and return their paths by kind."""
    (room / "out").mkdir(exist_ok=True)
    paths = {kind: room / "out" / name for kind, name in one.files().items()}
    for kind, path in paths.items():
        path.write_text(one.documents[kind])
    return paths
