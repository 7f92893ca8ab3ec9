"""The joint of an object, from two views in which one of its parts has moved.

The views show free space, so that they tell which surface is gone, which is new, and which is only hidden. A motion
must bring surface that is not there any more to where surface is new, and must not bring any to where the second view
sees free space. Among motions that explain the views about equally well, a translation is preferred to a rotation, and
then the smaller motion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, product

import numpy as np

from simfoundry.capture.articulation.evidence import FEWEST, MotionEvidence, pixels_of, surface
from simfoundry.capture.articulation.motions import (
    ALIGNED,
    QUANTILES,
    SLIDES,
    THICKNESS,
    TURNS,
    TYPICAL_BACK,
    Motion,
    Patch,
    candidate_motions,
    patches,
)
from simfoundry.capture.articulation.out_of_sight import slide_out_of_sight
from simfoundry.capture.articulation.refine import SNAPPED, rank_of, refined_motion
from simfoundry.capture.articulation.unclaimed import unclaimed_share
from simfoundry.capture.articulation.views import Mask, PosedView, Sight
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Array, cross
from simfoundry.scene.model import JointType

# Number of candidates to refine, one for each axis, and number of those to refine again.
FINALISTS, REPEATED = 6, 3

# Largest ratio of scores that is stated: a drawer whose front is out of sight has no score of its own.
MOST_AHEAD = 10.0

# Distance between two hinges that are different ones [m].
APART = 0.05

# Smallest sine of the angle between two normals of a box.
SQUARE = 0.9

# Largest vertical share of the normal of an upright front, and how much farther out the part must have been before it
# counts as opened first [m]: fronts and handles stand out by half as much.
UPRIGHT, FARTHER = 0.3, 0.04

# Distance from a front within which points of its plane may belong to it [m]: normals are unknown within 6 pixels of
# 640, which are 3 cm of a lid that is seen from 20 degrees above at 1 m.
GROWTH = 0.03

# Margin of a part's outline, and how far handles stand off it [m].
OUTLINE, PROUD = 0.004, 0.1

# Width of the border of an image, and the fewest new points there that mean that the part is cut off [px].
BORDER, LEAST_CUT = 3, 10

# Largest angle between an axis and one of the object's box for which they are taken as the same [rad]: noise turns axes
# by about as much, which costs little of the evidence. Up to the second angle, it must cost hardly any, except for
# slides: none is oblique to its front, and the sides of a tray pull an axis away where few pixels show it.
SNAP, FAR_SNAP = math.radians(8.0), math.radians(20.0)
NEAR_COST, SNAP_COST = 0.3, 0.06

# Share of new surface that a door reaches: all of it is its panel, however much of that is in the image, and however
# obliquely it is seen. The tray of a drawer whose front is out of sight looks like a flap that reaches less. The doors
# that left the image reached 0.93 or more, and the drawers that looked like flaps at most 0.73 (36 doors of the seeds 1
# to 60, and 5 drawers of the seeds 0 and 100 to 170 of tests.capture.furniture, 320 pixels wide).
WHOLE = 0.85


@dataclass(frozen=True, eq=False)
class StatedPart:
    """A person's statements about a part that moves.

    Attributes:
        hinge: Two points of its hinge in the world [m], shape (2, 3), or None if it is unknown whether there is one.
        box: The pixels of the first view that may show the part, shape (h, w), or None for all.
    """

    hinge: Array | None = None
    box: Mask | None = None


@dataclass(frozen=True, eq=False)
class JointEstimate:
    """The joint of a part that moved.

    Attributes:
        motion: The motion from the first view to the second.
        front: The flat surface of the part in the first view.
        part: The pixels of the first view that show the part, shape (h, w).
        explained: The share of the new surface that the motion explains, from 0 to 1.
        reached: The share of the new surface that is near to where the motion brings surface, from 0 to 1.
        contradicted: The share of the gone surface that the motion brings to free space, from 0 to 1.
        is_snapped: True if the axis is one of the object's box instead of the one that fits best.
        runner_up: The score of the best motion of another type, or about another hinge, relative to this one.
        is_cut: True if the border of the second image cuts off the part.
        is_out_of_sight: True if its front has left the second image, so that it may have moved farther.
        unclaimed: The share of the changed surface that the motion of this part does not account for, from 0 to 1.
        is_reversed: True if the part stands out from the object in the first view more than in the second.
    """

    motion: Motion
    front: Patch
    part: Mask
    explained: float
    reached: float
    contradicted: float
    is_snapped: bool
    runner_up: float
    is_cut: bool
    is_out_of_sight: bool
    unclaimed: float
    is_reversed: bool


def estimate_joint(
    first: PosedView, second: PosedView, stated: StatedPart | None = None, seed: int = 0
) -> JointEstimate:
    """Estimate the joint of a part that moved between two views.

    Args:
        first: The view in which the joint is at zero.
        second: The view in which the part has moved.
        stated: What a person knows of the part, which is not questioned.
        seed: Seed of the random choices.

    Raises:
        SimfoundryError: If nothing moved, or the part shows no flat surface.
    """
    rng = np.random.default_rng(seed)
    stated = stated or StatedPart()
    evidence = MotionEvidence.of(first, second, rng, stated.box)
    fronts = patches(evidence.moved.points, evidence.moved.normals, rng)
    axes = _box_axes([*patches(evidence.still.points, evidence.still.normals, rng), *fronts])
    coarse = evidence.coarse()
    if stated.hinge is not None and fronts:
        return _estimate(_about(stated.hinge, evidence), False, evidence, fronts, [], first, second)
    whole = [_grown(front, first, second) for front in fronts]
    best_of_axes = [max(group, key=coarse.score) for group in candidate_motions(whole, axes)]
    if not best_of_axes:
        raise SimfoundryError(
            "the part that moved has no flat surface, so that its motion cannot be found; capture it from where its "
            "front is visible, or state the joint in the asset document"
        )
    found = sorted(best_of_axes, key=coarse.score, reverse=True)[:FINALISTS]
    refined = [refined_motion(motion, evidence) for motion in found]
    refined = [
        refined_motion(motion, evidence) for motion in sorted(refined, key=evidence.score, reverse=True)[:REPEATED]
    ]
    best = max(refined, key=partial(rank_of, evidence=evidence))
    is_flap = best.kind is JointType.REVOLUTE and evidence.judge(best).reached < WHOLE
    if is_flap and _is_cut(first, second) and (slide := slide_out_of_sight(evidence, fronts)) is not None:
        estimate = _estimate(slide[0], True, evidence, fronts, refined, first, second)
        return replace(estimate, explained=slide[1], is_out_of_sight=True)
    snapped = _snapped(best, evidence, axes)
    return _estimate(snapped or best, snapped is not None, evidence, fronts, refined, first, second)


def amount_about(motion: Motion, first: PosedView, second: PosedView, seed: int = 0) -> float:
    """Return the amount of a known motion between its first view and another one [m or rad].

    Raises:
        SimfoundryError: If nothing moved.
    """
    evidence = MotionEvidence.of(first, second, np.random.default_rng(seed))
    amounts = TURNS if motion.kind is JointType.REVOLUTE else SLIDES
    best = max((replace(motion, q=q) for q in amounts), key=evidence.coarse().score)
    return refined_motion(best, evidence, frozenset("q")).q


def _about(hinge: Array, evidence: MotionEvidence) -> Motion:
    """Return the turn about a stated hinge, two points of shape (2, 3), that explains the views best."""
    axis = (hinge[1] - hinge[0]) / np.linalg.norm(hinge[1] - hinge[0])
    pivot = hinge.mean(axis=0)
    turns = [
        Motion(JointType.REVOLUTE, sign * axis, pivot, q, back)
        for sign, q, back in product((1.0, -1.0), TURNS, (0.0, TYPICAL_BACK))
    ]
    return refined_motion(max(turns, key=evidence.coarse().score), evidence, frozenset("q"))


def _estimate(
    final: Motion,
    is_snapped: bool,
    evidence: MotionEvidence,
    fronts: Sequence[Patch],
    refined: Sequence[Motion],
    first: PosedView,
    second: PosedView,
) -> JointEstimate:
    """Return the estimate for a motion; ``refined`` are the motions that compete with it."""
    judged = evidence.judge(final)
    front = _front_of(final, fronts, second)
    part = _part(final, front, first, second)
    others = [evidence.score(motion) for motion in refined if _differs(motion, final)]
    return JointEstimate(
        final,
        front,
        part,
        judged.explained,
        judged.reached,
        judged.contradicted,
        is_snapped,
        min(MOST_AHEAD, max([0.0, *others]) / max(1e-9, evidence.score(final))),
        _is_cut(first, second),
        False,
        unclaimed_share(final, front, part, evidence),
        _is_reversed(evidence, fronts),
    )


def _differs(motion: Motion, other: Motion) -> bool:
    """Return True if two motions are of different types, or about different hinges."""
    is_turn = motion.kind is JointType.REVOLUTE
    if motion.kind is not other.kind or abs(float(motion.axis @ other.axis)) < math.cos(SNAP if is_turn else FAR_SNAP):
        return True
    return is_turn and float(np.linalg.norm(cross(motion.pivot - other.pivot, other.axis))) > APART


def _box_axes(flat: Sequence[Patch]) -> list[Array]:
    """Return the directions of an object's box: the vertical, the normals of its patches, and those square to two.

    Directions that only noise tells from the vertical are left out, since the vertical is that of the ground.
    """
    up = np.array([0.0, 0.0, 1.0])
    axes = [up, *(patch.normal for patch in flat)]
    crossed = [cross(a, b) for a, b in combinations(axes, 2)]
    found = [*axes[1:], *(c / np.linalg.norm(c) for c in crossed if np.linalg.norm(c) > SQUARE)]
    return [up, *(axis for axis in found if abs(float(axis @ up)) < math.cos(SNAP))]


def _snapped(motion: Motion, evidence: MotionEvidence, axes: Sequence[Array]) -> Motion | None:
    """Return the motion with the axis of the object's box that is close to its own, or None."""
    near = max(axes, key=lambda axis: abs(float(axis @ motion.axis)))
    cosine = float(near @ motion.axis)
    if abs(cosine) < math.cos(FAR_SNAP):
        return None
    # A tilt, or a hinge away from the edge, can make up for the wrong side of a panel, so that both are tried without.
    sides = (0.0, TYPICAL_BACK) if motion.kind is JointType.REVOLUTE else ()
    along = replace(motion, axis=near * math.copysign(1.0, cosine))
    pivot = motion.pivot if motion.edge is None else motion.edge
    starts = [along, *(replace(along, back=back, pivot=pivot) for back in sides)]
    tried = [refined_motion(start, evidence, SNAPPED) for start in starts]
    snapped = max(tried, key=partial(rank_of, evidence=evidence))
    is_near = motion.kind is JointType.PRISMATIC or abs(cosine) > math.cos(SNAP)
    cost = NEAR_COST if is_near else SNAP_COST
    return snapped if evidence.score(snapped) > evidence.score(motion) - cost else None


