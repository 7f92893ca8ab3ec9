"""Manipulation skills with one hand: picking up and placing objects."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from typing import NamedTuple

import numpy as np

from simfoundry.evaluate.expert.candidates import Grasp, PlaceAt, down, grasps
from simfoundry.evaluate.expert.motion import ArmPlanner, Held, Path
from simfoundry.evaluate.expert.worker import CAREFUL, ExpertWorker, FailedError, Script
from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.object_shapes import solid
from simfoundry.worlds.rest import center_of_mass

# Distance from a grasp at which the hand stops to observe [m].
STANDOFF = 0.09

# Height [m] by which an object is lifted before it is moved away.
LIFT = 0.12

# Height [m] above a placement at which the descent starts, so that an object clears the rim of a cup.
ABOVE = 0.12

# Height above its placement at which an object is released [m].
DROP = 0.006

# Heights above a placement inside something at which an object is released [m]; the first one at which the fingers can
# open without touching the walls is used. A hand that opens deep inside a can gets stuck there and lifts the can.
DROPS = (DROP, 0.03, 0.06, 0.09, 0.12)

# Additional closing command after contact, as a fraction of the finger travel, which makes the servo grip harder.
SQUEEZE = 0.04

# Distance by which each finger opens to release an object [m].
RELEASE = 0.012

# Minimum clearance [m] of a hand near the object that it grasps or releases.
NARROW = 0.001

# Clearance [m] of the hand at a placement that is chosen before the grasp, because the object may slip in the hand.
SPARE = 0.012

# Maximum number of collision-free grasps to try with the arm, and maximum number of placements to try for each of them.
TRIES, CHECKED = 60, 6


class GraspPlan(NamedTuple):
    """A grasp with the paths that execute it.

    Attributes:
        grasp: The grasp.
        to: The path to a waypoint before the grasp.
        down: The path from that waypoint to the grasp.
        along: The path that lifts the grasped object, or that moves the grasped handle along with its joint.
        back: The path after the object has been released.
    """

    grasp: Grasp
    to: Path
    down: Path
    along: Path
    back: Path


class PutPlan(NamedTuple):
    """A placement with the paths that execute it.

    Attributes:
        place: The placement.
        to: The path to a waypoint above the placement.
        down: The path from that waypoint to the placement.
        back: The path away from the placement after the object has been released.
        open: The fraction by which the gripper is closed on the way back.
        drop: The height above the placement at which the object is released [m].
    """

    place: PlaceAt
    to: Path
    down: Path
    back: Path
    open: float
    drop: float


def pick(worker: ExpertWorker, robot: str, name: str, places: list[PlaceAt] | None) -> Script:
    """Pick up an object.

    If ``places`` are given, grasps are preferred with which the object can be placed at one of them.
    """
    worker.sync()
    plan = _plan_pick(worker, robot, name, places)
    if plan is None and places is not None:
        # An object in the hand can still be dropped, or be put somewhere from which it can be grasped otherwise.
        worker.sync()
        plan = _plan_pick(worker, robot, name, None)
    if plan is None:
        raise FailedError(f"{robot} could not find a grasp for {name}")
    yield from seize(worker, robot, plan)
    X_HO = worker.now.robots[robot].X_WH.inverse() @ worker.now.state.poses[name]
    worker.held[robot] = Held(name, X_HO)
    yield from worker.creep(robot, plan.along)


def put(worker: ExpertWorker, robot: str, places: list[PlaceAt], inside: bool = False) -> Script:
    """Place the held object at the first pose in ``places`` that the arm can reach.

    If the places are ``inside`` something, the object may be dropped from a height at which the fingers have space.
    """
    held = worker.held[robot]
    worker.sync()
    plan = _plan_put(worker, robot, places, DROPS if inside else DROPS[:1])
    if plan is None and inside:
        plan = _plan_put(worker, robot, _as_held(worker, held.name, places), DROPS[1:])
    if plan is None:
        raise FailedError(f"{robot} could not find a place for {held.name}")
    yield from worker.go(robot, plan.to)
    yield from worker.creep(robot, _corrected(worker, robot, plan))
    del worker.held[robot]
    yield from worker.grip(robot, plan.open)
    yield from worker.follow(robot, plan.back, CAREFUL)
    yield from worker.wait(0.4)


def seize(worker: ExpertWorker, robot: str, plan: GraspPlan) -> Script:
    """Move to a grasp and close the gripper gently.

    The full force of the gripper would squash light objects.
    """
    worker.share[robot] = plan.grasp.open
    yield from worker.go(robot, plan.to)
    yield from worker.creep(robot, plan.down)
    yield from worker.grip(robot, min(1.0, worker.planners[robot].jaws.at_width(plan.grasp.width)[0] + SQUEEZE))


def _plan_pick(worker: ExpertWorker, robot: str, name: str, places: list[PlaceAt] | None) -> GraspPlan | None:
    """Plan a grasp with which the arm can reach, lift and place the object.

    The result is None if there is no such grasp.
    """
    planner, q = worker.planners[robot], worker.q[robot]
    item, X_WO = worker.scene.object(name), worker.now.state.poses[name]
    shape, center = solid(item, worker.now.state), center_of_mass(item, X_WO)
    for spare, tilts in ((SPARE, (0.0,)), (0.002, (0.0,)), (0.002, (0.35, 0.7))):
        tried = 0
        for grasp in grasps(shape, center, planner.jaws, down(tilts), planner.arm.hand(planner.arm.home)):
            held, closed = Held(name, grasp.X_WH.inverse() @ X_WO), planner.jaws.at_width(grasp.width)[0]
            worker.cell.put(name, X_WO)
            if not (hand_fits(planner, grasp, grasp.open) and hand_fits(planner, grasp, closed, ignore=name)):
                continue
            fitting = None if places is None else list(_fitting(planner, closed, held, places, spare))
            worker.cell.put(name, X_WO)
            paths = _paths_up(planner, q, grasp, name) if fitting is None or fitting else None
            if paths is None:
                continue
            to_grasp, up = paths
            if fitting is None or any(_can_put(planner, up[-1], held, closed, place) for place in fitting):
                worker.cell.put(name, X_WO)
                way = planner.way(q, to_grasp[0], grasp.open)
                if way is not None:
                    return GraspPlan(grasp, way, to_grasp, up, [])
            tried += 1
            if tried >= TRIES:
                break
    return None


def hand_fits(planner: ArmPlanner, grasp: Grasp, share: float, ignore: str = "") -> bool:
    """Return True if the hand has enough space at a grasp.

    The gripper is closed by the fraction ``share``.
    """
    planner.cell.pose(planner.name, planner.arm.home, share)
    return not planner.cell.hand_clash(planner.name, grasp.X_WH, gap=NARROW, ignore=ignore)


def _fitting(planner: ArmPlanner, closed: float, held: Held, places: list[PlaceAt], spare: float) -> Iterator[PlaceAt]:
    """Yield up to :data:`CHECKED` placements at which the hand has enough space while holding the object."""
    planner.cell.pose(planner.name, planner.arm.home, closed)
    fits = (p for p in places if not _clashes(planner, _over(p.X_WO, DROP), held, spare))
    yield from islice(fits, CHECKED)


def _clashes(planner: ArmPlanner, X_WO: Pose, held: Held, gap: float = 0.0) -> bool:
    """Return True if the hand that holds an object at a given pose is closer than ``gap`` [m] to anything else."""
    planner.cell.put(held.name, X_WO)
    return planner.cell.hand_clash(planner.name, X_WO @ held.X_HO.inverse(), held.name, gap=gap)


def path_to(planner: ArmPlanner, q: Array, grasp: Grasp) -> Path | None:
    """Plan the path to a grasp from a waypoint before it.

    The arm must be able to reach the waypoint from near ``q``.
    """
    start = planner.arm.solve_any(before(grasp.X_WH), q, planner.rng)
    if start is None or not planner.clear(start, grasp.open):
        return None
    return planner.line(start, grasp.X_WH, grasp.open, gap=NARROW)


def _paths_up(planner: ArmPlanner, q: Array, grasp: Grasp, name: str) -> tuple[Path, Path] | None:
    """Plan the path to a grasp from a waypoint before it, and the path back up with the object."""
    way = path_to(planner, q, grasp)
    closed = planner.jaws.at_width(grasp.width)[0]
    if way is None or not planner.clear(way[-1], closed, gap=NARROW, ignore=[name]):
        return None
    up = planner.line(way[-1], _over(grasp.X_WH, LIFT), closed, ignore=[name])
    return None if up is None else (way, up)


def _can_put(planner: ArmPlanner, q: Array, held: Held, share: float, place: PlaceAt) -> bool:
    """Return True if the hand can reach the release pose as well as the pose above it."""
    X_WH = _over(place.X_WO, DROP) @ held.X_HO.inverse()
    posture = _posture(planner, X_WH, q, held, share)
    return posture is not None and planner.arm.solve(_over(X_WH, ABOVE), posture) is not None


def _posture(planner: ArmPlanner, X_WH: Pose, q: Array, held: Held, share: float) -> Array | None:
    """Return a collision-free configuration in which the hand is at the given pose and holds an object.

    The result is None if there is no such configuration.
    """
    posture = planner.arm.solve_any(X_WH, q, planner.rng)
    return posture if posture is not None and planner.clear(posture, share, held, gap=NARROW) else None


def _over(pose: Pose, height: float) -> Pose:
    """Return a pose raised by ``height`` [m]."""
    return Pose.of(pose.p + np.array([0.0, 0.0, height]), pose.q)


def before(X_WH: Pose) -> Pose:
    """Return a hand pose that is moved back along its approach direction by :data:`STANDOFF`."""
    return Pose.of(X_WH.p - STANDOFF * X_WH.rotation[:, 2], X_WH.q)


def _corrected(worker: ExpertWorker, robot: str, plan: PutPlan) -> Path:
    """Replan the path down to a placement.

    This is necessary because the object may have slipped in the hand. If no such path is found, the planned path is cut
    off where the object reaches its release height. Otherwise, an object that slipped toward the fingertips would be
    pushed into its support.
    """
    planner, held = worker.planners[robot], worker.held[robot]
    worker.sync()
    release = _over(plan.place.X_WO, plan.drop)
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


def _plan_put(worker: ExpertWorker, robot: str, places: Iterable[PlaceAt], drops: tuple[float, ...]) -> PutPlan | None:
    """Return a plan for the first placement at which the arm can release the object and retreat.

    The lowest of the heights ``drops`` [m] at which the fingers have space to open is used, or the lowest one that the
    arm can reach. The result is None if there is no such placement.
    """
    for place in places:
        cramped: PutPlan | None = None
        for drop in drops:
            plan, fits = _release(worker, robot, place, drop)
            if plan is not None and fits:
                return plan
            cramped = cramped or plan
        if cramped is not None:
            return cramped
    return None


def _as_held(worker: ExpertWorker, name: str, places: list[PlaceAt]) -> list[PlaceAt]:
    """Return placements at which an object has its present orientation.

    An object that has turned in the hand may be out of reach in the orientations that were planned. It can still be
    dropped into something.
    """
    turned = worker.now.state.poses[name].q
    return [PlaceAt(Pose.of(place.X_WO.p, turned), place.cost) for place in places]


def _release(worker: ExpertWorker, robot: str, place: PlaceAt, drop: float) -> tuple[PutPlan | None, bool]:
    """Return a plan that releases the held object above a placement, and True if the fingers have space to open.

    The plan is None if the arm cannot reach the placement.
    """
    planner, q, name = worker.planners[robot], worker.q[robot], worker.held[robot].name
    reading = worker.now.robots[robot]
    held, share = Held(name, reading.X_WH.inverse() @ worker.now.state.poses[name]), reading.gripper
    width = float(np.interp(share, planner.jaws.share, planner.jaws.width))
    opened = planner.jaws.at_width(min(width + 2 * RELEASE, planner.jaws.opening))[0]
    release = _over(place.X_WO, drop)
    goal = release @ held.X_HO.inverse()
    worker.cell.pose(robot, planner.arm.home, share)
    if _clashes(planner, release, held):
        return None, False
    posture = _posture(planner, goal, q, held, share)
    rise = None if posture is None else planner.line(posture, _over(goal, ABOVE), share, held)
    way = None if rise is None else planner.way(q, rise[-1], share, held)
    if posture is None or rise is None or way is None:
        return None, False
    worker.cell.put(name, release)
    leave = planner.line(posture, before(goal), opened, ignore=[name])
    return PutPlan(place, way, rise[::-1], leave or rise, opened, drop), leave is not None
