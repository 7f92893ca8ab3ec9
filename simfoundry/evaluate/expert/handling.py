"""Pick and place skills with one hand."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from simfoundry.evaluate.expert.candidates import Grasp, PlaceAt, down, grasps
from simfoundry.evaluate.expert.motion import ArmPlanner, Held, Path
from simfoundry.evaluate.expert.worker import CAREFUL, ExpertWorker, FailedError, Script
from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.object_shapes import solid
from simfoundry.worlds.footing import center_of_mass

STANDOFF = 0.09
"""Distance before a grasp at which the hand stops to observe [m]."""

LIFT = 0.12
"""Lift height before an object is moved away [m]."""

ABOVE = 0.12
"""Height of the approach above a place [m], so that an object clears the rim of a cup."""

DROP = 0.006
"""Height above a place at which an object is released [m]."""

SQUEEZE = 0.04
"""Additional closing command beyond contact, as a share of the finger travel; a servo pulls harder for it."""

RELEASE = 0.012
"""Opening of each finger on release [m]."""

SPARE = 0.012
"""Clearance of the hand at a place chosen before grasping [m], because the object may slip a little."""

TRIES, CHECKED = 60, 6
"""Maximum number of collision-free grasps, and of places for each, tried with the arm."""


@dataclass(frozen=True, eq=False)
class PickPlan:
    """An executable grasp: paths to a stop before it, to it, and up from it."""

    grasp: Grasp
    to: Path
    down: Path
    up: Path


@dataclass(frozen=True, eq=False)
class PutPlan:
    """A reachable place: paths above it, down to it, and back."""

    place: PlaceAt
    to: Path
    down: Path
    back: Path
    open: float


def pick(worker: ExpertWorker, robot: str, name: str, places: list[PlaceAt] | None) -> Script:
    """Pick up an object so that it can be moved to one of ``places`` afterwards."""
    worker.sync()
    plan = plan_pick(worker, robot, name, places)
    if plan is None:
        raise FailedError(f"{robot} finds no grasp of {name}")
    worker.share[robot] = plan.grasp.open
    yield from worker.go(robot, plan.to)
    yield from worker.settle(robot)
    yield from worker.follow(robot, plan.down, CAREFUL)
    yield from worker.settle(robot)
    yield from worker.grip(robot, firmly(worker.planners[robot], plan.grasp.width))
    X_HO = worker.now.robots[robot].X_WH.inverse() @ worker.now.state.poses[name]
    worker.held[robot] = Held(name, X_HO)
    yield from worker.follow(robot, plan.up, CAREFUL)
    yield from worker.settle(robot)


def firmly(planner: ArmPlanner, width: float) -> float:
    """Gripper share to hold an object ``width`` [m] wide; closing with full force squashes light objects."""
    return min(1.0, planner.jaws.at_width(width)[0] + SQUEEZE)


def plan_pick(worker: ExpertWorker, robot: str, name: str, places: list[PlaceAt] | None) -> PickPlan | None:
    """Plan the first grasp that the arm can reach, lift and bring to a place; None if there is none."""
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
            plan = _reached(planner, q, grasp, name) if fitting is None or fitting else None
            if plan is None:
                continue
            if fitting is None or any(_can_put(planner, plan.up[-1], held, grasp, p) for p in fitting[:CHECKED]):
                worker.cell.put(name, state.poses[name])
                way = planner.way(q, plan.down[0], grasp.open)
                if way is not None:
                    return PickPlan(grasp, way, plan.down, plan.up)
            tried += 1
            if tried >= TRIES:
                break
    return None


def _hand_fits(planner: ArmPlanner, grasp: Grasp, name: str) -> bool:
    """Return whether the hand alone has space to approach and to close."""
    cell, robot = planner.cell, planner.name
    cell.pose(robot, planner.arm.home, grasp.open)
    if cell.hand_clash(robot, grasp.X_WH, gap=0.001):
        return False
    cell.pose(robot, planner.arm.home, planner.jaws.at_width(grasp.width)[0])
    return not cell.hand_clash(robot, grasp.X_WH, gap=0.001, ignore=name)


def _fitting(planner: ArmPlanner, grasp: Grasp, held: Held, places: list[PlaceAt], spare: float) -> list[PlaceAt]:
    """Places at which the hand alone, holding the object, has space."""
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


def _reached(planner: ArmPlanner, q: Array, grasp: Grasp, name: str) -> PickPlan | None:
    """Plan the path to a grasp from a pose just before it, and up again."""
    before = Pose.of(grasp.X_WH.p - STANDOFF * grasp.X_WH.rotation[:, 2], grasp.X_WH.q)
    start = planner.arm.solve_any(before, q, planner.rng)
    if start is None or not planner.clear(start, grasp.open):
        return None
    way = planner.line(start, grasp.X_WH, grasp.open, gap=0.001)
    if way is None:
        return None
    closed = planner.jaws.at_width(grasp.width)[0]
    if not planner.clear(way[-1], closed, gap=0.001, ignore=[name]):
        return None
    raised = Pose.of(grasp.X_WH.p + np.array([0.0, 0.0, LIFT]), grasp.X_WH.q)
    up = planner.line(way[-1], raised, closed, ignore=[name])
    return None if up is None else PickPlan(grasp, [], way, up)


def _can_put(planner: ArmPlanner, q: Array, held: Held, grasp: Grasp, place: PlaceAt) -> bool:
    """Return whether the hand can reach the release pose and the pose above it."""
    X_WH = _over(place.X_WO, DROP) @ held.X_HO.inverse()
    posture = planner.arm.solve_any(X_WH, q, planner.rng)
    if posture is None:
        return False
    closed = planner.jaws.at_width(grasp.width)[0]
    if not planner.clear(posture, closed, held, gap=0.001):
        return False
    return planner.arm.solve(_over(X_WH, ABOVE), posture) is not None


def _over(pose: Pose, height: float) -> Pose:
    return Pose.of(pose.p + np.array([0.0, 0.0, height]), pose.q)


def put(worker: ExpertWorker, robot: str, places: list[PlaceAt]) -> Script:
    """Place the held object at the first of ``places`` that can be reached."""
    held = worker.held[robot]
    worker.sync()
    plan = plan_put(worker, robot, places)
    if plan is None:
        raise FailedError(f"{robot} finds no place for {held.name}")
    yield from worker.go(robot, plan.to)
    yield from worker.settle(robot)
    yield from worker.follow(robot, corrected(worker, robot, plan), CAREFUL)
    yield from worker.settle(robot)
    del worker.held[robot]
    yield from worker.grip(robot, plan.open)
    yield from worker.follow(robot, plan.back, CAREFUL)
    yield from worker.wait(0.4)


def corrected(worker: ExpertWorker, robot: str, plan: PutPlan) -> Path:
    """Replan the path down to a place with the object's present pose in the hand, because it may have slipped."""
    planner, held = worker.planners[robot], worker.held[robot]
    worker.sync()
    goal = _over(plan.place.X_WO, DROP) @ held.X_HO.inverse()
    share = worker.now.robots[robot].gripper
    return planner.line(worker.q[robot], goal, share, held) or plan.down


def plan_put(worker: ExpertWorker, robot: str, places: Iterable[PlaceAt]) -> PutPlan | None:
    """Plan the first place to which the arm can bring the held object, release it and retreat; None if there is
    none.
    """
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
        if posture is None or not planner.clear(posture, share, held, gap=0.001):
            continue
        rise = planner.line(posture, _over(goal, ABOVE), share, held)
        if rise is None:
            continue
        way = planner.way(q, rise[-1], share, held)
        if way is None:
            continue
        worker.cell.put(held.name, place.X_WO)
        back = Pose.of(goal.p - STANDOFF * goal.rotation[:, 2], goal.q)
        leave = planner.line(posture, back, opened, ignore=[held.name]) or rise[::1]
        return PutPlan(place, way, rise[::-1], leave, opened)
    return None
