"""Joint targets of an adapted segment: the way to its start, and the segment itself, both checked for collisions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from simfoundry.augment.options import Bridge
from simfoundry.augment.segments import HandMotion, SourceSegment
from simfoundry.augment.subgoals import Subgoal
from simfoundry.augment.transform import Adaptation, FrameChange
from simfoundry.evaluate.expert.motion import LEAP, ArmPlanner, Held, blend
from simfoundry.evaluate.expert.worker import AROUND, HAND, JOINT, paced
from simfoundry.geometry.frames import Array, Pose
from simfoundry.robots.arm import Arm
from simfoundry.spec.models.predicate import Effect

# Depth [m] to which joint targets may overlap other objects: targets of a closed gripper, or of a hand that presses on
# something, are inside of what they touch.
OVERLAP = 0.004

# Number of actions between two checks for collisions; a hand moves by about 1 cm in this time.
EVERY = 3

# Time for which the hand waits at the start of a segment until the arm has arrived [s]; servos lag by about 0.1 s.
SETTLE_S = 0.3

# Number of joints of an arm below which it cannot reach every pose of the hand, and distance [m] from the pose up to
# which its closest configuration counts as reached.
FULL, CLOSE = 6, 0.02

# Number of postures of an arm to start a segment from, and the range of random ones around the home posture [rad].
POSTURES, SPREAD = 4, 0.8

# Deviation from the recorded motion of the hand up to which it counts as followed [m, rad].
NEAR, TURNED = 0.002, 0.02

# Motion of a hand in one action below which it stands still [m].
STILL = 0.001

# Largest change of a joint target in one action of a segment [rad or m] beyond which the inverse kinematics has jumped;
# the same as for the planner's lines.
JUMP = LEAP


class Obstacle(StrEnum):
    """A reason why a segment cannot be carried out."""

    UNREACHABLE = "unreachable"
    """The arm cannot follow the motion of the hand."""
    COLLISION = "collision"
    """The arm would hit something."""
    NO_PATH = "no path"
    """No path to the start of the segment was found."""


class ObstacleError(Exception):
    """An error raised if a segment cannot be carried out, because of an object ``what`` in the way or without one."""

    def __init__(self, kind: Obstacle, what: str = "") -> None:
        super().__init__(f"{kind} with `{what}`" if what else str(kind))
        self.kind = kind


@dataclass(frozen=True, eq=False)
class ArmTargets:
    """The commands to one robot. K is the number of actions.

    Attributes:
        joints: The joint targets [rad or m], shape (K, n).
        grippers: The gripper commands, shape (K,).
    """

    joints: Array
    grippers: Array


@dataclass(frozen=True, eq=False)
class SegmentPlan:
    """The commands of a segment, keyed by robot: on the way to its start, and in the segment itself."""

    bridges: Mapping[str, ArmTargets]
    targets: Mapping[str, ArmTargets]


@dataclass(frozen=True, eq=False)
class Present:
    """The situation in which a segment is planned.

    Attributes:
        planners: The planners of the arms, whose planning scene shows the present state.
        q: The present joint targets of each robot [rad or m].
        grippers: The present positions of the grippers, from 0 (open) to 1 (closed).
        commands: The present gripper commands.
        held: The object in each hand.
        previous: The transform of the previous segment of each robot.
        hz: The number of actions per second [Hz].
    """

    planners: Mapping[str, ArmPlanner]
    q: Mapping[str, Array]
    grippers: Mapping[str, float]
    commands: Mapping[str, float]
    held: Mapping[str, Held]
    previous: Mapping[str, FrameChange]
    hz: float


def plan_segment(
    segment: SourceSegment, adaptation: Adaptation, target: Subgoal, now: Present, bridge: Bridge
) -> SegmentPlan:
    """Return the commands that carry out a segment with the given transforms.

    Raises:
        ObstacleError: If the arms cannot follow it.
    """
    if len(segment.robots) > 1 and target.held:
        return _carried_together(segment, adaptation, now)
    bridges, targets = {}, {}
    for name, motion in segment.motions.items():
        change = adaptation.changes[name]
        poses = transformed(segment, name, change)
        if segment.is_joined or bridge is Bridge.WARPED:
            lead, poses = _warped(segment, motion, poses, now, name, change)
            bridges[name], targets[name] = _commands(segment, now, name, lead, poses)
        else:
            targets[name] = _checked(segment, target, now, name, poses)
            bridges[name] = _planned(now, name, targets[name].joints[0], float(targets[name].grippers[0]))
    return SegmentPlan(bridges, targets)


def _commands(
    segment: SourceSegment, now: Present, robot: str, lead: Sequence[Pose], poses: Sequence[Pose]
) -> tuple[ArmTargets, ArmTargets]:
    """Return the commands that move a hand along the poses of a lead-in and of a segment proper."""
    joints, count = _followed(now.planners[robot].arm, [*lead, *poses], now.q[robot]), len(lead)
    grippers = _grippers(segment, now, robot)
    return ArmTargets(joints[:count], np.full(count, grippers[0])), ArmTargets(joints[count:], grippers)


def _carried_together(segment: SourceSegment, adaptation: Adaptation, now: Present) -> SegmentPlan:
    """Return the commands of hands that hold the same object, whose poses relative to each other must not change.

    The first hand follows the bent lead-in, and the others keep their poses relative to it.
    """
    first, *others = segment.robots
    goals = {name: transformed(segment, name, adaptation.changes[name]) for name in segment.robots}
    leads = {}
    leads[first], goals[first] = _warped(
        segment, segment.motions[first], goals[first], now, first, adaptation.changes[first]
    )
    hands = {name: now.planners[name].arm.hand(now.q[name]) for name in segment.robots}
    bent = max(0, segment.moment - segment.begin) if segment.lead == 0 else 0
    for name in others:
        before = hands[first].inverse() @ hands[name]
        leads[name] = _beside(leads[first], before, goals[first][0].inverse() @ goals[name][0])
        if bent:  # without a lead-in, the part up to the sub-goal is bent
            after = goals[first][bent - 1].inverse() @ goals[name][bent - 1]
            goals[name][:bent] = _beside(goals[first][:bent], before, after)
    found = {name: _commands(segment, now, name, leads[name], goals[name]) for name in segment.robots}
    return SegmentPlan({name: one[0] for name, one in found.items()}, {name: one[1] for name, one in found.items()})


def _beside(poses: Sequence[Pose], before: Pose, after: Pose) -> list[Pose]:
    """Return the poses of a hand beside another one, whose relative pose changes from ``before`` to ``after``."""
    return [pose @ blend(before, after, _smooth((k + 1) / len(poses))) for k, pose in enumerate(poses)]


def transformed(segment: SourceSegment, robot: str, change: FrameChange) -> list[Pose]:
    """Return the transformed poses of a hand from the start of the segment proper.

    Once the hand has released the object that it placed, it retreats as in the demonstration, relative to itself.
    """
    motion = segment.motions[robot]
    poses = [change.apply(pose) for pose in motion.targets]
    opening = segment.opening(robot) if segment.subgoal.call.declaration.effect is Effect.PLACE else None
    if opening is not None:
        back = poses[opening - 1] @ motion.targets[opening - 1].inverse()
        poses[opening:] = [back @ pose for pose in motion.targets[opening:]]
    return poses[segment.lead :]


def last_shift(segment: SourceSegment, robot: str, change: FrameChange) -> Array:
    """Return the last motion of a transformed hand that did not stand still [m per action], shape (3,)."""
    points = np.array([pose.p for pose in transformed(segment, robot, change)])
    shifts = np.diff(points, axis=0)
    moving = np.flatnonzero(np.linalg.norm(shifts, axis=1) > STILL)
    return np.asarray(shifts[moving[-1]]) if len(moving) else np.zeros(3)


def _warped(
    segment: SourceSegment, motion: HandMotion, poses: list[Pose], now: Present, robot: str, change: FrameChange
) -> tuple[list[Pose], list[Pose]]:
    """Return the lead-in bent to start at the present pose, and the segment.

    If the segment is joined to the one before it, there is no lead-in, and the part up to the sub-goal is bent.
    """
    present = now.planners[robot].arm.hand(now.q[robot])
    before = now.previous.get(robot, FrameChange(Pose.of()))
    start = before.apply(motion.start) if segment.is_joined else motion.start
    turn, shift = Pose.of(q=present.q) @ Pose.of(q=start.q).inverse(), present.p - start.p

    def kept(pose: Pose) -> Pose:
        """Return where the hand would be if nothing but its start had changed."""
        moved = before.apply(pose) if segment.is_joined else pose
        return Pose.of(moved.p + shift, (turn @ Pose.of(q=moved.q)).q)

    if segment.lead == 0:
        length = max(1, segment.moment - segment.begin)
        bent = [
            blend(kept(motion.targets[k]), pose, _smooth((k + 1) / length)) for k, pose in enumerate(poses[:length])
        ]
        return [], [*bent, *poses[length:]]
    way = float(np.linalg.norm(motion.targets[segment.lead - 1].p - motion.start.p))
    distance = float(np.linalg.norm(poses[0].p - present.p))
    count = math.ceil(segment.lead * min(3.0, max(1.0, distance / max(way, 0.05))))
    lead = []
    for k in range(1, count + 1):
        pose = motion.targets[min(segment.lead - 1, k * segment.lead // count)]
        lead.append(blend(kept(pose), change.apply(pose), _smooth(k / count)))
    return lead, poses


def _smooth(share: float) -> float:
    """Return a smooth step from 0 to 1 whose slope is 0 at both ends."""
    share = min(1.0, share)
    return share * share * (3 - 2 * share)


def _followed(arm: Arm, poses: Sequence[Pose], near: Array) -> Array:
    """Return joint targets that move the hand along poses, shape (K, n).

    Raises:
        ObstacleError: If the arm cannot follow them.
    """
    rows: list[Array] = []
    for pose in poses:
        q, is_reached = arm.approach(pose, rows[-1] if rows else near, NEAR, TURNED)
        if not is_reached and len(arm.joints) < FULL:
            is_reached = float(np.linalg.norm(arm.hand(q).p - pose.p)) < CLOSE
        if not is_reached or (rows and np.abs(q - rows[-1]).max() > JUMP):
            raise ObstacleError(Obstacle.UNREACHABLE)
        rows.append(q)
    return np.array(rows).reshape(len(rows), len(near))


def _followed_from_any(planner: ArmPlanner, poses: Sequence[Pose], recorded: Array) -> Array:
    """Return joint targets that move the hand along poses, starting from any posture of the arm, shape (K, n).

    The posture of the demonstration comes first. If the arm cannot follow the motion from there, because a joint
    reaches its limit, other postures are tried.
    """
    for attempt in range(POSTURES):
        near = recorded if attempt == 0 else planner.arm.home
        if attempt > 1:
            near = np.clip(near + planner.rng.uniform(-SPREAD, SPREAD, len(near)), planner.arm.low, planner.arm.high)
        try:
            return _followed(planner.arm, poses, near)
        except ObstacleError:
            if attempt == POSTURES - 1:
                raise
    raise ObstacleError(Obstacle.UNREACHABLE)


def _grippers(segment: SourceSegment, now: Present, robot: str) -> Array:
    """Return the gripper commands of a segment proper.

    A hand that holds an object keeps its own command until the recorded one changes, because the demonstration may have
    held the object at a place of another width.
    """
    recorded = segment.motions[robot].grippers[segment.lead :]
    if robot not in now.held:
        return recorded
    return np.asarray(np.clip(now.commands[robot] + recorded - recorded[0], 0.0, 1.0))


def _checked(segment: SourceSegment, target: Subgoal, now: Present, robot: str, poses: Sequence[Pose]) -> ArmTargets:
    """Return the commands of a segment proper, if they are free of collisions except with what it is about."""
    planner, motion = now.planners[robot], segment.motions[robot]
    grippers = _grippers(segment, now, robot)
    joints = _followed_from_any(planner, poses, motion.joints)
    held, opening = now.held.get(robot), segment.opening(robot)
    about = {name.partition(".")[0] for name in (target.reference, target.held) if name}
    ignored = about | {name for name in segment.motions if name != robot}
    for k in range(0, len(joints), EVERY):
        is_holding = held is not None and (opening is None or k < opening - segment.lead)
        what = _obstacle(planner, joints[k], float(grippers[k]), held if is_holding else None, ignored)
        if what is not None:
            raise ObstacleError(Obstacle.COLLISION, what)
    return ArmTargets(joints, grippers)


def _obstacle(planner: ArmPlanner, q: Array, share: float, held: Held | None, ignored: set[str]) -> str | None:
    """Return what an arm, or the object in its hand, would hit at joint targets, or None."""
    cell, moving = planner.cell, [planner.name]
    cell.pose(planner.name, q, share)
    if held is not None:
        cell.put(held.name, planner.arm.hand(q) @ held.X_HO)
        moving.append(held.name)
    return cell.clash(moving, -OVERLAP, ignored)


def _planned(now: Present, robot: str, goal: Array, share: float) -> ArmTargets:
    """Return a path around obstacles to the start of a segment, and wait there until the arm has arrived."""
    planner, q, held = now.planners[robot], now.q[robot], now.held.get(robot)
    path = planner.way(q, goal, now.grippers[robot] if held else share, held)
    if path is None:
        raise ObstacleError(Obstacle.NO_PATH)
    speed = 1.0 if len(path) <= 2 else AROUND
    rows = paced(path, planner.arm.hand, now.hz, speed * HAND, speed * JOINT)
    rows += [rows[-1]] * math.ceil(SETTLE_S * now.hz)
    return ArmTargets(np.array(rows), np.full(len(rows), share))


def corrected(segment: SourceSegment, adaptation: Adaptation, target: Subgoal, now: Present, robot: str) -> ArmTargets:
    """Return the commands of a segment proper with transforms that changed since it was planned.

    The hand first moves to the changed start.

    Raises:
        ObstacleError: If the arm cannot follow it.
    """
    targets = _checked(segment, target, now, robot, transformed(segment, robot, adaptation.changes[robot]))
    count = math.ceil(SETTLE_S * now.hz)
    shares = np.arange(1, count + 1)[:, None] / count
    lead = now.q[robot] + shares * (targets.joints[0] - now.q[robot])
    grippers = np.concatenate([np.full(count, targets.grippers[0]), targets.grippers])
    return ArmTargets(np.concatenate([lead, targets.joints]), grippers)


def in_step(plans: Mapping[str, ArmTargets]) -> list[dict[str, tuple[Array, float]]]:
    """Return the commands of several robots action by action; those that are done first hold their last ones."""
    length = max((len(one.joints) for one in plans.values()), default=0)
    found: list[dict[str, tuple[Array, float]]] = []
    for k in range(length):
        rows = {name: (one, min(k, len(one.joints) - 1)) for name, one in plans.items() if len(one.joints)}
        found.append({name: (one.joints[j], float(one.grippers[j])) for name, (one, j) in rows.items()})
    return found
