"""Random states of a few things near each other, such that a predicate is often true and often false in them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from simfoundry.geometry.frames import Array, Pose, quat_from_rpy, rotate, rotations
from simfoundry.predicates import Poses, StateBatch
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene
from simfoundry.scene.state import SceneState
from tests.conftest import REPOSITORY

Span = tuple[float, float]


@dataclass(frozen=True)
class Case:
    """A predicate in a scene of ``specs/scenes``: thing ``a`` is put about ``b``, in its frame.

    ``x``, ``y``, ``z`` [m] are the spans of the origin of ``a``; ``upright`` the share of states in which only its yaw
    is random; ``joints`` the spans of joints.
    """

    scene: str
    condition: str
    a: str = ""
    b: str = ""
    x: Span = (0.0, 0.0)
    y: Span = (0.0, 0.0)
    z: Span = (0.0, 0.0)
    upright: float = 0.5
    joints: tuple[tuple[str, float, float], ...] = ()


DRAWER = ("cabinet.drawer", 0.0, 0.04)
LID = ("trash_can.lid", 0.0, 0.5)
CABINET = (("cabinet.drawer", 0.0, 0.16), ("cabinet.bottom_drawer", 0.0, 0.05))

CASES = {
    "OnTop": (
        Case("cup_in_bowl", "OnTop(cup, bowl)", "cup", "bowl", (-0.05, 0.05), (-0.05, 0.05), (0.0, 0.02), 0.9),
        Case("serve_fruits", "OnTop(apple, green_plate)", "apple", "green_plate", (-0.09, 0.09),
             (-0.09, 0.09), (0.0, 0.02)),
        Case("cup_in_bowl", "OnTop(cup, desk)", "cup", "desk", (-0.6, 0.6), (-0.7, 0.7), (0.016, 0.026), 1.0),
    ),
    "Inside": (
        Case("marker_in_cup", "Inside(marker, cup)", "marker", "cup", (-0.02, 0.02), (-0.02, 0.02), (0.02, 0.13), 0.0),
        Case("cup_in_bowl", "Inside(cup, bowl)", "cup", "bowl", (-0.06, 0.06), (-0.06, 0.06), (-0.02, 0.04)),
        Case("throw_away_trash", "Inside(cup, trash_can)", "cup", "trash_can", (-0.08, 0.08), (-0.08, 0.08),
             (-0.08, 0.2)),
        Case("store_marker", "Inside(marker, cabinet.drawer)", "marker", "cabinet", (-0.05, 0.25),
             (-0.12, 0.12), (0.08, 0.2), 0.5, CABINET),
    ),
    "Under": (Case("cup_in_bowl", "Under(bowl, cup)", "cup", "bowl", (-0.1, 0.1), (-0.1, 0.1), (0.0, 0.15)),),
    "Above": (Case("cup_in_bowl", "Above(cup, bowl)", "cup", "bowl", (-0.1, 0.1), (-0.1, 0.1), (0.0, 0.15)),),
    "NextTo": (Case("cup_in_bowl", "NextTo(cup, bowl)", "cup", "bowl", (-0.17, 0.17), (-0.17, 0.17), (-0.05, 0.05)),),
    "Touching": (
        Case("cup_in_bowl", "Touching(cup, bowl)", "cup", "bowl", (-0.12, 0.12), (-0.12, 0.12), (-0.05, 0.12)),
        Case("store_marker", "Touching(marker, cabinet)", "marker", "cabinet", (-0.1, 0.3), (-0.17, 0.17),
             (-0.02, 0.25), 0.5, CABINET),
        Case("panda", "Touching(arm, cube)", "cube", "arm", (-0.05, 0.05), (-0.08, 0.08), (0.02, 0.16)),
    ),
    "LeftOf": (Case("marker_in_cup", "LeftOf(marker, cup)", "marker", "cup", (-0.25, 0.25), (-0.25, 0.25),
             (0.0, 0.1)),),
    "RightOf": (Case("marker_in_cup", "RightOf(marker, cup)", "marker", "cup", (-0.25, 0.25), (-0.25, 0.25),
             (0.0, 0.1)),),
    "InFrontOf": (Case("store_marker", "InFrontOf(marker, cabinet.drawer)", "marker", "cabinet", (-0.5, 0.5),
             (-0.3, 0.3), (0, 0), 0.5, CABINET),),
    "Behind": (Case("store_marker", "Behind(marker, cabinet)", "marker", "cabinet", (-0.5, 0.5), (-0.3, 0.3),
             (0, 0), 0.5, CABINET),),
    "At": (Case("marker_in_cup", "At(cup, 0.52, -0.12, 0.0)", "cup", "desk", (0.15, 0.19), (-0.14, -0.10),
             (0.01, 0.03)),),
    "Open": (Case("store_marker", "Open(cabinet.drawer)", "marker", "cabinet", joints=(DRAWER,)),),
    "Closed": (Case("throw_away_trash", "Closed(trash_can)", "cup", "trash_can", joints=(LID,)),),
    "Upright": (Case("marker_in_cup", "Upright(cup)", "cup", "desk", z=(0.1, 0.2), upright=0.5),),
    "Lifted": (Case("marker_in_cup", "Lifted(cup)", "cup", "marker", (-0.1, 0.1), (-0.1, 0.1), (-0.01, 0.08)),),
    "Grasped": (Case("panda", "Grasped(cube)", "cube", "arm", (-0.015, 0.015), (-0.012, 0.012), (0.085, 0.125), 0.8),),
    "Released": (Case("panda", "Released(cube)", "cube", "arm", (-0.05, 0.05), (-0.06, 0.06), (0.08, 0.16)),),
}  # fmt: skip
"""The cases of each predicate."""

PANDA = """\
simfoundry: scene/1
name: panda
viewpoint: arm
materials: {wood: {density: 500, friction: 0.6}}
objects:
  desk: {fixed: true, shape: {box: [1.1, 1.3, 0.04]}, material: wood, pose: {xyz: [0.35, 0, -0.02]}}
  cube: {shape: {box: [0.04, 0.04, 0.04]}, material: wood, pose: {xyz: [0.5, 0.2, 0.02]}}
