"""A scene with a bit of everything, compiled to a stage for tests to edit."""

from __future__ import annotations

import os
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simfoundry.backends.usd import compile_usd
from simfoundry.frontends.usd.compiled.loading import Imported, import_usd
from simfoundry.frontends.usd.compiled.reading import StageReading, read_spec
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene

if TYPE_CHECKING:
    from pxr import Usd

OBJECTS = "/World/Objects"

DESK = """\
# Our desk, as it was on Monday.
simfoundry: scene/1
name: desk
viewpoint: front

materials:
  wood: {density: 700, friction: 0.5, color: [0.8, 0.68, 0.53]}
  ceramic: {density: 2400, friction: 0.35, restitution: 0.05}

objects:
  desk:  # it does not move
    fixed: true
    shape: {box: [1.2, 0.8, 0.04]}
    material: wood
    pose: {xyz: [0.45, 0, -0.02]}
  shelf:
    fixed: true
    shape: {box: [0.3, 0.2, 0.02]}
    material: wood
    pose: {xyz: [0.8, 0.25, 0.21], yaw_deg: 5}
  plate:
    shape: {cylinder: {radius: 0.1, height: 0.02}}
    material: ceramic
    # weighed by eye
    mass: {value: 0.45, range: [0.3, 0.6], source: vlm}
    place: {on: desk, xy: [0.45, 0.1]}
    origin: {capture: monday, fit_error: 0.002}
  cup:
    shape: {cylinder: {radius: 0.04, height: 0.1}}
    material: ceramic
    place: {on: desk, right_of: plate, gap: 0.05}  # within reach
  ball:
    shape: {sphere: 0.03}
    color: [0.9, 0.2, 0.2]
    mass: 0.1
    friction: 0.8
    pose: {xyz: [0.2, -0.2, 0.03], rpy_deg: [10, 20, 30]}
  cabinet:
    fixed: true
    asset: cabinet.asset.yaml
    pose: {xyz: [0.1, 0.25, 0], yaw_deg: 180}
    joints: {drawer: 0.05, door: {deg: 30}}

robots:
  arm: {model: franka_robotiq}

cameras:
  front: {size: [640, 480], fx: 500, fy: 500, pose: {xyz: [-0.6, 0.1, 0.5], look_at: [0.45, 0, 0]}}
  wrist:
    size: [640, 480]
    fx: 500
    fy: 510
    cx: 320
    pose: {xyz: [0.07, 0, 0.03], look_at: [0, 0, 0.2]}
    mount: arm.hand

lights:
  sun: {type: distant, intensity: 0.85, direction: [0.6, 0.3, -1]}
  lamp: {type: point, intensity: 0.4, color: [1, 0.9, 0.8], xyz: [0.3, 0.2, 1.5]}

relations:
  - OnTop(plate, desk)
  - RightOf(cup, plate)
  - Closed(cabinet.drawer)

allow:
  SF406: {cabinet: it is meant to stand open}
"""

CABINET = """\
simfoundry: asset/1
name: cabinet
materials:
  wood: {density: 600}
links:
  carcass:
    material: wood
    parts: {back: {shape: {box: [0.02, 0.3, 0.3]}, pose: {xyz: [-0.15, 0, 0.15]}}}
  tray:
    material: wood
    parts: {floor: {shape: {box: [0.2, 0.25, 0.01]}}}
  leaf:
    material: wood
    parts: {panel: {shape: {box: [0.02, 0.25, 0.1]}, pose: {xyz: [0, 0.125, 0]}}}
joints:
  drawer: {type: prismatic, parent: carcass, child: tray, pose: {xyz: [0, 0, 0.06]}, axis: [1, 0, 0], limits: [0, 0.2]}
  door:
    type: revolute
    parent: carcass
    child: leaf
    pose: {xyz: [0.1, -0.12, 0.2], rpy_deg: [5, 0, 0]}
    axis: [0, 0, 1]
    limits_deg: [0, 120]
    closed: upper
"""

OVERLAY = """\
# Tuesday: a bowl more.
simfoundry: scene/1
extends: desk.scene.yaml
name: tuesday

objects:
  bowl:
    shape: {cylinder: {radius: 0.07, height: 0.05}}
    material: ceramic
    place: {on: desk, xy: [0.3, -0.1]}  # for the soup
"""


@dataclass(frozen=True)
class Project:
    """A folder with the documents, one of them compiled to ``stage``."""

    document: Path
    stage: Path
    scene: Scene

    def edit(self) -> Usd.Stage:
        """A copy of the stage as a person opens it, to be saved by :meth:`save`; USD keeps open files in memory."""
        from pxr import Usd

        handle, copy = tempfile.mkstemp(suffix=".usda", dir=self.stage.parent)
        os.close(handle)
        return Usd.Stage.Open(str(shutil.copy(self.stage, copy)))

    def read(self, stage: Usd.Stage) -> StageReading:
        """The document of an edited stage."""
        reading = read_spec(stage)
        assert reading is not None
        return reading

    def save(self, stage: Usd.Stage) -> Path:
        """Save an edited stage."""
        stage.GetRootLayer().Save()
        return Path(stage.GetRootLayer().realPath)

    def onto(self, stage: Usd.Stage) -> Imported:
        """The original document with what was edited in a stage."""
        return import_usd(self.save(stage), self.document)


def project(folder: Path, name: str = "desk") -> Project:
    """Write the documents into ``folder`` and compile one of them."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "simfoundry.yaml").touch()
    for file, text in (("desk.scene", DESK), ("cabinet.asset", CABINET), ("tuesday.scene", OVERLAY)):
        (folder / f"{file}.yaml").write_text(text, encoding="utf-8")
    document = folder / f"{name}.scene.yaml"
    scene = lower_file(document)
    compile_usd(scene).write(folder / "build" / "usd")
    return Project(document, folder / "build" / "usd" / "scene.usda", scene)


def translate(stage: Usd.Stage, path: str, x: float, y: float, z: float) -> None:
    from pxr import Gf, UsdGeom

    UsdGeom.XformCommonAPI(stage.GetPrimAtPath(path))
    attribute = stage.GetPrimAtPath(path).GetAttribute("xformOp:translate")
    attribute.Set(Gf.Vec3d(x, y, z))


def put(stage: Usd.Stage, path: str, name: str, value: Any) -> None:
    attribute = stage.GetPrimAtPath(path).GetAttribute(name)
    assert attribute, f"{path} has no {name}"
    attribute.Set(value)


def lines(text: str, original: str) -> tuple[list[str], list[str]]:
    """The lines that went and those that came."""
    before, after = original.splitlines(), text.splitlines()
    return [ln for ln in before if ln not in after], [ln for ln in after if ln not in before]
