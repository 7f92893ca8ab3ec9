"""A task that needs no robot's model from elsewhere: an arm of our own making beside a block and a dish."""

from __future__ import annotations

from pathlib import Path

ARM = """\
<mujoco model="pusher">
  <compiler angle="radian"/>
  <default><default class="visual"><geom group="2" contype="0" conaffinity="0"/></default></default>
  <worldbody>
    <body name="root">
      <geom class="visual" type="cylinder" size="0.04 0.05" pos="0 0 0.05" rgba="0.3 0.3 0.3 1"/>
      <body name="turret" pos="0 0 0.1">
        <inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
        <joint name="turn" axis="0 0 1" range="-2 2" damping="5"/>
        <geom class="visual" type="box" size="0.03 0.03 0.03" rgba="0.8 0.2 0.1 1"/>
        <body name="boom" pos="0 0 -0.06">
          <inertial pos="0.2 0 0" mass="0.3" diaginertia="0.001 0.001 0.001"/>
          <joint name="reach" type="slide" axis="1 0 0" range="0 0.4" damping="20"/>
          <geom class="visual" type="box" size="0.1 0.012 0.012" pos="0.1 0 0" rgba="0.8 0.2 0.1 1"/>
          <geom type="box" size="0.02 0.02 0.02" pos="0.2 0 0" rgba="0.8 0.2 0.1 1" group="3"/>
          <geom class="visual" type="box" size="0.02 0.02 0.02" pos="0.2 0 0" rgba="0.8 0.2 0.1 1"/>
          <body name="hand" pos="0.22 0 0"><inertial pos="0 0 0" mass="0.01" diaginertia="1e-5 1e-5 1e-5"/></body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="turn" joint="turn" kp="100" ctrlrange="-2 2"/>
    <position name="reach" joint="reach" kp="400" ctrlrange="0 0.4"/>
  </actuator>
</mujoco>
"""

SCENE = """\
simfoundry: scene/1
name: bench
materials:
  wood: {density: 600, friction: 0.4}
objects:
  table: {fixed: true, shape: {box: [1.2, 1.2, 0.04]}, material: wood, pose: {xyz: [0.4, 0, -0.02]}}
  block: {shape: {box: [0.05, 0.05, 0.05]}, material: wood, place: {on: table, xy: [0.32, 0]}}
  dish: {shape: {box: [0.1, 0.1, 0.02]}, material: wood, place: {on: table, xy: [0.3, 0.3]}}
  crumb: {shape: {box: [0.02, 0.02, 0.02]}, material: wood, place: {on: dish}}
robots:
  arm: {model: {mjcf: arm.xml}}
cameras:
  front: {size: [640, 480], fx: 500, fy: 500, pose: {xyz: [1.3, 0, 0.7], look_at: [0.3, 0, 0]}}
  top: {size: [480, 480], fx: 400, fy: 400, pose: {xyz: [0.4, 0.001, 1.2], look_at: [0.4, 0, 0]}}
  tip: {size: [320, 240], fx: 200, fy: 200, pose: {xyz: [0, 0, 0.2], look_at: [0.3, 0, 0]}, mount: arm.boom}
relations: [OnTop(block, table), OnTop(dish, table), OnTop(crumb, dish)]
"""

TASK = """\
simfoundry: task/1
name: push
scene: bench.scene.yaml
instruction: Push the block away.
goal: At(block, 0.45, 0)
subtasks:
  touch: {goal: Touching(arm, block)}
  away:
    goal: At(block, 0.45, 0)
    instruction: Only push.
    start: {place: {block: {on: table, xy: [0.4, 0]}}}
reset:
  objects:
    block: {x: [0.31, 0.33], y: [-0.02, 0.02], yaw_deg: [-10, 10]}
    dish: {x: [0.25, 0.35], y: [0.25, 0.35], yaw_deg: [-180, 180]}
horizon: 45
"""


def write_bench(folder: Path, task: str = TASK, scene: str = SCENE) -> Path:
    """The files of the task in a folder; returns the task's."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "arm.xml").write_text(ARM)
    (folder / "bench.scene.yaml").write_text(scene)
    path = folder / "push.task.yaml"
    path.write_text(task)
    return path
