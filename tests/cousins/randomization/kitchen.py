"""A project with a task in a kitchen, whose scene has a value of every kind."""

from __future__ import annotations

import shutil
from pathlib import Path

import trimesh
from PIL import Image as PillowImage

from tests.conftest import REPOSITORY

SCENE = """\
simfoundry: scene/1
name: kitchen
materials:
  wood: {density: 600, friction: 0.5, color: [0.6, 0.4, 0.2], texture: wood_a.png}
  steel: {density: 7800, friction: 0.3, restitution: 0.1}
objects:
  desk: {fixed: true, shape: {box: [0.8, 1.2, 0.04]}, material: wood, pose: {xyz: [0.55, 0, -0.02]}}
  cup:
    shape: {cylinder: {radius: 0.03, height: 0.08}}
    material: steel
    mass: {value: 0.2, range: [0.15, 0.3], source: scale}
    place: {on: desk, xy: [0.45, 0.1]}
  bowl:
    shape: {cylinder: {radius: 0.06, height: 0.05}}
    material: steel
    mass: {value: 0.4, range: [0.3, 0.6], source: scale}
    place: {on: desk, xy: [0.45, -0.15]}
  cabinet: {asset: assets/cabinet.asset.yaml, fixed: true, pose: {xyz: [0.8, 0.35, 0], yaw_deg: 180}}
robots:
  arm: {model: demo_arm}
lights:
  key: {type: distant, intensity: 0.9, direction: [0.5, 0.3, -1]}
  fill: {type: dome, intensity: 0.4}
cameras:
  exterior_left: {size: [320, 240], fx: 200, fy: 200, pose: {xyz: [0.1, 0.9, 0.7], look_at: [0.45, 0, 0]}}
  exterior_right: {size: [320, 240], fx: 200, fy: 200, pose: {xyz: [0.1, -0.9, 0.7], look_at: [0.45, 0, 0]}}
  wrist: {size: [320, 240], fx: 200, fy: 200, pose: {xyz: [0.05, 0, 0.02], look_at: [0.05, 0, 0.3]}, mount: arm.hand}
background: {mesh: rooms/a.glb}
relations: [OnTop(cup, desk), OnTop(bowl, desk), Closed(cabinet.drawer)]
"""

TASK = """\
simfoundry: task/1
name: cup_to_bowl
scene: kitchen.scene.yaml
instruction: Put the cup in the bowl.
goal: NextTo(cup, bowl)
disturbances: {action: {latency: 0.02}}
"""


def write_kitchen(folder: Path) -> Path:
    """Write the files of the project, and return its folder."""
    (folder / "simfoundry.yaml").write_text("")
    (folder / "kitchen.scene.yaml").write_text(SCENE)
    (folder / "cup.task.yaml").write_text(TASK)
    for name in ("assets", "rooms", "recipes"):
        (folder / name).mkdir()
    shutil.copy(REPOSITORY / "specs" / "assets" / "cabinet.asset.yaml", folder / "assets")
    for name, size in (("a", 3.0), ("b", 4.0), ("c", 5.0)):
        trimesh.creation.box((size, size, 0.1)).export(folder / "rooms" / f"{name}.glb")
    for name, shade in (("a", 60), ("b", 200)):
        PillowImage.new("RGB", (4, 4), (shade, 100, 50)).save(folder / f"wood_{name}.png")
    return folder
