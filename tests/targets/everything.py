"""A scene that says everything that a spec can say, as documents in a folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.scenes import checker_png

SCENE = """\
simfoundry: scene/1
name: everything
materials:
  rubber: {torsional_friction: 0.002, rolling_friction: 0.001}
objects:
  desk:
    fixed: true
    shape: {box: [1.4, 0.7, 0.04]}
    friction: 0.8
    pose: {xyz: [0.45, 0, -0.02]}
  cup:
    shape: {cylinder: {radius: 0.03, height: 0.1}}
    labels: [mug, container]
    mass: 0.2
    friction: 0.3
    restitution: 0.4
    material: rubber
    place: {on: desk, xy: [0.3, 0.1], yaw_deg: 20}
    variants:
      tall: {shape: {cylinder: {radius: 0.03, height: 0.2}}, labels: [vase]}
      red: {color: [1, 0, 0], mass: 0.3}
  ball: {shape: {sphere: 0.03}, mass: 0.05, place: {on: desk, xy: [0.5, 0]}}
  pill: {shape: {capsule: {radius: 0.02, height: 0.06}}, mass: 0.08, place: {on: desk, xy: [0.6, 0.2]}}
  bowl:
    shape: {lathe: {profile: [[0, 0], [0.06, 0], [0.08, 0.05], [0.07, 0.05], [0.05, 0.01], [0, 0.01]]}}
    mass: 0.3
    place: {on: desk, xy: [0.7, -0.1]}
  tile: {asset: tile.obj, solid: hull, mass: 0.1, place: {on: desk, xy: [0.2, -0.2]}}
  cabinet: {asset: cabinet.asset.yaml, fixed: true, pose: {xyz: [1, 0.8, 0]},
            joints: {slide: 0.1, hinge: 0.3, pitch: 0.2, roll: 0.4}}
robots:
  arm: {model: franka_robotiq, pose: {xyz: [-0.6, 0, 0]}}
cameras:
  wrist: {size: [64, 48], fx: 60, fy: 60, pose: {xyz: [0, 0, 0.1], look_at: [0, 0, 1]}, mount: arm.hand}
  eye: {size: [64, 48], fx: 60, fy: 61, pose: {xyz: [1, 1, 1], look_at: [0.4, 0, 0]}}
relations: [OnTop(cup, desk)]
no_contact:
  - [cup, cabinet]
"""

CABINET = """\
simfoundry: asset/1
name: cabinet
links:
  frame: {mass: 5, parts: {floor: {shape: {box: [0.3, 0.3, 0.02]}}}}
  drawer: {mass: 1, parts: {tray: {shape: {box: [0.2, 0.2, 0.1]}, pose: {xyz: [0, 0, 0.1]}}}}
  door: {mass: 1, parts: {panel: {shape: {box: [0.02, 0.2, 0.2]}, pose: {xyz: [0, 0.1, 0.1]}}}}
  knob: {mass: 0.1, parts: {ball: {shape: {sphere: 0.01}}}}
  head: {mass: 0.2, gravity_compensation: 1, parts: {ball: {shape: {sphere: 0.02}}}}
  lid: {mass: 0.2, parts: {plate: {shape: {box: [0.1, 0.1, 0.01]}}}}
  shelf: {mass: 0.5, gravity_compensation: 0.25, parts: {board: {shape: {box: [0.2, 0.1, 0.01]}}}}
  pan: {mass: 0.3, parts: {dish: {shape: {box: [0.1, 0.08, 0.02]}}}}
  grip: {mass: 0.1, parts: {bar: {shape: {box: [0.01, 0.05, 0.01]}}}}
joints:
  slide: {type: prismatic, parent: frame, child: drawer, axis: [1, 0, 0], limits: [0, 0.2], damping: 3, friction: 0.5,
          armature: 0.01,
          drive: {stiffness: 50, damping: 5}}
  hinge: {type: revolute, parent: frame, child: door, limits_deg: [0, 90], closed: upper, damping: 0.1, friction: 0.05,
          effort: 12, velocity_deg: 180}
  turn: {type: continuous, parent: door, child: knob, pose: {xyz: [0.03, 0.1, 0.1]}}
  nod: {type: ball, parent: frame, child: head, pose: {xyz: [0, 0, 0.4]}}
  loose: {type: free, parent: frame, child: lid, pose: {xyz: [0, 0, 0.6]}}
  along: {type: prismatic, parent: frame, child: shelf, pose: {xyz: [0, 0, 0.3]}, axis: [1, 0, 0], limits: [0, 0.4],
          mimic: {joint: slide, multiplier: 2}}
  gimbal: {parent: frame, child: pan, pose: {xyz: [0, -0.4, 0.5]}, axes: {
           pitch: {type: revolute, axis: [0, 1, 0], limits_deg: [-40, 40], damping: 0.1},
           roll: {type: continuous, axis: [1, 0, 0], friction: 0.02}}}
  weld: {type: fixed, parent: drawer, child: grip, pose: {xyz: [0.12, 0, 0.1]}}
"""

ATTACHMENTS = """\
sites:
  handle: {link: door, pose: {xyz: [0.02, 0.15, 0.1], rpy_deg: [10, 20, 30]}}