robots:
  arm: {model: franka_panda}
"""


@lru_cache(maxsize=8)
def scene(name: str) -> Scene:
    """A scene of ``specs/scenes``, or a cube before a Panda, whose model comes with PyBullet."""
    if name != "panda":
        return lower_file(REPOSITORY / "specs" / "scenes" / f"{name}.scene.yaml")
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "panda.scene.yaml"
        file.write_text(PANDA)
        return lower_file(file)


def random_batch(case: Case, n: int, rng: np.random.Generator) -> StateBatch:
    """``n`` states of a case."""
    lowered = scene(case.scene)
    joints = {name: rng.uniform(low, high, n) for name, low, high in case.joints}
    offset = np.stack([rng.uniform(*span, n) for span in (case.x, case.y, case.z)], axis=1)
    turn = _turns(n, case.upright, rng)
    if case.b == "arm":
        return _in_hand(lowered, offset, turn, rng)
    b = lowered.object(case.b)
    if b.fixed:
        X_WB = Poses.constant(b.X_WO, n)
    else:
        p = b.X_WO.p + rng.uniform([-0.05, -0.05, 0.0], [0.05, 0.05, 0.1], (n, 3))
        X_WB = Poses(p, _leaning(n, rng))
    X_WA = Poses(X_WB.p + rotate(X_WB.R, offset), X_WB.R @ turn)
    return StateBatch(
        n, {o.name: Poses.constant(o.X_WO, n) for o in lowered.objects} | {case.b: X_WB, case.a: X_WA}, joints
    )


def _in_hand(lowered: Scene, offset: Array, turn: Array, rng: np.random.Generator) -> StateBatch:
    """The cube about the hand of an arm in random positions, its fingers about as wide as the cube."""
    from simfoundry.backends.robot_models.mujoco_robot import read_robot
    from simfoundry.backends.robot_models.robot_object import as_object
    from simfoundry.scene.robot import mujoco_model

    robot, n = lowered.robots[0], len(offset)
    native = mujoco_model(robot)
    assert native is not None
    item = as_object(robot, read_robot(robot, native, "arm.")).item
    moving = [j for j in item.joints if j.has_axis]
    arm = {j.name: j.position + rng.uniform(-0.3, 0.3, n) for j in moving}
    width = rng.uniform(0.016, 0.026, n)
    arm |= {j.name: width for j in moving if "finger" in j.name}
    hands = []
    for k in range(n):
        links = link_poses(item, {name: float(v[k]) for name, v in arm.items()})
        hands.append(item.X_WO @ links["panda_hand"])
    X_WH = Poses(np.array([h.p for h in hands]), np.array([h.rotation for h in hands]))
    cube = Poses(X_WH.p + rotate(X_WH.R, offset), X_WH.R @ turn)
    return StateBatch(n, {"cube": cube}, robots={f"arm.{name}": v for name, v in arm.items()})


def _turns(n: int, upright: float, rng: np.random.Generator) -> Array:
    q = rng.normal(size=(n, 4))
    yaw = rng.uniform(-np.pi, np.pi, n)
    level = rng.random(n) < upright
    lean = rng.uniform(0.0, 0.3, (n, 2)) * (rng.random((n, 1)) < 0.5)
    standing = np.array([quat_from_rpy(*angles) for angles in np.column_stack([lean, yaw])])
    return rotations(np.where(level[:, None], standing, q))


def _leaning(n: int, rng: np.random.Generator) -> Array:
    lean = rng.uniform(-0.3, 0.3, (n, 2)) * (rng.random((n, 1)) < 0.3)
    return rotations(np.array([quat_from_rpy(*a) for a in np.column_stack([lean, rng.uniform(-np.pi, np.pi, n)])]))


def states(batch: StateBatch) -> list[SceneState]:
    """The states of a batch one by one."""
    from simfoundry.geometry.frames import quat_from_matrix

    poses = {
        name: [Pose.of(p, quat_from_matrix(R)) for p, R in zip(*x, strict=True)] for name, x in batch.poses.items()
    }
    out = []
    for k in range(batch.n):
        robots: dict[str, dict[str, float]] = {}
        for name, values in batch.robots.items():
            robots.setdefault(name.partition(".")[0], {})[name.partition(".")[2]] = float(values[k])
        joints = {name: float(v[k]) for name, v in batch.joints.items()}
        out.append(SceneState.of({name: x[k] for name, x in poses.items()}, joints, None, robots))
    return out
