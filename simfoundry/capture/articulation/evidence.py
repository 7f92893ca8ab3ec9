"""The evidence about a motion in two views: which surface is gone, which is new, and which is only hidden."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.articulation.motions import Motion
from simfoundry.capture.articulation.views import Mask, PosedView, Sight
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Array
from simfoundry.scene.model import JointType

# Fewest points that must be gone or new: those of a drawer of 10 x 5 cm that is 1 cm open, at 1 m.
FEWEST = 150

# Number of points of each kind to judge motions with, and to judge candidates with before they are refined.
SAMPLE, COARSE = 2500, 500

# Distance at which a new point counts as not explained [m]. Candidates are tried in steps, which are up to 2 cm at the
# far edge of a door, so that their distances are larger.
REACH, COARSE_REACH = 0.012, 0.03

# With fewer new points than this, the surface that is gone decides: those of a panel of 7 x 7 cm, seen edge-on.
LEAST_NEW = 40

# A motion that brings fewer points onto surface than this explains nothing.
LEAST_HELD = 5

# Preference for a translation, and for smaller motions: the share of the evidence that a rotation, or half a turn or a
# meter, must explain in addition.
EASIER, SMALLER = 0.05, 0.05


@dataclass(frozen=True, eq=False)
class Surface:
    """Points with normals.

    Attributes:
        points: The points [m], shape (n, 3).
        normals: Their unit normals, shape (n, 3).
        is_gone: True for points at which the other view sees free space, shape (n,).
    """

    points: Array
    normals: Array
    is_gone: Mask

    def at(self, index: NDArray[np.generic] | slice) -> Surface:
        """Select points by index or mask."""
        return Surface(self.points[index], self.normals[index], self.is_gone[index])

    def sampled(self, rng: np.random.Generator) -> Surface:
        """Return at most :data:`SAMPLE` of the points."""
        n = len(self.points)
        return self if n <= SAMPLE else self.at(np.sort(rng.choice(n, SAMPLE, replace=False)))


@dataclass(frozen=True)
class MotionJudgement:
    """The agreement of a motion with two views.

    Attributes:
        explained: The share of new points that the motion brings there from surface that is not there any more. If
            hardly any are new, it is the share of gone points that the motion brings to surface that was not seen.
            Points count less the farther they are from where the motion brings surface, and the more they are turned.
        reached: The share of new points that are near to where the motion brings surface, however they are turned.
        contradicted: The share of gone points that the motion brings to where the second view sees free space.
        impossible: The share of new points that the motion brings there from where the first view sees free space.
    """

    explained: float
    reached: float
    contradicted: float
    impossible: float


@dataclass(frozen=True, eq=False)
class MotionEvidence:
    """The surfaces by which motions are judged.

    Attributes:
        first: The first view.
        second: The second view.
        moved: The surface of the first view that the second one does not see any more: it is gone, or hidden.
        new: The surface of the second view where the first one sees free space. If that is little, it is also the
            surface where the first view has no reading, which may be new.
        still: The surface that both views see.
        reach: The distance at which a new point counts as not explained [m].
        is_coarse: True if motions are tried in steps, so that new points seem to come from free space a step away.
    """

    first: PosedView
    second: PosedView
    moved: Surface
    new: Surface
    still: Surface
    reach: float = REACH
    is_coarse: bool = False

    @staticmethod
    def of(first: PosedView, second: PosedView, rng: np.random.Generator, box: Mask | None = None) -> MotionEvidence:
        """Gather the evidence of two views, in which only the pixels in ``box`` of the first, shape (h, w), moved.

        Raises:
            SimfoundryError: If nothing moved.
        """
        before, after = surface(first, second), surface(second, first)
        if max(before.is_gone.sum(), after.is_gone.sum()) < FEWEST:
            raise SimfoundryError(
                f"no part of the object moved between the two captures: fewer than {FEWEST} points of one are where "
                "the other sees free space; open the part farther, and capture it again"
            )
        is_still = second.sight(before.points) == Sight.SEEN
        may_move = ~is_still if box is None else ~is_still & box.reshape(-1)[pixels_of(first)]
        if may_move.sum() < FEWEST:
            raise SimfoundryError("nothing moved inside the stated box; draw it around the part in the first capture")
        is_new = after.is_gone
        if is_new.sum() < FEWEST:  # as if a lid is raised before a background without depth
            is_new = is_new | first.is_unread(after.points)
        return MotionEvidence(
            first,
            second,
            before.at(may_move).sampled(rng),
            after.at(is_new).sampled(rng),
            before.at(is_still).sampled(rng),
        )

    def coarse(self) -> MotionEvidence:
        """Return fewer points with a larger reach, to judge many motions."""
        moved, new = (each.at(slice(None, None, max(1, len(each.points) // COARSE))) for each in (self.moved, self.new))
        return replace(self, moved=moved, new=new, reach=COARSE_REACH, is_coarse=True)

    def judge(self, motion: Motion) -> MotionJudgement:
        """Return what the views say about a motion.

        Only points that are certainly gone can contradict: hidden ones may belong to something that never moved. New
        points can come from where nothing was seen, such as the inside of a drawer, but not from free space.
        """
        from scipy.spatial import cKDTree

        moved = motion.moved(self.moved.points - motion.back * self.moved.normals)
        sight = self.second.sight(moved)
        held, gone = sight == Sight.SEEN, self.moved.is_gone
        wrong = float(((sight == Sight.FREE) & gone).sum() / max(1, gone.sum()))
        if len(self.new.points) < LEAST_NEW:
            arrived = held & gone & (self.first.sight(moved) != Sight.SEEN)
            explained = float(arrived.sum() / max(1, gone.sum()))
            return MotionJudgement(explained, explained, wrong, 0.0)
        impossible = 0.0 if self.is_coarse else self._impossible(motion)
        if held.sum() < LEAST_HELD:
            return MotionJudgement(0.0, 0.0, wrong, impossible)
        turned = self.moved.normals[held] @ motion.rotation.T
        distance, k = cKDTree(moved[held]).query(self.new.points, distance_upper_bound=self.reach)
        near = np.isfinite(distance)
        # An edge-on panel shows its rim, so that normals count only by their angle.
        aligned = np.abs(np.einsum("ij,ij->i", turned[k[near]], self.new.normals[near]))
        weight = (1 - (distance[near] / self.reach) ** 2) * aligned
        return MotionJudgement(float(weight.sum() / len(near)), float(near.mean()), wrong, impossible)

    def _impossible(self, motion: Motion) -> float:
        return float((self.first.sight(motion.sources(self.new.points)) == Sight.FREE).mean())

    def score(self, motion: Motion) -> float:
        """Return the score of a motion; higher is better."""
        judged = self.judge(motion)
        is_turn = motion.kind is JointType.REVOLUTE
        size = motion.q / math.pi if is_turn else motion.q
        return judged.explained - judged.contradicted - judged.impossible - SMALLER * size - EASIER * is_turn


def surface(view: PosedView, other: PosedView) -> Surface:
    """Return the surface of an object in a view, and where another view sees free space at it."""
    index = pixels_of(view)
    points = view.points.reshape(-1, 3)[index]
    return Surface(points, view.normals.reshape(-1, 3)[index], other.sight(points) == Sight.FREE)


def pixels_of(view: PosedView) -> NDArray[np.int64]:
    """Return the flat indices of the pixels of an object that have a point and a normal."""
    usable = view.mask & np.isfinite(view.depth) & np.isfinite(view.normals).all(axis=2)
    return np.flatnonzero(usable)
