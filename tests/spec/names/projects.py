"""A project of ten documents that contains every kind of reference between documents."""

from __future__ import annotations

from pathlib import Path

from simfoundry.spec.names.project import ProjectNames
from simfoundry.spec.project import document_files

CABINET = """\
simfoundry: asset/1
name: cabinet
category: cabinet
materials:
  oak: {density: 600}  # solid oak
  brass: {density: 8500}
links:
  trunk:
    material: oak
    parts:
      shell: {shape: {box: [0.4, 0.4, 0.4]}, pose: {xyz: [0, 0, 0.2]}}
  tray:
    parts:
      base: {shape: {box: [0.3, 0.3, 0.02]}, material: oak}
      knob: {shape: {sphere: 0.01}, pose: {xyz: [0.16, 0, 0]}, material: brass}
  lid:
    material: oak
    parts:
      sheet: {shape: {box: [0.4, 0.4, 0.01]}}
joints:
  slide: {type: prismatic, parent: trunk, child: tray, axis: [1, 0, 0], limits: [0, 0.2]}
  gimbal:
    parent: trunk
    child: lid
    pose: {xyz: [0, 0, 0.405]}
    axes:
      pan: {type: revolute, axis: [0, 0, 1], limits_deg: [-30, 30]}
      tilt: {type: revolute, axis: [0, 1, 0], limits_deg: [-30, 30], mimic: {joint: slide, multiplier: 0.1}}
no_contact: [[tray, trunk], [lid, trunk]]
sites:
  tip: {link: tray, pose: {xyz: [0.16, 0, 0]}}
actuators:
  pusher: {type: motor, joint: slide}
sensors:
  feeler: {type: touch, site: tip}
  encoder: {type: joint_position, joint: slide}
  mark: {type: position, link: tray}
"""

DESK = """\
simfoundry: scene/1
name: desk
viewpoint: portrait
parameters:
  clearance: 0.1
  rise: $clearance * 2  # see clearance
templates:
  vessel: {shape: {cylinder: {radius: 0.03, height: 0.08}}, material: clay, mass: 0.1}
  jug: {like: vessel, shape: {cylinder: {radius: 0.03, height: 0.12}}}
materials:
  clay: {density: 2000}
  wood: {density: 700}
frames:
  corner: {on: table, xyz: [0.1, 0.1, 0]}
  deep: {frame: corner, xyz: [0.05, 0, 0]}
objects:
  table: {fixed: true, shape: {box: [2, 2, 0.1]}, material: wood, pose: {xyz: [0, 0, -0.05]}}
  commode:
    asset: cabinet.asset.yaml
    fixed: true
    pose: {xyz: [0.6, 0.6, 0]}
    joints: {slide: 0.1, pan: 0.1}
  # a mug beside the commode
  mug:
    like: vessel
    place: {on: table, xy: [0.2, $clearance], frame: deep}
    variant: big
    variants:
      big: {mass: 0.3}
  bowl: {like: jug, place: {on: table, right_of: mug, seen_from: portrait, gap: $clearance * 2}}
  cup: {like: vessel, repeat: {count: 3, step: [0.15]}, place: {on: table, xy: [-0.6, -0.6]}}
  saucer: {shape: {box: [0.02, 0.02, 0.02]}, mass: 0.1, repeat: cup, place: {on: cup}}
  cup_2: {mass: 0.4}
  coin: {shape: {sphere: 0.01}, mass: 0.01, place: {inside: commode.tray}}
  shelf:
    fixed: true
    shape:
      compound:
        plank: {shape: {box: [0.3, 0.3, 0.02]}, material: wood}
        slab: {shape: {box: [0.3, 0.3, 0.02]}, pose: {xyz: [0, 0, 0.2]}}
    material: wood
    pose: {xyz: [-0.6, 0.6, 0.01]}
robots:
  arm: {model: franka_panda, pose: {xyz: [-0.8, 0, 0]}}
cameras:
  portrait: {size: [64, 48], fov_deg: 60, pose: {xyz: [-1, 0, 1], look_at: mug}}
  eye: {size: [64, 48], fov_deg: 60, mount: arm.hand, pose: {xyz: [0, 0, 0.1], quat_wxyz: [1, 0, 0, 0]}}
  bird: {size: [64, 48], fov_deg: 60, pose: {xyz: [0, 0, 2], look_at: commode.lid, frame: corner}}
lights:
  lamp: {type: point, xyz: [0, 0, 1], frame: corner}
no_contact:
  - [coin, mug]
  - [commode.tray, "mug"]
relations:
  - OnTop(mug, table)
  - "Closed( commode.slide )"  # the tray
  - >-
    NextTo(mug,
    bowl)
"""

