"""Transforms of a recorded motion to other poses, sizes and rotations of the objects that it refers to.

A motion of the hand is moved with its reference. While the hand holds an object, the object follows the recorded path
relative to the reference, wherever the hand grasped it. Objects of other sizes scale the place at which they are
touched. Rotations that an object's symmetry allows, and a hand that is turned by half a turn, give further candidates.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from simfoundry.augment.segments import HandMotion, SourceSegment
from simfoundry.augment.subgoals import Subgoal, reference_pose
from simfoundry.augment.symmetry import DIRECTIONS, symmetry_order
from simfoundry.geometry.frames import IDENTITY, Array, Pose
from simfoundry.robots.arm import jaws
from simfoundry.scene.model import Scene
from simfoundry.scene.object_shapes import bounds
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.predicate import Effect

# Number of rotations of a round object to try: every 30 degrees; wrists turn farther than half of that easily.
ROUND_TRIED = 12

# Maximum number of transforms of one segment to try. Those that turn the hand least come first.
MOST = 8

# Additional cost of a hand that is turned by half a turn [rad], so that it is tried after small rotations.
FLIP_COST = 0.5

UP = np.array([0.0, 0.0, 1.0])

# A hand whose fingers close along y is the same after half a turn about its approach direction.
FLIP = Pose.about(UP, math.pi)

# Relative difference of sizes below which objects count as equally large; meshes of one object differ by rounding only.
SAME_SIZE = 1e-3


@dataclass(frozen=True, eq=False)
class FrameChange:
    """A transform of hand poses: ``X_WH`` becomes ``left @ X_WH @ right``."""

    left: Pose
    right: Pose = IDENTITY

    def apply(self, X_WH: Pose) -> Pose:
        """Return the transformed pose of a hand."""
        return self.left @ X_WH @ self.right


@dataclass(frozen=True, eq=False)
class Adaptation:
    """The transforms of a segment for each robot. Those that turn the hands less have a lower ``cost`` [rad]."""

    changes: Mapping[str, FrameChange]
    cost: float


class ObjectFacts:
    """The boxes and symmetries of the objects in a scene, which are measured when they are first needed."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._boxes: dict[str, tuple[Array, Array]] = {}
        self._orders: dict[str, int] = {}

    def box(self, name: str) -> tuple[Array, Array]:
        """Return the center and the size of an object's bounding box in its frame [m], shape (3,) each."""
        if name not in self._boxes:
            low, high = bounds(self.scene.object(name))
            self._boxes[name] = (low + high) / 2, high - low
        return self._boxes[name]

    def rotations(self, reference: str) -> list[float]:
        """Return the angles by which a reference can be rotated about its vertical axis [rad]."""
        if "." in reference or not reference:
            return [0.0]
        if reference not in self._orders:
            self._orders[reference] = symmetry_order(self.scene.object(reference))
        order = self._orders[reference]
        count = ROUND_TRIED if order == DIRECTIONS else order
        return [2 * math.pi * k / count for k in range(count)]


def adaptations(
    segment: SourceSegment,
    target: Subgoal,
    state: SceneState,
    facts: ObjectFacts,
    source: ObjectFacts,
    hands: Mapping[str, Pose],
) -> list[Adaptation]:
    """Return transforms of a segment to a state, in the order in which they should be tried.

    Args:
        segment: The segment.
        target: The sub-goal to achieve in the state, whose objects may be others.
        state: The state when the lead-in of the segment begins.
        facts: The objects in the scene of the state.
        source: The objects in the scene of the segment.
        hands: The poses of the hands in the state.
    """
    found = list(_candidates(segment, target, state, facts, source, hands))
    return sorted(found, key=lambda one: one.cost)[:MOST]


