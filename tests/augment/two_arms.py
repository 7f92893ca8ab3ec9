"""A bar that two arms carry onto a crate together, and the policy that does so by inverse kinematics."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from simfoundry.evaluate.policies.base import Observation
from simfoundry.evaluate.task import load_task
from simfoundry.geometry.frames import Array, Pose, quat_from_matrix
from simfoundry.robots.arm import Arm

SCENE = """\
simfoundry: scene/1
name: pair
objects:
  desk: {fixed: true, shape: {box: [1.6, 1.8, 0.04]}, pose: {xyz: [0.4, 0, -0.02]}}
  bar: {shape: {box: [0.04, 0.5, 0.04]}, density: 300, place: {on: desk, xy: [0.4, 0]}}
  crate: {shape: {box: [0.12, 0.3, 0.05]}, density: 900, place: {on: desk, xy: [0.56, 0]}}
robots:
  left: {model: demo_arm, pose: {xyz: [0, 0.3, 0]}, joints: home}
  right: {model: demo_arm, pose: {xyz: [0, -0.3, 0]}, joints: home}
"""
TASK = """\
simfoundry: task/1
name: carry
scene: pair.scene.yaml
instruction: Carry the bar onto the crate.
goal: {all: ["OnTop(bar, crate)", "Released(bar)"]}
subtasks:
  left_grasps: {goal: "Grasped(bar, left)"}
  right_grasps: {goal: "Grasped(bar, right)"}
  bar_lifted: {goal: Lifted(bar)}
  bar_on_crate: {goal: "OnTop(bar, crate)"}
reset:
  objects:
    bar: {x: [0.36, 0.4], y: [-0.03, 0.03], yaw_deg: [-6, 6]}
    crate: {x: [0.55, 0.58], y: [-0.03, 0.03]}
horizon: 300
"""

# Height of the hand above the middle of the bar when it grasps, and distance of the hands from the middle [m].
GRASP, APART = 0.125, 0.19

# The hand points down, and its fingers close across the bar.
DOWN = quat_from_matrix(np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]))


def write_pair(folder: Path) -> Path:
    """Write the files of the task, and return its path."""
    (folder / "pair.scene.yaml").write_text(SCENE)
    (folder / "carry.task.yaml").write_text(TASK)
    return folder / "carry.task.yaml"


class Carry:
    """Both hands grasp the bar, lift it, and put it on the crate. The right hand grasps later than the left one."""

    action_space = "joint_position"

    def __init__(self, task: str = "carry.task.yaml") -> None:
        scene = load_task(Path(task)).scene
        self._arms = {name: Arm(scene.robot(name)) for name in ("left", "right")}

    def reset(self, instruction: str, seed: int) -> None:
        self._rows: Iterator[Array] | None = None

    def infer(self, observation: Observation) -> Array:
        if self._rows is None:
            self._rows = iter(self._plan(observation))
            self._last = np.zeros(0)
        self._last = next(self._rows, self._last)
        return self._last[None]

    def _plan(self, observation: Observation) -> list[Array]:
        bar, crate = observation.objects["bar"], observation.objects["crate"]
        on = Pose.of([*crate.p[:2], crate.p[2] + 0.025 + 0.02 + 0.004], crate.q)
        over = Pose.of([*on.p[:2], 0.16], on.q)
        lifted = Pose.of([*bar.p[:2], 0.16], bar.q)
        # The pose of the bar that the hands act on, the height of the hands above it, the gripper, and the actions.
        stages = [
            (bar, GRASP + 0.1, 0.0, 25), (bar, GRASP, 0.0, 18), (bar, GRASP, 0.65, 14), (lifted, GRASP, 0.65, 18),
            (over, GRASP, 0.65, 24), (on, GRASP, 0.65, 14), (on, GRASP, 0.0, 6), (on, GRASP + 0.1, 0.0, 15),
        ]  # fmt: skip
        q = {name: np.array(observation.robots[name].joints) for name in self._arms}
        before = {name: self._arms[name].hand(q[name]) for name in self._arms}
        share = 0.0
        rows = []
        for X_WO, height, gripper, count in stages:
            goals = {name: _hand(X_WO, height, sign) for name, sign in (("left", 1.0), ("right", -1.0))}
            for k in range(1, count + 1):
                row = []
                for name, arm in self._arms.items():
                    p = before[name].p + (goals[name].p - before[name].p) * k / count
                    q[name], _ = arm.approach(Pose.of(p, goals[name].q), q[name])
                    late = name == "right" and gripper > share and k < count // 2
                    row += [*q[name], share if late else gripper]
                rows.append(np.array(row))
            before, share = goals, gripper
        return rows


def _hand(X_WO: Pose, height: float, side: float) -> Pose:
    return X_WO @ Pose.of([0.0, side * APART, height], DOWN)