EVENING = """\
# A darker desk, with the mug elsewhere.
simfoundry: scene/1
extends: desk.scene.yaml
name: evening
materials: {clay: {friction: 0.4}}
objects:
  mug: {place: {on: table, xy: [0.3, -0.1]}, variants: {big: {mass: 0.4}, small: {mass: 0.05}}}
  commode: {joints: {slide: 0}}
  cup_3: null
  spoon: &spoon
    shape: {box: [0.1, 0.01, 0.005]}
    material: &stuff wood
    place: {on: cup_1}
  fork: {shape: {box: [0.1, 0.01, 0.005]}, material: *stuff, place: {on: table, left_of: spoon}}
cameras:
  bird: {size: [32, 24]}
"""

HALL = """\
simfoundry: scene/1
name: hall
include:
  west: {scene: desk.scene.yaml, pose: {xyz: [0, 3, 0]}, parameters: {clearance: 0.12}}
  east: {scene: desk.scene.yaml, pose: {xyz: [0, -3, 0]}}
objects:
  west_mug: {mass: 0.2}
  ball: {shape: {sphere: 0.03}, mass: 0.1, place: {on: east_table, behind: west_mug, frame: east}}
  west_cup_1: {mass: 0.3}
relations: [OnTop(ball, east_table), Closed(west_commode.slide), {a: b}]
"""

LIFT = """\
simfoundry: task/1
name: lift
scene: desk.scene.yaml
instruction: Lift the mug.
robots: [arm]
goal:
  all:
    - Lifted(mug)
    - not: Grasped(mug, arm)
    - any: [Inside(coin, commode.tray), OnTop(cup_1, table)]
subtasks:
  seize: {goal: {any: [Grasped(mug)]}}
  pull:
    goal: Open(commode.slide)
    start: {joints: {commode: {slide: 0}}, place: {mug: {on: table, in_front_of: coin}}}
start:
  pose: {coin: {xyz: [0, 0, 0.02], frame: corner}}
  joints: {commode: {slide: 0.05, pan: 0}}
reset:
  objects: {mug: {x: [0.1, 0.2], y: [0, 0.1]}}
allow:
  SF404: {mug: the goal is tested elsewhere}
"""

VARY = """\
simfoundry: cousins/1
name: vary
twin: lift.task.yaml
parameters: {clearance: 0.2}
scene:
  anchor: table
  objects: {mug: [LeftOf], bowl: [RightOf]}
object:
  objects: {mug: {count: 2}}
task:
  objects: [mug, bowl]
vary:
  object.mug.mass: {times: [0.5, 2]}
  commode.slide: {uniform: [0, 0.05]}
  "light.lamp.intensity": {times: [0.5, 1.5]}  # brighter or darker
  camera.eye.fov_deg: {times: [0.9, 1.1]}
  camera.*.fov_deg: {times: [0.9, 1.1]}
  robot.arm.joints: {normal_deg: 2}
  object.shelf.material: {choose: [wood, clay]}
  object.commode.asset.links.tray.friction: {uniform: [0.4, 0.6]}
"""

POLICY = """\
simfoundry: policy/1
name: pi
protocol: openpi
address: localhost:8000
action_space: joint_position
horizon: 8
cameras:
  observation/front: {camera: portrait, size: [224, 224]}
"""

HALL_LATE = """\
simfoundry: scene/1
extends: hall.scene.yaml
name: hall_late
include:
  west: {parameters: {clearance: 0.15}}
objects:
  west_mug: {mass: 0.25}
native:
  mjcf:
    equality: [{joint: {name: hold, joint1: west_commode.slide}}]
    sensor:
      - framepos: {name: where, objtype: body, objname: west_commode.tray}
      - touch: {name: felt, site: west_commode.tip}
    contact: [{exclude: {body1: west_mug, body2: ball}}]
    order: {sensor: [west_commode.feeler]}
"""

FILES = {
    "simfoundry.yaml": "",
    "cabinet.asset.yaml": CABINET,
    "desk.scene.yaml": DESK,
    "evening.scene.yaml": EVENING,
    "hall.scene.yaml": HALL.replace(", {a: b}", ""),
    "hall_late.scene.yaml": HALL_LATE,
    "lift.task.yaml": LIFT,
    "lift_late.task.yaml": "simfoundry: task/1\nextends: lift.task.yaml\nname: late\nscene: evening.scene.yaml\n"
    "goal: OnTop(spoon, cup_1)\n",
    "sort.task.yaml": "simfoundry: task/1\nname: sort\nscene: hall.scene.yaml\ninstruction: Sort.\n"
    "goal: OnTop(west_mug, east_table)\n",
    "vary.cousins.yaml": VARY,
    "pi.policy.yaml": POLICY,
}


def write_project(folder: Path, files: dict[str, str] = FILES) -> Path:
    """Write the files of a project and return its folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_bytes(text.encode())
    return folder


def names_in(folder: Path) -> ProjectNames:
    """Return the names of all documents below a folder."""
    return ProjectNames(folder, document_files(folder).included)