actuators:
  spin: {type: motor, joint: turn, gear: 2, control: 0.1, control_range: [-1, 1]}
  close: {type: position, joint: hinge, kp: 5, kv: 0.5, force_range: [-3, 3]}
sensors:
  pull: {type: force, site: handle, noise: 0.1}
  angle: {type: joint_position, joint: hinge}
  place: {type: position, link: drawer}
"""

OPTIONS = """\
options: {timestep: 0.001, solver_iterations: 60}
native:
  mjcf: {custom: [{numeric: {name: answer, data: [42]}}]}
"""

LIGHTS = {
    "distant_lights": "  sun: {type: distant, intensity: 0.6, direction: [0.2, 0.1, -1]}\n",
    "point_lights": "  lamp: {type: point, intensity: 0.5, xyz: [0.2, 0.4, 1.1]}\n",
    "dome_lights": "  sky: {type: dome, intensity: 0.3}\n",
}

PANORAMA = {"dome_textures": "  room: {type: dome, intensity: 0.3, texture: tile.png}\n"}
"""A light of its own, because a dome with a picture is also a dome light."""

HULLS = """\
  egg: {shape: {ellipsoid: [0.02, 0.02, 0.03]}, mass: 0.06, place: {on: desk, xy: [0.4, 0.25]}}
  hat: {shape: {cone: {radius: 0.04, height: 0.1}}, mass: 0.05, place: {on: desk, xy: [0.5, 0.25]}}
"""
"""Shapes that some engines approximate by hulls."""

ROBOT = """\
<mujoco model="arm">
  <compiler angle="radian"/>
  <worldbody>
    <body name="foot">
      <geom name="foot" type="cylinder" size="0.05 0.05" mass="2"/>
      <body name="hand" pos="0 0 0.1">
        <joint name="turn" axis="0 1 0" range="-1.5 1.5" damping="0.5"/>
        <geom name="hand" type="box" size="0.02 0.03 0.1" pos="0 0 0.1" mass="0.5" friction="0.9"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="turn" joint="turn" kp="100" kv="5" ctrlrange="-1.5 1.5" forcerange="-20 20"/>
  </actuator>
</mujoco>
"""
"""A robot whose model is a file of its own, for features called ``robots``."""

TILE = (
    "mtllib tile.mtl\n"
    + "".join(
        f"v {x} {y} {z}\nvt {u} {v}\n"
        for x, y, z, u, v in [(0, 0, 0, 0, 0), (0.1, 0, 0, 1, 0), (0, 0.1, 0, 0, 1), (0, 0, 0.05, 1, 1)]
    )
    + "usemtl skin\nf 1/1 3/3 2/2\nf 1/1 2/2 4/4\nf 1/1 4/4 3/3\nf 2/2 3/3 4/4\n"
)

ROOM = "v -3 -3 -1\nv 3 -3 -1\nv 3 3 -1\nv -3 3 -1\nv 0 3 2\nf 1 2 3\nf 1 3 4\nf 4 3 5\n"


def splat_ply(count: int = 7, degree: int = 1, seed: int = 3) -> tuple[bytes, dict[str, np.ndarray]]:
    """A Gaussian splat as trainers write it, and its raw columns by name."""
    rest = 3 * ((degree + 1) ** 2 - 1)
    names = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{k}" for k in range(rest))]
    names += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    data = np.random.default_rng(seed).normal(size=(count, len(names))).astype("<f4")
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n"
    head += "".join(f"property float {name}\n" for name in names) + "end_header\n"
    return head.encode() + data.tobytes(), dict(zip(names, data.T, strict=True))


def write_everything(folder: Path, *features: str) -> Path:
    """The scene, with lights, background, a robot's model where ``features`` names them; the path of its document."""
    from PIL import Image

    text = SCENE
    if "robots" in features:
        text = text.replace("model: franka_robotiq", "model: {mjcf: arm.xml}, joints: {turn: 0.3}")
        (folder / "arm.xml").write_text(ROBOT)
    shone = [text for name, text in (LIGHTS | PANORAMA).items() if name in features]
    if "hulls" in features:
        text = text.replace("robots:\n", f"{HULLS}robots:\n", 1)
    text += "lights:\n" + "".join(shone) if shone else ""
    if "background_mesh" in features:
        text += "background: {mesh: room.obj, pose: {xyz: [1, 2, 0], yaw_deg: 30}}\n"
    if "background_splat" in features:
        text += "background: {splat: room.ply, pose: {xyz: [1, 2, 0], yaw_deg: 30}, scale: 2}\n"
    if "attachments" in features:
        text += OPTIONS
    attached = ATTACHMENTS if "attachments" in features else ""
    (folder / "cabinet.asset.yaml").write_text(CABINET + attached)
    (folder / "tile.obj").write_text(TILE)
    (folder / "tile.mtl").write_text("newmtl skin\nKd 1 1 1\nmap_Kd tile.png\n")
    (folder / "tile.png").write_bytes(checker_png())
    Image.open(folder / "tile.png").verify()
    (folder / "room.obj").write_text(ROOM)
    (folder / "room.ply").write_bytes(splat_ply()[0])
    path = folder / "everything.scene.yaml"
    path.write_text(text)
    return path
