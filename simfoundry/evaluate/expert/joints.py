"""Skills to open and close joints: a handle is grasped and led along the joint's motion."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from simfoundry.evaluate.expert.candidates import Grasp, down, grasps
from simfoundry.evaluate.expert.handling import STANDOFF, firmly
from simfoundry.evaluate.expert.motion import ArmPlanner, Path
from simfoundry.evaluate.expert.worker import CAREFUL, ExpertWorker, FailedError, Script
from simfoundry.geometry.frames import Array, Pose
from simfoundry.robots.arm import Jaws
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Joint, JointType, SceneObject
from simfoundry.scene.object_shapes import solid
from simfoundry.scene.state import SceneState, object_at

WIDE = (0.94, 0.75, 0.5)
"""Shares of the range to which a joint is opened; the first reachable one is used."""

BEYOND = 0.003
"""Distance past its closed end to which a handle is led [m or rad], so that the joint reaches the end."""

STEP = 0.02
"""Step between hand poses along the joint's motion [m or rad]."""

OUTER = 0.02
"""Maximum distance of handle geometry from the link's outermost point in the opening direction [m]."""

SLANTS = (0.0, 0.4, 0.8, 1.2)
"""Downward pitch angles of a hand that approaches a handle from its front [rad]."""

TRIES = 80


@dataclass(frozen=True, eq=False)
class LeadPlan:
    """A plan to lead a handle: paths to a stop before the grasp, to it, along the joint, and back."""

    grasp: Grasp
    to: Path
    down: Path
    along: Path
    back: Path


@dataclass(frozen=True, eq=False)
class _Leading:
    """A joint to be moved from ``now`` to ``goal`` [rad or m] in a given state."""

    item: SceneObject
    state: SceneState
    joint: Joint
    now: float
    goal: float


def joint_of(item: SceneObject, name: str) -> Joint:
    """Return the named joint, or the one that moves the named link; for an object alone, its first movable joint."""
    for joint in item.joints:
        if joint.has_axis and name in ("", joint.name, joint.child):
            return joint
    raise FailedError(f"{item.name} has no joint {name} that moves")


def ends(joint: Joint) -> tuple[float, float]:
    """Positions at which a joint is closed (the limit nearer to zero) and fully open [rad or m]."""
    if joint.limits is None:
        raise FailedError(f"joint {joint.name} has no limits, so it can neither open nor close")
    low, high = joint.limits
    return (low, high) if abs(low) <= abs(high) else (high, low)


def lead(worker: ExpertWorker, robot: str, target: str, opening: bool) -> Script:
    """Open or close a joint by its handle."""
    owner, _, name = target.partition(".")
    item = worker.scene.object(owner)
    joint = joint_of(item, name)
    closed, opened = ends(joint)
    goals = [closed + share * (opened - closed) for share in WIDE] if opening else [closed]
    worker.sync()
    plan = next((p for goal in goals if (p := plan_lead(worker, robot, item, joint, goal)) is not None), None)
    if plan is None:
        raise FailedError(f"{robot} finds no way to lead {target} by a handle")
    worker.share[robot] = plan.grasp.open
    yield from worker.go(robot, plan.to)
    yield from worker.settle(robot)
    yield from worker.follow(robot, plan.down, CAREFUL)
    yield from worker.settle(robot)
    yield from worker.grip(robot, firmly(worker.planners[robot], plan.grasp.width))
    yield from worker.follow(robot, plan.along, CAREFUL)
    yield from worker.settle(robot)
    yield from worker.grip(robot, plan.grasp.open)
    yield from worker.follow(robot, plan.back, CAREFUL)
    yield from worker.wait(0.3)


def plan_lead(worker: ExpertWorker, robot: str, item: SceneObject, joint: Joint, goal: float) -> LeadPlan | None:
    """Plan the first handle grasp with which the arm can lead the joint to ``goal`` [rad or m]."""
    planner, state = worker.planners[robot], worker.now.state
    leading = _Leading(item, state, joint, state.joints[f"{item.name}.{joint.name}"], goal)
    tried = 0
    for grasp in handle_grasps(item, state, joint, planner.jaws):
        planner.cell.pose(robot, planner.arm.home, grasp.open)
        if planner.cell.hand_clash(robot, grasp.X_WH, gap=0.001):
            continue
        tried += 1
        if tried > TRIES:
            return None
        plan = _led(planner, worker.q[robot], grasp, leading)
        if plan is not None:
            return plan
    return None


