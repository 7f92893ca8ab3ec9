"""Manipulation skills of one hand: picking and placing objects, and opening and closing joints by their handles."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from simfoundry.evaluate.expert.candidates import Grasp, PlaceAt, down, grasps
from simfoundry.evaluate.expert.motion import ArmPlanner, Held, Path
from simfoundry.evaluate.expert.worker import CAREFUL, ExpertWorker, FailedError, Script
from simfoundry.geometry.frames import Array, Pose
from simfoundry.robots.arm import Jaws
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Joint, JointType, SceneObject
from simfoundry.scene.object_shapes import solid
from simfoundry.scene.state import SceneState, object_at
from simfoundry.worlds.rest import center_of_mass

# Distance from a grasp at which the hand stops to observe [m].
STANDOFF = 0.09

# Height by which an object is lifted before it is moved away [m].
LIFT = 0.12

# Height above a placement at which the descent starts [m], so that an object clears the rim of a cup.
ABOVE = 0.12

# Height above its placement at which an object is released [m].
DROP = 0.006

# Additional closing command beyond contact, as a fraction of the finger travel; it makes the servo grip harder.
SQUEEZE = 0.04

# Distance by which each finger opens to release an object [m].
RELEASE = 0.012

# Minimum clearance of a hand near the object that it grasps or releases [m].
NARROW = 0.001

# Clearance of the hand at a placement chosen before grasping [m]; the object may slip slightly in the hand.
SPARE = 0.012

# Maximum number of collision-free grasps to try with the arm, and of placements to try for each grasp.
TRIES, CHECKED = 60, 6

# Maximum number of collision-free grasps of a handle to try with the arm.
HANDLE_TRIES = 80

# Fractions of its range to which a joint is opened; the first reachable one is used.
WIDE = (0.94, 0.75, 0.5)

# Distance past its closed end to which a joint is moved [m or rad], so that it closes completely.
BEYOND = 0.003

# Step between hand poses along the joint's motion [m or rad].
STEP = 0.02

# Maximum distance of handle geometry from the link's outermost point in the opening direction [m].
OUTER = 0.02

# Downward pitch angles of a hand that approaches a handle from the front [rad].
SLANTS = (0.0, 0.4, 0.8, 1.2)


class GraspPlan(NamedTuple):
    """An executable grasp.

    Attributes:
        grasp: The grasp.
        to: The path to a waypoint before the grasp.
        down: The path from that waypoint to the grasp.
        along: The path with the grasped object: it is lifted, or a handle is moved along its joint's motion.
        back: The path after the object has been released.
    """

    grasp: Grasp
    to: Path
    down: Path
    along: Path
    back: Path


class PutPlan(NamedTuple):
    """An executable placement.

    Attributes:
        place: The placement.
        to: The path to a waypoint above the placement.
        down: The path from that waypoint to the placement.
        back: The path away from the placement after the object has been released.
        open: The fraction by which the gripper is closed on the way back.
    """

    place: PlaceAt
    to: Path
    down: Path
    back: Path
    open: float


def pick(worker: ExpertWorker, robot: str, name: str, places: list[PlaceAt] | None) -> Script:
    """Pick up an object with a grasp that allows it to be placed at one of ``places``, if any are given."""
    worker.sync()
    plan = _plan_pick(worker, robot, name, places)
    if plan is None:
        raise FailedError(f"{robot} could not find a grasp for {name}")
    yield from _seize(worker, robot, plan)
    X_HO = worker.now.robots[robot].X_WH.inverse() @ worker.now.state.poses[name]
    worker.held[robot] = Held(name, X_HO)
    yield from worker.creep(robot, plan.along)


def put(worker: ExpertWorker, robot: str, places: list[PlaceAt]) -> Script:
    """Place the held object at the first reachable pose in ``places``."""
    held = worker.held[robot]
    worker.sync()
    plan = _plan_put(worker, robot, places)
    if plan is None:
        raise FailedError(f"{robot} could not find a place for {held.name}")
    yield from worker.go(robot, plan.to)
    yield from worker.creep(robot, _corrected(worker, robot, plan))
    del worker.held[robot]
    yield from worker.grip(robot, plan.open)
    yield from worker.follow(robot, plan.back, CAREFUL)
    yield from worker.wait(0.4)


def lead(worker: ExpertWorker, robot: str, target: str, opening: bool) -> Script:
    """Open or close a joint by moving its handle."""
    owner, _, name = target.partition(".")
    item, state = worker.scene.object(owner), worker.now.state
    joint = _joint_of(item, name)
    closed, opened = _ends(joint)
    goals = [closed + share * (opened - closed) for share in WIDE] if opening else [closed]
    worker.sync()
    handle = _Handle(item, state, joint)
    plan = next((p for goal in goals if (p := _plan_lead(worker, robot, handle, goal)) is not None), None)
    if plan is None:
        raise FailedError(f"{robot} could not find a way to move {target} by a handle")
    yield from _seize(worker, robot, plan)
    yield from worker.creep(robot, plan.along)
    yield from worker.grip(robot, plan.grasp.open)
    yield from worker.follow(robot, plan.back, CAREFUL)
    yield from worker.wait(0.3)


def _seize(worker: ExpertWorker, robot: str, plan: GraspPlan) -> Script:
    """Move to a grasp and close the gripper, but not with full force, which would squash light objects."""
    worker.share[robot] = plan.grasp.open
    yield from worker.go(robot, plan.to)
    yield from worker.creep(robot, plan.down)
    yield from worker.grip(robot, min(1.0, worker.planners[robot].jaws.at_width(plan.grasp.width)[0] + SQUEEZE))


def _plan_pick(worker: ExpertWorker, robot: str, name: str, places: list[PlaceAt] | None) -> GraspPlan | None:
    """Plan a grasp with which the arm can reach the object, lift it and place it, or return None if there is none."""
    planner = worker.planners[robot]
    state = worker.now.state
    item = worker.scene.object(name)
    center = center_of_mass(item, state.poses[name])
    q = worker.q[robot]
    for spare, tilts in ((SPARE, (0.0,)), (0.002, (0.0,)), (0.002, (0.35, 0.7))):
        tried = 0
        for grasp in grasps(solid(item, state), center, planner.jaws, down(tilts)):
            held = Held(name, grasp.X_WH.inverse() @ state.poses[name])
            worker.cell.put(name, state.poses[name])
            if not _hand_fits(planner, grasp, name):
                continue
            fitting = None if places is None else _fitting(planner, grasp, held, places, spare)
            worker.cell.put(name, state.poses[name])
            paths = _paths_up(planner, q, grasp, name) if fitting is None or fitting else None
            if paths is None:
                continue
            to_grasp, up = paths
            if fitting is None or any(_can_put(planner, up[-1], held, grasp, p) for p in fitting[:CHECKED]):
                worker.cell.put(name, state.poses[name])
                way = planner.way(q, to_grasp[0], grasp.open)
                if way is not None:
                    return GraspPlan(grasp, way, to_grasp, up, [])
            tried += 1
            if tried >= TRIES:
                break
    return None


def _hand_fits(planner: ArmPlanner, grasp: Grasp, name: str) -> bool:
    """Return True if the hand alone has enough space to approach and to close."""
    cell, robot = planner.cell, planner.name
    cell.pose(robot, planner.arm.home, grasp.open)
    if cell.hand_clash(robot, grasp.X_WH, gap=NARROW):
        return False
    cell.pose(robot, planner.arm.home, planner.jaws.at_width(grasp.width)[0])
    return not cell.hand_clash(robot, grasp.X_WH, gap=NARROW, ignore=name)


def _fitting(planner: ArmPlanner, grasp: Grasp, held: Held, places: list[PlaceAt], spare: float) -> list[PlaceAt]:
    """Return the placements at which the hand has enough space while it holds the object."""
    cell, robot = planner.cell, planner.name
    cell.pose(robot, planner.arm.home, planner.jaws.at_width(grasp.width)[0])
    found = []
    for place in places:
        X_WO = _over(place.X_WO, DROP)
        cell.put(held.name, X_WO)
        if not cell.hand_clash(robot, X_WO @ held.X_HO.inverse(), held.name, gap=spare):
            found.append(place)
            if len(found) >= CHECKED:
                break
    return found


def _path_to(planner: ArmPlanner, q: Array, grasp: Grasp) -> Path | None:
    """Plan the path to a grasp from a waypoint before it that the arm can reach from near ``q``."""
    start = planner.arm.solve_any(_before(grasp.X_WH), q, planner.rng)
    if start is None or not planner.clear(start, grasp.open):
        return None
    return planner.line(start, grasp.X_WH, grasp.open, gap=NARROW)


def _paths_up(planner: ArmPlanner, q: Array, grasp: Grasp, name: str) -> tuple[Path, Path] | None:
    """Plan the path to a grasp from a waypoint before it, and the path back up with the object."""
    way = _path_to(planner, q, grasp)
    closed = planner.jaws.at_width(grasp.width)[0]
    if way is None or not planner.clear(way[-1], closed, gap=NARROW, ignore=[name]):
        return None
    up = planner.line(way[-1], _over(grasp.X_WH, LIFT), closed, ignore=[name])
    return None if up is None else (way, up)


def _can_put(planner: ArmPlanner, q: Array, held: Held, grasp: Grasp, place: PlaceAt) -> bool:
    """Return True if the hand can reach the release pose and the pose above it."""
    X_WH = _over(place.X_WO, DROP) @ held.X_HO.inverse()
    posture = planner.arm.solve_any(X_WH, q, planner.rng)
    if posture is None or not planner.clear(posture, planner.jaws.at_width(grasp.width)[0], held, gap=NARROW):
        return False
    return planner.arm.solve(_over(X_WH, ABOVE), posture) is not None


def _over(pose: Pose, height: float) -> Pose:
    """Return a pose raised by ``height`` [m]."""
    return Pose.of(pose.p + np.array([0.0, 0.0, height]), pose.q)


def _before(X_WH: Pose) -> Pose:
    """Return a hand pose moved back along its approach direction by :data:`STANDOFF`."""
    return Pose.of(X_WH.p - STANDOFF * X_WH.rotation[:, 2], X_WH.q)


def _corrected(worker: ExpertWorker, robot: str, plan: PutPlan) -> Path:
    """Replan the path down to a placement, because the object may have slipped in the hand.

    If there is no such path, return the planned one up to the configuration where the object is at its release height:
    further down, an object that slipped toward the fingertips would be pushed into its support.
    """
    planner, held = worker.planners[robot], worker.held[robot]
    worker.sync()
    release = _over(plan.place.X_WO, DROP)
    goal = release @ held.X_HO.inverse()
    line = planner.line(worker.q[robot], goal, worker.now.robots[robot].gripper, held)
    return line or until_height(plan.down, planner.arm.hand, held.X_HO, float(release.p[2]))


def until_height(path: Path, hand: Callable[[Array], Pose], X_HO: Pose, height: float) -> Path:
    """Cut a downward path where the origin of the object in the hand reaches a height.

    Args:
        path: The path.
        hand: A function that returns the hand pose for a configuration.
        X_HO: The pose of the object in the hand.
        height: The height [m].
    """
    heights = [float((hand(q) @ X_HO).p[2]) for q in path]
    below = next((k for k, z in enumerate(heights) if z < height), len(path))
    if below in (0, len(path)):
        return path[: max(below, 1)]
    # Waypoints are at most 15 mm apart, so the height is close to linear between two of them.
    fraction = (heights[below - 1] - height) / (heights[below - 1] - heights[below])
    return [*path[:below], path[below - 1] + fraction * (path[below] - path[below - 1])]


def _plan_put(worker: ExpertWorker, robot: str, places: Iterable[PlaceAt]) -> PutPlan | None:
    """Plan the first placement that the arm can reach, release the object at, and retreat from, or return None."""
    planner = worker.planners[robot]
    reading = worker.now.robots[robot]
    held = Held(worker.held[robot].name, reading.X_WH.inverse() @ worker.now.state.poses[worker.held[robot].name])
    share = reading.gripper
    width = float(np.interp(share, planner.jaws.share, planner.jaws.width))
    opened = planner.jaws.at_width(min(width + 2 * RELEASE, planner.jaws.opening))[0]
    q = worker.q[robot]
    for place in places:
        goal = _over(place.X_WO, DROP) @ held.X_HO.inverse()
        worker.cell.pose(robot, planner.arm.home, share)
        worker.cell.put(held.name, _over(place.X_WO, DROP))
        if worker.cell.hand_clash(robot, goal, held.name):
            continue
        posture = planner.arm.solve_any(goal, q, planner.rng)
        if posture is None or not planner.clear(posture, share, held, gap=NARROW):
            continue
        rise = planner.line(posture, _over(goal, ABOVE), share, held)
        way = None if rise is None else planner.way(q, rise[-1], share, held)
        if rise is None or way is None:
            continue
        worker.cell.put(held.name, place.X_WO)
        leave = planner.line(posture, _before(goal), opened, ignore=[held.name]) or rise
        return PutPlan(place, way, rise[::-1], leave, opened)
    return None


@dataclass(frozen=True, eq=False)
class _Handle:
    """The handle that moves a joint of an object, in a given state."""

    item: SceneObject
    state: SceneState
    joint: Joint

    @property
    def now(self) -> float:
        """The position of the joint [rad or m]."""
        return self.state.joints[f"{self.item.name}.{self.joint.name}"]

    def motion(self, then: float) -> Pose:
        """Return the motion of the joint's child in the world when the joint moves to ``then`` [rad or m]."""
        here, joints = object_at(self.item, self.state), self.state.of_object(self.item)
        X_OC, X_OD = (link_poses(here, {**joints, self.joint.name: q})[self.joint.child] for q in (self.now, then))
        return here.X_WO @ X_OD @ X_OC.inverse() @ here.X_WO.inverse()

    def front(self, corners: Array) -> Array:
        """Return the direction in which the handle protrudes.

        This is the opening direction of a drawer, or the horizontal direction away from a hinge.
        """
        if self.joint.type is JointType.PRISMATIC:
            closed, opened = _ends(self.joint)
            outward = self.motion(self.now + math.copysign(1e-3, opened - closed))
            way = outward.apply(corners[:1])[0] - corners[0]
            return np.asarray(way / np.linalg.norm(way))
        here = object_at(self.item, self.state)
        away = (corners.mean(axis=0) - (here.X_WO @ link_poses(here)[self.joint.child]).p) * [1.0, 1.0, 0.0]
        return np.asarray(away / max(float(np.linalg.norm(away)), 1e-9))

    def grasps(self, jaws: Jaws) -> list[Grasp]:
        """Return grasps of the geometry that protrudes from the joint's child, best first.

        The hand approaches from the front, at a downward slant, or from above.
        """
        shape = solid(self.item, self.state, [self.joint.child])
        front = self.front(shape.corners)
        along = shape.corners @ front
        outermost = float(along.max()) - OUTER
        center = shape.corners[along > outermost].mean(axis=0)
        level = -front * [1.0, 1.0, 0.0]
        level /= max(float(np.linalg.norm(level)), 1e-9)
        slanted = [math.cos(t) * level - math.sin(t) * np.array([0.0, 0.0, 1.0]) for t in SLANTS]
        outer = solid(
            self.item, self.state, [self.joint.child], lambda corners: float((corners @ front).max()) > outermost
        )
        return grasps(outer, center, jaws, [*slanted, *down()])


