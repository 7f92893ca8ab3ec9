"""The skill of moving an object with two hands, which hold it at its ends and move in step."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice, pairwise, product

import numpy as np

from simfoundry.evaluate.expert.candidates import PlaceAt, grasps
from simfoundry.evaluate.expert.motion import LEAP, LINE, TURN, ArmPlanner, Held, Path, blend
from simfoundry.evaluate.expert.skills import DROP, GraspPlan, before, hand_fits, path_to, seize
from simfoundry.evaluate.expert.worker import CAREFUL, ExpertWorker, FailedError, Script, paced
from simfoundry.geometry.frames import Array, Pose
from simfoundry.scene.object_shapes import solid

# Tilt angles of the hands [rad], and angles about the vertical between them and the direction to the placement [rad].
# Steep hands reach neither high nor far: two arms of 0.6 m carry a pot to a stove only with hands tilted by 50 degrees.
TILTS, SIDEWAYS = (0.75, 0.9, 1.05), (0.0, 0.4, -0.4)

# Heights [m] by which the object is lifted; the first feasible one is used. Short arms do not reach high far away.
LIFTS = (0.1, 0.07, 0.05, 0.03)

# Distance [m] of corners from the outermost ones up to which they belong to the end of an object.
END = 0.015

# Maximum number of placements to try, and of grasps of each hand that can move the object to one of them.
PLACES, KEPT = 8, 5

# Distance from the top of its motion [m] within which an object must be free of contacts.
NEAR = 0.02


@dataclass(frozen=True, eq=False)
class _Carrying:
    """A grasp of each hand, and the paths that move both hands along with the object."""

    grasps: Mapping[str, GraspPlan]
    along: Mapping[str, Path]


def carry(worker: ExpertWorker, robots: Sequence[str], name: str, places: list[PlaceAt]) -> Script:
    """Pick up an object with two hands and place it at the first pose in ``places`` that both arms can reach."""
    worker.sync()
    plan = _plan(worker, robots, name, places)
    if plan is None:
        raise FailedError(f"{' and '.join(robots)} could not find a way to carry {name}")
    for robot in robots:
        worker.sync()
        planner, to = worker.planners[robot], plan.grasps[robot]
        way = planner.way(worker.q[robot], to.down[0], to.grasp.open)
        if way is None:
            raise FailedError(f"{robot} could not reach {name} beside the other arm")
        yield from seize(worker, robot, to._replace(to=way))
    for robot in robots:
        X_HO = worker.now.robots[robot].X_WH.inverse() @ worker.now.state.poses[name]
        worker.held[robot] = Held(name, X_HO)
    yield from _in_step(worker, plan.along)
    for robot in robots:
        worker.held.pop(robot)
    for robot in robots:
        yield from worker.grip(robot, plan.grasps[robot].grasp.open)
    for robot in robots:
        planner, q = worker.planners[robot], worker.q[robot]
        back = planner.line(q, before(planner.arm.hand(q)), worker.share[robot], ignore=[name])
        if back is not None:
            yield from worker.follow(robot, back, CAREFUL)
    yield from worker.wait(0.4)


def _in_step(worker: ExpertWorker, along: Mapping[str, Path]) -> Script:
    """Move the hands along paths of equal length, so that they hold still relative to each other."""
    robots = list(along)
    sizes = np.cumsum([len(along[robot][0]) for robot in robots])[:-1]
    joined = [np.concatenate(each) for each in zip(*(along[robot] for robot in robots), strict=True)]
    first, size = worker.arms[robots[0]], len(along[robots[0]][0])
    for row in paced(joined, lambda q: first.hand(q[:size]), worker.hz, CAREFUL):
        for robot, q in zip(robots, np.split(row, sizes), strict=True):
            worker.q[robot] = q
        yield
        for robot in robots:
            worker.check(robot)
    for robot in robots:
        yield from worker.settle(robot)


def _plan(worker: ExpertWorker, robots: Sequence[str], name: str, places: list[PlaceAt]) -> _Carrying | None:
    """Return a plan for the first placement that both arms can reach with some of their grasps."""
    X_WO, ends = worker.now.state.poses[name], _ends(worker, robots, name)
    found = {robot: list(_reachable(worker, robot, name, ends[robot], places)) for robot in robots}
    for place, lift in product(places[:PLACES], LIFTS):
        poses = list(motion_over(X_WO, place.X_WO, lift))
        able = {r: list(islice(_able(worker.planners[r], found[r], X_WO, poses), KEPT)) for r in robots}
        for pair in product(*(able[robot] for robot in robots)):
            along = {robot: path for robot, (_, path) in zip(robots, pair, strict=True)}
            plan = {robot: grasp for robot, (grasp, _) in zip(robots, pair, strict=True)}
            if _is_clear(worker, name, poses, plan, along):
                return _Carrying(plan, along)
        worker.sync()
    return None


def _ends(worker: ExpertWorker, robots: Sequence[str], name: str) -> dict[str, Array]:
    """Return the end of an object that each hand holds [m]: the one on its side along the longest horizontal axis."""
    corners = solid(worker.scene.object(name), worker.now.state).corners
    axis = np.append(np.linalg.eigh(np.cov(corners[:, :2].T))[1][:, -1], 0.0)
    along = corners @ axis
    low, high = (corners[np.abs(along - end) < END].mean(axis=0) for end in (along.min(), along.max()))
    ordered = sorted(robots, key=lambda robot: float(worker.arms[robot].robot.X_WB.p @ axis))
    return dict(zip(ordered, (low, high), strict=True))


def _reachable(worker: ExpertWorker, robot: str, name: str, end: Array, places: list[PlaceAt]) -> Iterator[GraspPlan]:
    """Yield grasps of an end of an object with the path to each, if the hand is able to reach one of the placements."""
    planner, q, X_WO = worker.planners[robot], worker.q[robot], worker.now.state.poses[name]
    shape = solid(worker.scene.object(name), worker.now.state)
    forward = (places[0].X_WO.p - planner.arm.robot.X_WB.p)[:2]
    found = grasps(shape, end, planner.jaws, _approaches(forward), planner.arm.hand(planner.arm.home))
    for grasp in found:
        X_OH, closed = X_WO.inverse() @ grasp.X_WH, planner.jaws.at_width(grasp.width)[0]
        if all(planner.arm.is_too_short(_at(p.X_WO, float(p.X_WO.p[2]) + LIFTS[-1]) @ X_OH) for p in places[:PLACES]):
            continue
        if hand_fits(planner, grasp, grasp.open) and hand_fits(planner, grasp, closed, ignore=name):
            to = path_to(planner, q, grasp)
            if to is not None:
                yield GraspPlan(grasp, [], to, [], [])


def _approaches(forward: Array) -> list[Array]:
    """Return directions in which a hand approaches, tilted forward from the vertical, each of shape (3,)."""
    yaw = math.atan2(forward[1], forward[0])
    angles = [(tilt, yaw + side) for tilt in TILTS for side in SIDEWAYS]
    return [np.array([math.sin(t) * math.cos(a), math.sin(t) * math.sin(a), -math.cos(t)]) for t, a in angles]


def motion_over(start: Pose, goal: Pose, lift: float) -> Iterator[Pose]:
    """Yield the poses of an object that is lifted, moved above its placement and lowered."""
    yield start
    top = max(float(start.p[2]), float(goal.p[2])) + lift
    corners = [start, _at(start, top), _at(goal, top), _at(goal, float(goal.p[2]) + DROP)]
    for a, b in pairwise(corners):
        count = max(1, int(np.ceil(max(float(np.linalg.norm(b.p - a.p)) / LINE, a.angle_to(b) / TURN))))
        yield from (blend(a, b, k / count) for k in range(1, count + 1))


def _at(pose: Pose, height: float) -> Pose:
    """Return a pose moved vertically to ``height`` [m]."""
    return Pose.of([*pose.p[:2], height], pose.q)


def _able(
    planner: ArmPlanner, found: list[GraspPlan], X_WO: Pose, poses: list[Pose]
) -> Iterator[tuple[GraspPlan, Path]]:
    """Yield the grasps with which the arm can follow an object, with the configurations at the grasp and each pose."""
    for plan in found:
        X_OH = X_WO.inverse() @ plan.grasp.X_WH
        hands = [X_WO @ X_OH for X_WO in poses]
        if any(planner.arm.is_too_short(X_WH) for X_WH in hands):
            continue
        path = [plan.down[-1]]
        for X_WH in hands[1:]:
            q = planner.arm.solve(X_WH, path[-1])
            if q is None or np.abs(q - path[-1]).max() > LEAP:
                break
            path.append(q)
        else:
            yield plan, path


def _is_clear(
    worker: ExpertWorker, name: str, poses: list[Pose], plan: Mapping[str, GraspPlan], along: Mapping[str, Path]
) -> bool:
    """Return True if neither the arms nor the object between them touch anything else or each other."""
    cell, top = worker.cell, max(float(X_WO.p[2]) for X_WO in poses)
    for k, X_WO in enumerate(poses):
        for robot, path in along.items():
            planner = worker.planners[robot]
            cell.pose(robot, path[k], planner.jaws.at_width(plan[robot].grasp.width)[0])
        cell.put(name, X_WO)
        if any(cell.clash([robot], ignore=[name]) is not None for robot in along):
            return False
        # On the way up and down, the object may still be touching its support.
        if float(X_WO.p[2]) > top - NEAR and cell.clash([name], ignore=along) is not None:
            return False
    return True