def handle_grasps(item: SceneObject, state: SceneState, joint: Joint, jaws: Jaws) -> list[Grasp]:
    """Grasps of geometry that protrudes from a joint's child, from the front, slanted and from above, best first."""
    shape = solid(item, state, [joint.child])
    front = _front(item, state, joint, shape.corners)
    along = shape.corners @ front
    outermost = float(along.max()) - OUTER
    handle = shape.corners[along > outermost].mean(axis=0)
    level = -front * [1.0, 1.0, 0.0]
    level /= max(float(np.linalg.norm(level)), 1e-9)
    slanted = [math.cos(t) * level - math.sin(t) * np.array([0.0, 0.0, 1.0]) for t in SLANTS]
    grip = solid(item, state, [joint.child], lambda corners: float((corners @ front).max()) > outermost)
    return grasps(grip, handle, jaws, [*slanted, *down()])


def _front(item: SceneObject, state: SceneState, joint: Joint, corners: Array) -> Array:
    """Direction in which a handle protrudes: that of a drawer's motion, or away from a hinge."""
    if joint.type is not JointType.PRISMATIC:
        return _away(item, state, joint, corners)
    now = state.joints[f"{item.name}.{joint.name}"]
    closed, opened = ends(joint)
    outward = _motion(item, state, joint, now, now + math.copysign(1e-3, opened - closed))
    way = outward.apply(corners[:1])[0] - corners[0]
    return np.asarray(way / np.linalg.norm(way))


def _led(planner: ArmPlanner, q: Array, grasp: Grasp, leading: _Leading) -> LeadPlan | None:
    """Plan the arm's paths from ``q`` to a grasp, along the joint, and back."""
    before = Pose.of(grasp.X_WH.p - STANDOFF * grasp.X_WH.rotation[:, 2], grasp.X_WH.q)
    start = planner.arm.solve_any(before, q, planner.rng)
    if start is None or not planner.clear(start, grasp.open):
        return None
    to = planner.line(start, grasp.X_WH, grasp.open, gap=0.001)
    if to is None:
        return None
    along = _along(planner, to[-1], grasp, leading)
    if along is None:
        return None
    end, name = planner.arm.hand(along[-1]), leading.item.name
    back = planner.line(along[-1], Pose.of(end.p - STANDOFF * end.rotation[:, 2], end.q), grasp.open, ignore=[name])
    way = planner.way(q, start, grasp.open) if back is not None else None
    return None if back is None or way is None else LeadPlan(grasp, way, to, along, back)


def _along(planner: ArmPlanner, q: Array, grasp: Grasp, leading: _Leading) -> Path | None:
    """Postures in which the hand follows the joint, slightly past its closed end; None if it cannot."""
    item, joint, now, goal = leading.item, leading.joint, leading.now, leading.goal
    far = goal + math.copysign(BEYOND, goal - now) if abs(goal - ends(joint)[0]) < 1e-9 else goal
    held = planner.jaws.at_width(grasp.width)[0]
    count = max(1, math.ceil(abs(far - now) / STEP))
    along: Path = [q]
    for k in range(1, count + 1):
        X_WH = _motion(item, leading.state, joint, now, now + (far - now) * k / count) @ grasp.X_WH
        part = planner.line(along[-1], X_WH, held, ignore=[item.name])
        if part is None:
            return None
        along += part[1:]
    return along


def _motion(item: SceneObject, state: SceneState, joint: Joint, now: float, then: float) -> Pose:
    """Motion in the world of a body fixed to a joint's child when the joint moves from ``now`` to ``then``."""
    here = object_at(item, state)
    X_OC = link_poses(here, {**state.of_object(item), joint.name: now})[joint.child]
    X_OD = link_poses(here, {**state.of_object(item), joint.name: then})[joint.child]
    return here.X_WO @ X_OD @ X_OC.inverse() @ here.X_WO.inverse()


def _away(item: SceneObject, state: SceneState, joint: Joint, corners: Array) -> Array:
    """Horizontal direction from a hinge to the center of the part that it moves."""
    here = object_at(item, state)
    hinge = (here.X_WO @ link_poses(here)[joint.child]).p
    away = (corners.mean(axis=0) - hinge) * [1.0, 1.0, 0.0]
    return np.asarray(away / max(float(np.linalg.norm(away)), 1e-9))