def _is_cut(first: PosedView, second: PosedView) -> bool:
    """Return True if new surface reaches the border of the second image."""
    index, new = pixels_of(second), surface(second, first).is_gone
    rows, columns = np.divmod(index[new], second.depth.shape[1])
    h, w = second.depth.shape
    at_border = (rows < BORDER) | (columns < BORDER) | (rows >= h - BORDER) | (columns >= w - BORDER)
    return int(at_border.sum()) > LEAST_CUT


def _grown(front: Patch, first: PosedView, second: PosedView) -> Patch:
    """Return a front with its points near edges, where normals are unknown, so that its outline reaches its edges.

    Near a hinge, points hardly move. On a lid these belong to it too, because it has no neighbors in its plane.
    """
    low, high = front.points.min(axis=0) - GROWTH, front.points.max(axis=0) + GROWTH
    points = first.points[first.mask & np.isfinite(first.depth)]
    points = points[((points > low) & (points < high)).all(axis=1)]
    points = points[np.abs((points - front.center) @ front.normal) < THICKNESS]
    if abs(front.normal[2]) < SQUARE:
        points = points[second.sight(points) != Sight.SEEN]
    return replace(front, points=points) if len(points) > len(front.points) else front


def _is_reversed(evidence: MotionEvidence, fronts: Sequence[Patch]) -> bool:
    """Return True if the moved part stood out farther from the rest of the object than it does now."""
    facing = [front.normal for front in fronts if abs(front.normal[2]) < UPRIGHT]
    if not facing or len(evidence.still.points) < FEWEST:
        return False
    x = facing[0] * [1, 1, 0]
    basis = np.column_stack([x / np.linalg.norm(x), cross(np.array([0.0, 0.0, 1.0]), x / np.linalg.norm(x))])
    basis = np.column_stack([basis, [0.0, 0.0, 1.0]])
    low, high = np.quantile(evidence.still.points @ basis, QUANTILES, axis=0)

    def outside(points: Array) -> float:
        local = points @ basis
        return float(np.linalg.norm(np.maximum(np.maximum(low - local, local - high), 0), axis=1).mean())

    gone = evidence.moved.points[evidence.moved.is_gone]
    return bool(len(gone) and len(evidence.new.points)) and outside(gone) > outside(evidence.new.points) + FARTHER