def _joint_of(item: SceneObject, name: str) -> Joint:
    """Return the joint with the given name, or the joint that moves the given link.

    If the name is empty, return the first movable joint of the object.
    """
    for joint in item.joints:
        if joint.has_axis and name in ("", joint.name, joint.child):
            return joint
    raise FailedError(f"{item.name} has no movable joint {name}")


def _ends(joint: Joint) -> tuple[float, float]:
    """Return the closed and the fully open position of a joint [rad or m]; the closed one is closer to zero."""
    if joint.limits is None:
        raise FailedError(f"joint {joint.name} has no limits, so it cannot be opened or closed")
    low, high = joint.limits
    return (low, high) if abs(low) <= abs(high) else (high, low)


def _plan_lead(worker: ExpertWorker, robot: str, handle: _Handle, goal: float) -> GraspPlan | None:
    """Plan a grasp of the handle with which the arm can move the joint to ``goal`` [rad or m], or return None."""
    planner, tried = worker.planners[robot], 0
    for grasp in handle.grasps(planner.jaws):
        planner.cell.pose(robot, planner.arm.home, grasp.open)
        if planner.cell.hand_clash(robot, grasp.X_WH, gap=NARROW):
            continue
        tried += 1
        if tried > HANDLE_TRIES:
            return None
        plan = _led(planner, worker.q[robot], grasp, handle, goal)
        if plan is not None:
            return plan
    return None