def _candidates(
    segment: SourceSegment, target: Subgoal, state: SceneState, facts: ObjectFacts, source: ObjectFacts,
    hands: Mapping[str, Pose],
) -> Iterator[Adaptation]:  # fmt: skip
    X_WR = reference_pose(facts.scene, state, target.reference)
    robots = segment.robots
    middle = segment.moment - segment.begin - 1
    flips = (IDENTITY, FLIP) if len(robots) == 1 and _can_flip(facts.scene, segment, robots[0]) else (IDENTITY,)
    carried = target.held if segment.X_WO is not None and _effect(target) is Effect.PLACE else ""
    turns = facts.rotations(carried) if carried and len(robots) == 1 else [0.0]
    for angle in facts.rotations(target.reference):
        left = _left(segment, target, X_WR, angle, facts, source)
        for turn in turns:
            for flip in flips if not carried else (IDENTITY,):
                changes = {}
                for name, motion in segment.motions.items():
                    right = (
                        _right(motion, target, state, facts, source, segment, hands[name], turn) if carried else flip
                    )
                    changes[name] = FrameChange(left, right)
                costs = [
                    _turned(facts.scene, name, motion.targets[middle], changes[name], X_WR, segment, flip)
                    for name, motion in segment.motions.items()
                ]
                yield Adaptation(changes, max(costs))


def _effect(subgoal: Subgoal) -> Effect:
    return subgoal.call.declaration.effect


def _can_flip(scene: Scene, segment: SourceSegment, robot: str) -> bool:
    """Return True if a hand grasps something in a segment, and its fingers are the same after half a turn."""
    return segment.subgoal.lasts and not segment.is_joined and jaws(scene.robot(robot)) is not None


def _left(
    segment: SourceSegment, target: Subgoal, X_WR: Pose, angle: float, facts: ObjectFacts, source: ObjectFacts
) -> Pose:
    """Return the transform from the recorded world to the present one, in which the reference is turned by an angle."""
    name = segment.subgoal.reference
    if not name or "." in name or "." in target.reference or not target.reference:
        return X_WR @ segment.X_WR.inverse()
    (center, size), (other, other_size) = source.box(name), facts.box(target.reference)
    shift = np.zeros(3)
    ratio = other_size / np.maximum(size, 1e-9)
    if np.abs(ratio - 1).max() > SAME_SIZE:
        shift = (ratio - 1) * (segment.X_WR.inverse().apply(_touched(segment, source)) - center)
    X_RS = Pose.of(other) @ Pose.about(UP, angle) @ Pose.of(shift - center)
    return X_WR @ X_RS @ segment.X_WR.inverse()


def _touched(segment: SourceSegment, source: ObjectFacts) -> Array:
    """Return the point at which a segment touches its reference [m]: the base of the held object, or the fingertips."""
    motions = segment.motions
    found = []
    for name, motion in motions.items():
        X_WH = motion.targets[segment.moment - segment.begin - 1]
        if motion.X_HO is not None:
            found.append((X_WH @ motion.X_HO).apply(_base(source, segment.subgoal.held)))
        else:
            fingers = jaws(segment.scene.robot(name))
            depth = 0.0 if fingers is None else float(fingers.low[-1] + fingers.tip[-1]) / 2
            found.append(X_WH.apply(np.array([0.0, 0.0, depth])))
    return np.asarray(np.mean(found, axis=0))


def _base(facts: ObjectFacts, name: str) -> Array:
    """Return the center of the lower side of an object's box in its frame [m]."""
    center, size = facts.box(name)
    return np.asarray(center - [0.0, 0.0, size[2] / 2])


def _right(
    motion: HandMotion, target: Subgoal, state: SceneState, facts: ObjectFacts, source: ObjectFacts,
    segment: SourceSegment, X_WH: Pose, turn: float,
) -> Pose:  # fmt: skip
    """Return the transform with which the held object follows its recorded path, turned about its axis by an angle."""
    assert motion.X_HO is not None
    X_HO = X_WH.inverse() @ state.poses[target.held]
    X_OB, X_OC = Pose.of(_base(source, segment.subgoal.held)), Pose.of(_base(facts, target.held))
    return motion.X_HO @ X_OB @ Pose.about(UP, turn) @ X_OC.inverse() @ X_HO.inverse()


def _turned(
    scene: Scene, robot: str, X_WH: Pose, change: FrameChange, X_WR: Pose, segment: SourceSegment, flip: Pose
) -> float:
    """Return the angle by which a transform turns a hand, beyond the turn of the arm toward the reference [rad]."""
    base = scene.robot(robot).X_WB.p
    bearings = [math.atan2(*(pose.p - base)[1::-1]) for pose in (X_WR, segment.X_WR)]
    turned = Pose.about(UP, bearings[0] - bearings[1]) @ Pose.of(q=X_WH.q)
    new = change.apply(X_WH)
    if flip is FLIP:
        return FLIP_COST + (new @ FLIP).angle_to(turned)
    return new.angle_to(turned)
