"""Plans in which closed fingers push the edge of a hinged link, such as a lid."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from simfoundry.evaluate.expert.candidates import Grasp
from simfoundry.evaluate.expert.joints import DrivenJoint
from simfoundry.evaluate.expert.motion import ArmPlanner, Path
from simfoundry.evaluate.expert.skills import GraspPlan, before, path_to
from simfoundry.geometry.frames import Array, Pose, quat_from_matrix
from simfoundry.scene.model import JointType
from simfoundry.scene.object_shapes import solid

# Step between hand poses along the motion of the link [rad].
STEP = 0.06

# Distance [m] of corners from the outermost ones of a link up to which they belong to its edge, and distance [m] of the
# fingertips from the edge, toward the hinge: about the 5 mm by which an arm misses its targets in motion.
EDGE, INSET = 0.01, 0.005

# Distances [m] between the fingertips and the link that they push, the first free one of which is used. Fingers that
# come past the edge at a steep angle are free only if their tips are far behind it.
BEHIND = (0.012, 0.02, 0.03, 0.045)

# Half of the thickness of closed fingers [m]: at this distance of the tips, they touch the link.
THICKNESS = 0.006

# Number of directions in the plane of the motion from which a link is pushed.
SIDES = 16

# Maximum upward component of a direction in which a hand approaches: a hand that points up needs space below it.
RISING = 0.1


@dataclass(frozen=True, eq=False)
class PushedEdge:
    """The edge of a hinged link.

    Attributes:
        p: The middle of the edge in the world [m], shape (3,).
        out: The direction from the hinge to the edge.
        ahead: The direction in which the edge moves.
        axis: The direction of the hinge.
        reach: The distance of the edge from the hinge [m].
        back: The distance from the middle to the surface that is pushed [m].
    """

    p: Array
    out: Array
    ahead: Array
    axis: Array
    reach: float
    back: float

    @classmethod
    def of(cls, joint: DrivenJoint, goal: float) -> PushedEdge:
        """Return the edge that is pushed when a joint moves to ``goal`` [rad]."""
        corners = solid(joint.item, joint.state, [joint.joint.child]).corners
        p_WJ, axis = joint.axis
        arms = corners - p_WJ
        arms = arms - np.outer(arms @ axis, axis)
        radii = np.linalg.norm(arms, axis=1)
        edge = radii > radii.max() - EDGE
        p = corners[edge].mean(axis=0)
        out = arms[edge].mean(axis=0) / np.linalg.norm(arms[edge].mean(axis=0))
        ahead = np.cross(axis, out) * math.copysign(1.0, goal - joint.now)
        return cls(p, out, ahead, axis, float(radii.max()), float((p @ ahead) - (corners[edge] @ ahead).min()))

    def hands(self, tip: float, behind: float) -> Iterator[Pose]:
        """Yield poses of hands whose fingertips are behind the edge.

        Args:
            tip: The distance of the fingertips from the origin of a hand [m].
            behind: The distance of the fingertips from the surface [m].
        """
        at = self.p - INSET * self.out - (self.back + behind) * self.ahead
        for angle in np.arange(SIDES) * 2 * math.pi / SIDES:
            approach = math.cos(angle) * self.out + math.sin(angle) * self.ahead
            if approach[2] > RISING:
                continue
            for closing in (self.axis, -self.axis, np.cross(approach, self.axis), np.cross(self.axis, approach)):
                R_WH = np.column_stack([np.cross(closing, approach), closing, approach])
                yield Pose.of(at - tip * approach, quat_from_matrix(R_WH))


def pushes(planner: ArmPlanner, q: Array, joint: DrivenJoint, goal: float) -> Iterator[GraspPlan]:
    """Yield plans in which closed fingers push the edge of a hinged link until the joint is at ``goal`` [rad].

    Unlike a hand that holds a handle, a hand that pushes does not turn with the link, along whose edge the fingers
    slide. An arm can therefore turn a lid by more than its wrist can turn.
    """
    if joint.joint.type is JointType.PRISMATIC:
        return
    edge, home = PushedEdge.of(joint, goal), planner.arm.hand(planner.arm.home)
    tip = planner.jaws.at_width(0.0)[2]
    for behind in BEHIND:
        far = goal + math.copysign((behind - THICKNESS) / edge.reach, goal - joint.now)
        count = max(1, math.ceil(abs(far - joint.now) / STEP))
        positions = [joint.now + (far - joint.now) * k / count for k in range(count + 1)]
        for hand in sorted(edge.hands(tip, behind), key=home.angle_to):
            pad = tip * hand.rotation[:, 2]
            hands = [Pose.of(joint.motion(then).apply(hand.p + pad) - pad, hand.q) for then in positions]
            plan = _plan(planner, q, joint, hands, positions)
            if plan is not None:
                yield plan


def _plan(
    planner: ArmPlanner, q: Array, joint: DrivenJoint, hands: list[Pose], positions: list[float]
) -> GraspPlan | None:
    """Return a plan in which the hand moves along the poses, or None if the arm is unable to follow them."""
    if any(planner.arm.is_too_short(X_WH) for X_WH in hands) or not _is_free(planner, joint, hands, positions):
        return None
    name, grasp = joint.item.name, Grasp(hands[0], width=0.0, open=1.0, cost=0.0)
    down = path_to(planner, q, grasp)
    if down is None:
        return None
    along: Path = [down[-1]]
    for X_WH in hands[1:]:
        part = planner.line(along[-1], X_WH, 1.0, ignore=[name])
        if part is None:
            return None
        along += part[1:]
    back = planner.line(along[-1], before(hands[-1]), 1.0, ignore=[name])
    way = planner.way(q, down[0], 1.0) if back is not None else None
    return None if back is None or way is None else GraspPlan(grasp, way, down, along, back)


def _is_free(planner: ArmPlanner, joint: DrivenJoint, hands: list[Pose], positions: list[float]) -> bool:
    """Return True if the hand touches nothing while the link moves ahead of it."""
    cell, name, free = planner.cell, f"{joint.item.name}.{joint.joint.name}", True
    low, high = joint.joint.limits or (-math.inf, math.inf)
    cell.pose(planner.name, planner.arm.home, 1.0)
    for X_WH, position in zip(hands, positions, strict=True):
        cell.turn(name, min(max(position, low), high))
        free = free and not cell.hand_clash(planner.name, X_WH)
    cell.turn(name, joint.now)
    return free