def _led(planner: ArmPlanner, q: Array, grasp: Grasp, handle: _Handle, goal: float) -> GraspPlan | None:
    """Plan the arm's paths from ``q`` to a grasp, along the joint's motion, and back."""
    to = _path_to(planner, q, grasp)
    along = None if to is None else _along(planner, to[-1], grasp, handle, goal)
    if to is None or along is None:
        return None
    end = _before(planner.arm.hand(along[-1]))
    back = planner.line(along[-1], end, grasp.open, ignore=[handle.item.name])
    way = planner.way(q, to[0], grasp.open) if back is not None else None
    return None if back is None or way is None else GraspPlan(grasp, way, to, along, back)


def _along(planner: ArmPlanner, q: Array, grasp: Grasp, handle: _Handle, goal: float) -> Path | None:
    """Return configurations in which the hand follows the joint, or None if the arm cannot follow it.

    When the joint is closed, the hand moves slightly past its closed end.
    """
    now, held = handle.now, planner.jaws.at_width(grasp.width)[0]
    far = goal + math.copysign(BEYOND, goal - now) if abs(goal - _ends(handle.joint)[0]) < 1e-9 else goal
    count = max(1, math.ceil(abs(far - now) / STEP))
    along: Path = [q]
    for k in range(1, count + 1):
        X_WH = handle.motion(now + (far - now) * k / count) @ grasp.X_WH
        part = planner.line(along[-1], X_WH, held, ignore=[handle.item.name])
        if part is None:
            return None
        along += part[1:]
    return along
