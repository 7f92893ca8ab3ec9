"""The skill of opening and closing joints with one hand, which pushes the edge of a lid or holds a handle."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np

from simfoundry.evaluate.expert.candidates import Grasp, down, grasps
from simfoundry.evaluate.expert.joints import DrivenJoint, joint_of
from simfoundry.evaluate.expert.motion import ArmPlanner, Path
from simfoundry.evaluate.expert.pushing import pushes
from simfoundry.evaluate.expert.skills import GraspPlan, before, hand_fits, path_to, seize
from simfoundry.evaluate.expert.worker import CAREFUL, ExpertWorker, FailedError, Script
from simfoundry.geometry.frames import Array
from simfoundry.robots.arm import Jaws
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import JointType
from simfoundry.scene.object_shapes import solid

# Maximum number of collision-free grasps of a handle to try with the arm.
TRIES = 80

# Fractions of its range to which a joint is opened; the first reachable one is used.
WIDE = (0.94, 0.75, 0.5)

# Distance [m or rad] past its closed end to which a joint is moved, so that it closes completely.
BEYOND = 0.003

# Step between hand poses along the joint's motion [m or rad].
STEP = 0.02

# Maximum distance [m] of handle geometry from the link's outermost point in the opening direction.
OUTER = 0.02

# Downward pitch angles of a hand that approaches a handle from the front [rad].
SLANTS = (0.0, 0.4, 0.8, 1.2)

# Factors that remove the vertical component of a vector.
LEVEL = np.array([1.0, 1.0, 0.0])


def lead(worker: ExpertWorker, robot: str, target: str, opening: bool) -> Script:
    """Open or close a joint by pushing the link that it moves, or by moving its handle."""
    owner, _, name = target.partition(".")
    item = worker.scene.object(owner)
    handle = _Handle(item, worker.now.state, joint_of(item, name))
    closed, opened = handle.ends
    goals = [closed + share * (opened - closed) for share in WIDE] if opening else [closed]
    worker.sync()
    planner, q = worker.planners[robot], worker.q[robot]
    if (push := next(pushes(planner, q, handle, goals[0]), None)) is not None:
        worker.share[robot] = 1.0
        yield from worker.go(robot, push.to)
        for path in (push.down, push.along, push.back):
            yield from worker.creep(robot, path)
        yield from worker.wait(0.3)
        return
    plan = next((plan for goal in goals for plan in _plans(planner, q, handle, goal)), None)
    if plan is None:
        raise FailedError(f"{robot} could not find a way to move {target} by a handle")
    yield from seize(worker, robot, plan)
    yield from worker.creep(robot, plan.along)
    yield from worker.grip(robot, plan.grasp.open)
    yield from worker.follow(robot, plan.back, CAREFUL)
    yield from worker.wait(0.3)


@dataclass(frozen=True, eq=False)
class _Handle(DrivenJoint):
    """The handle that moves a joint of an object in a given state."""

    def front(self, corners: Array) -> Array:
        """Return the direction in which the handle protrudes.

        This is the opening direction of a drawer, or the horizontal direction away from a hinge.
        """
        if self.joint.type is JointType.PRISMATIC:
            closed, opened = self.ends
            outward = self.motion(self.now + math.copysign(1e-3, opened - closed))
            way = outward.apply(corners[:1])[0] - corners[0]
            return np.asarray(way / np.linalg.norm(way))
        X_OC = link_poses(self.item, self.state.of_object(self.item))[self.joint.child]
        return _unit((corners.mean(axis=0) - (self.state.poses[self.item.name] @ X_OC).p) * LEVEL)

    def grasps(self, jaws: Jaws) -> list[Grasp]:
        """Return grasps of the geometry that protrudes from the joint's child link, starting with the best one.

        The hand approaches from the front, at a downward slant, or from above.
        """
        child = [self.joint.child]
        shape = solid(self.item, self.state, child)
        front = self.front(shape.corners)
        along = shape.corners @ front
        outermost = float(along.max()) - OUTER
        outer = solid(self.item, self.state, child, lambda corners: float((corners @ front).max()) > outermost)
        level = _unit(-front * LEVEL)
        slanted = [math.cos(t) * level - math.sin(t) * np.array([0.0, 0.0, 1.0]) for t in SLANTS]
        return grasps(outer, shape.corners[along > outermost].mean(axis=0), jaws, [*slanted, *down()])


def _unit(v: Array) -> Array:
    return np.asarray(v / max(float(np.linalg.norm(v)), 1e-9))


def _plans(planner: ArmPlanner, q: Array, handle: _Handle, goal: float) -> Iterator[GraspPlan]:
    """Yield plans in which the arm grasps the handle and moves the joint to ``goal`` [rad or m]."""
    fitting = (grasp for grasp in handle.grasps(planner.jaws) if hand_fits(planner, grasp, grasp.open))
    for grasp in islice(fitting, TRIES):
        to = path_to(planner, q, grasp)
        along = None if to is None else _along(planner, to[-1], grasp, handle, goal)
        if to is None or along is None:
            continue
        away = before(planner.arm.hand(along[-1]))
        back = planner.line(along[-1], away, grasp.open, ignore=[handle.item.name])
        way = planner.way(q, to[0], grasp.open) if back is not None else None
        if back is not None and way is not None:
            yield GraspPlan(grasp, way, to, along, back)


def _along(planner: ArmPlanner, q: Array, grasp: Grasp, handle: _Handle, goal: float) -> Path | None:
    """Return configurations in which the hand follows the joint, or None if the arm is unable to follow it.

    When the joint is closed, the hand moves slightly past its closed end.
    """
    now, held = handle.now, planner.jaws.at_width(grasp.width)[0]
    far = goal + math.copysign(BEYOND, goal - now) if abs(goal - handle.ends[0]) < 1e-9 else goal
    count = max(1, math.ceil(abs(far - now) / STEP))
    along: Path = [q]
    for k in range(1, count + 1):
        X_WH = handle.motion(now + (far - now) * k / count) @ grasp.X_WH
        part = planner.line(along[-1], X_WH, held, ignore=[handle.item.name])
        if part is None:
            return None
        along += part[1:]
    return along