def _front_of(motion: Motion, fronts: Sequence[Patch], second: PosedView) -> Patch:
    """Return the front that a motion moves: the one that it keeps best. For a slide, a front must face along it."""
    facing = [front for front in fronts if abs(float(front.normal @ motion.axis)) > ALIGNED]
    is_slide = motion.kind is JointType.PRISMATIC
    return max(facing if is_slide and facing else fronts, key=lambda patch: _kept(motion, patch, second))


def _kept(motion: Motion, front: Patch, second: PosedView) -> int:
    """Return how many points of a front a motion does not bring into free space, less those that it does."""
    sight = second.sight(motion.moved(front.points - motion.back * front.normal))
    return int((sight != Sight.FREE).sum()) - int((sight == Sight.FREE).sum())


def _part(motion: Motion, front: Patch, first: PosedView, second: PosedView) -> Mask:
    """Return the pixels of the first view that show the part: what lies in the outline of its front, or stands off it.

    The outline is that of the points that are gone, or that the motion brings onto surface of the second view.
    """
    index, whole = pixels_of(first), surface(first, second)
    is_still = second.sight(whole.points) == Sight.SEEN
    arrived = second.sight(motion.moved(whole.points - motion.back * whole.normals)) == Sight.SEEN
    height = (whole.points - front.center) @ front.normal
    certain = (whole.is_gone | arrived) & ~is_still & (np.abs(height) < THICKNESS)
    u = cross(front.normal, np.eye(3)[int(np.argmin(np.abs(front.normal)))])
    u /= np.linalg.norm(u)
    flat = (whole.points - front.center) @ np.column_stack([u, cross(front.normal, u)])
    mask = np.zeros(first.depth.size, np.bool_)
    if certain.any():
        low, high = np.quantile(flat[certain], QUANTILES, axis=0)
        inside = ((flat > low - OUTLINE) & (flat < high + OUTLINE)).all(axis=1)
        mask[index[inside & (height > -THICKNESS) & (height < PROUD) & ~is_still]] = True
    return mask.reshape(first.depth.shape)
