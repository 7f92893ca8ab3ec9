"""Alignment of backgrounds: similarity transforms from clouds of points, from camera poses, and from depths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array, Pose, quat_from_matrix, rotations
from simfoundry.geometry.similarity import Similarity, fit_similarity

# Numbers of points by which rotations are compared at first, by which the best of them are refined, and by which the
# result is.
_SCREENED, _COARSE, _FINE = 300, 1_000, 20_000

# Number of rotations tried, spread evenly over all: neighbors are 25 degrees apart, half of what refinements correct.
_ROTATIONS = 600
# Number of rotations of the comparison that are refined. The right one was among the first four in all trials.
_REFINED = 8

# Iterations of the refinements; each stops earlier if nothing moves any more.
_COARSE_STEPS, _FINE_STEPS = 40, 60

# Fraction of the pairs that is used, from the closest on. The rest is noise, or parts that only one side has.
_USED = 0.8

# Weight of a difference in color, in units of the spread of the points: black and white count like opposite ends.
_COLOR = 1.0

# Largest distance of pairs, as a fraction of the spread, at which clouds count as the same; noise of trainers is 1 %.
_SAME = 0.03
# The same, as a multiple of the distance of neighbors on one side, for clouds that are sparser than that.
_GAPS = 2.0

# Least fraction of A that must be in B. Otherwise, a cloud shrunk to a point on a wall would be the best fit.
_COVERED = 0.3

# Largest change of the scale by which the fit to planes may correct that of nearest neighbors.
_CORRECTED = 0.1

# Distance of pairs, as a fraction of the spread, below which the points of one cloud are those of the other.
_EXACT = 1e-7

# Number of neighbors that determine a plane, the thickness relative to the width at which they lie in one, and the
# number of iterations of the fit to planes.
_NEIGHBORS, _PLANAR, _PLANE_STEPS = 12, 0.1, 20

Index = NDArray[np.int64]


class ColorCloud(NamedTuple):
    """Points [m], shape (n, 3), and their colors in [0, 1], shape (n, 3), which are equal if they are not known."""

    points: Array
    colors: Array

    def some(self, count: int, rng: np.random.Generator) -> ColorCloud:
        """Return at most ``count`` of the points, chosen at random."""
        if len(self.points) <= count:
            return self
        index = np.sort(rng.choice(len(self.points), count, replace=False))
        return ColorCloud(self.points[index], self.colors[index])


class AlignmentError(ValueError):
    """Two clouds that do not show the same surroundings; the message is a sentence."""


@dataclass(frozen=True, eq=False)
class CloudAlignment:
    """An alignment of a cloud in frame B with one in frame A.

    Attributes:
        S_AB: The similarity.
        error: Median distance of corresponding points [m] in A.
        overlap: Fraction of the points of B that have a counterpart in A.
    """

    S_AB: Similarity
    error: float
    overlap: float


def align_clouds(cloud_b: ColorCloud, cloud_a: ColorCloud, seed: int = 0) -> CloudAlignment:
    """Find the similarity from B to A of clouds of the same surroundings, without a first guess.

    Evenly spread rotations are compared by the distances of nearest points in space and color, and the best of them are
    refined with mutual nearest neighbors (Besl and McKay, PAMI 14(2), 1992; trimmed).

    Raises:
        AlignmentError: If no similarity lays one cloud on the other.
    """
    rng = np.random.default_rng(seed)
    if min(len(cloud_a.points), len(cloud_b.points)) < 10:
        raise AlignmentError("there are fewer than ten points to align")
    (center_a, spread_a), (center_b, spread_b) = _frame(cloud_a.points), _frame(cloud_b.points)
    if min(spread_a, spread_b) <= 0:
        raise AlignmentError("the points of one side are all at one place")
    unit_a = ColorCloud((cloud_a.points - center_a) / spread_a, _COLOR * cloud_a.colors)
    unit_b = ColorCloud((cloud_b.points - center_b) / spread_b, _COLOR * cloud_b.colors)
    starts = _screened(unit_b.some(_SCREENED, rng), unit_a.some(_COARSE, rng))
    few_b, few_a = unit_b.some(_COARSE, rng), unit_a.some(_COARSE, rng)
    found = [_refined(Similarity(Pose.of(q=quat_from_matrix(R))), few_b, few_a, _COARSE_STEPS) for R in starts]
    best = min(found, key=lambda S_AB: _mismatch(S_AB, few_b, few_a))
    many_b, many_a = unit_b.some(_FINE, rng), unit_a.some(_FINE, rng)
    S_AB = _refined(best, many_b, many_a, _FINE_STEPS)
    if np.median(_nearest(S_AB, many_b, many_a)[1]) > _EXACT:
        S_AB = _fitted_to_planes(S_AB, many_b, many_a)
    distances = np.sort(_nearest(S_AB, many_b, many_a)[1])
    error = float(distances[: max(1, int(_USED * len(distances)))].max())
    same = max(_SAME, _GAPS * _gap(many_a))
    covered = float((_nearest(S_AB.inverse(), many_a, many_b)[1] * S_AB.scale < same).mean())
    if covered < _COVERED:
        raise AlignmentError(f"the two sides do not show the same surroundings: only {covered:.0%} of one is in both")
    if not error < same:
        shown = f"after the best alignment, {1 - _USED:.0%} of the points are more than {error * spread_a:.3g} m apart"
        raise AlignmentError(f"the two sides do not show the same surroundings: {shown}")
    to_unit = Similarity(Pose.of(-center_b / spread_b), 1.0 / spread_b)
    S_AB = Similarity(Pose.of(center_a), spread_a) @ S_AB @ to_unit
    return CloudAlignment(S_AB, float(np.median(distances)) * spread_a, float((distances < same).mean()))


def _frame(points: Array) -> tuple[Array, float]:
    """Return the center and the spread of a cloud. Points far away, which trainers leave behind, hardly change them."""
    center = np.median(points, axis=0)
    reach = np.linalg.norm(points - center, axis=1)
    inner = points[reach <= np.quantile(reach, 0.95)]
    center = inner.mean(axis=0)
    return center, float(np.sqrt(((inner - center) ** 2).sum(axis=1).mean()))


def _screened(cloud_b: ColorCloud, cloud_a: ColorCloud) -> list[Array]:
    """Return the most promising rotations for clouds with a common center and spread."""
    turns = _even_rotations(_ROTATIONS)
    scores = [_mismatch(Similarity(Pose.of(q=quat_from_matrix(R))), cloud_b, cloud_a) for R in turns]
    return [turns[k] for k in np.argsort(scores, kind="stable")[:_REFINED]]


def _even_rotations(count: int) -> Array:
    """Return rotation matrices spread evenly over all rotations (Alexa, super-Fibonacci spirals, CVPR 2022)."""
    psi = 1.533751168755204288118041  # the positive root of psi^4 = psi + 4
    s = np.arange(count) + 0.5
    alpha, beta = 2 * np.pi * s / np.sqrt(2), 2 * np.pi * s / psi
    r, other = np.sqrt(s / count), np.sqrt(1 - s / count)
    q = np.stack([r * np.sin(alpha), r * np.cos(alpha), other * np.sin(beta), other * np.cos(beta)], axis=1)
    return rotations(q)


def _nearest(S_AB: Similarity, cloud_b: ColorCloud, cloud_a: ColorCloud) -> tuple[Index, Array]:
    """Return the nearest point of A in space to each point of B, and its distance."""
    from scipy.spatial import cKDTree

    distances, index = cKDTree(cloud_a.points).query(S_AB.apply(cloud_b.points))
    return index, distances


def _mismatch(S_AB: Similarity, cloud_b: ColorCloud, cloud_a: ColorCloud) -> float:
    """Return the mean distance in space and color from the points of B to the nearest of A, without the worst."""
    from scipy.spatial import cKDTree

    moved = np.concatenate([S_AB.apply(cloud_b.points), cloud_b.colors], axis=1)
    distances, _ = cKDTree(np.concatenate([cloud_a.points, cloud_a.colors], axis=1)).query(moved)
    return float(np.sort(distances)[: max(1, int(_USED * len(distances)))].mean())


def _refined(S_AB: Similarity, cloud_b: ColorCloud, cloud_a: ColorCloud, steps: int) -> Similarity:
    """Return the similarity after iterations with mutual nearest neighbors, which cannot shrink one cloud to a point.

    The weight of color falls from that of the comparison to zero, so that the end is decided by positions alone.
    """
    from scipy.spatial import cKDTree

    for step in range(steps):
        weight = max(0.0, 1.0 - 2.0 * step / steps)
        there = np.concatenate([cloud_a.points, weight * cloud_a.colors], axis=1)
        here = np.concatenate([S_AB.apply(cloud_b.points), weight * cloud_b.colors], axis=1)
        forth = cKDTree(there).query(here)[1]
        back = cKDTree(here).query(there)[1]
        mutual = np.flatnonzero(back[forth] == np.arange(len(forth)))
        gaps = np.linalg.norm(here[mutual] - there[forth[mutual]], axis=1)
        kept = mutual[gaps <= np.quantile(gaps, _USED)] if len(gaps) else mutual
        try:
            new = fit_similarity(cloud_b.points[kept], cloud_a.points[forth[kept]])
        except ValueError:
            return S_AB
        moved = np.abs(new.apply(cloud_b.points) - S_AB.apply(cloud_b.points)).max()
        S_AB = new
        if weight == 0.0 and moved < 1e-9:
            break
    return S_AB


def _gap(cloud: ColorCloud) -> float:
    """Return the distance of neighbors that the given fraction of points has at most."""
    from scipy.spatial import cKDTree

    return float(np.quantile(cKDTree(cloud.points).query(cloud.points, 2)[0][:, 1], _USED))


def _fitted_to_planes(S_AB: Similarity, cloud_b: ColorCloud, cloud_a: ColorCloud) -> Similarity:
    """Return the similarity that lays points of B onto planes through those of A, for clouds with other points.

    Distances to planes do not depend on where on a wall its points are (Chen and Medioni, 1992).
    """
    from scipy.spatial import cKDTree

    tree = cKDTree(cloud_a.points)
    near = cloud_a.points[tree.query(cloud_a.points, _NEIGHBORS)[1]]
    middles = near.mean(axis=1)
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", near - middles[:, None], near - middles[:, None]))
    planar = spread[:, 0] < _PLANAR**2 * spread[:, 1]
    first = S_AB
    normals = axes[:, :, 0]
    for _ in range(_PLANE_STEPS):
        p = S_AB.apply(cloud_b.points)
        index = tree.query(p)[1]
        away = np.einsum("ni,ni->n", normals[index], p - middles[index])
        on = planar[index]
        if on.sum() < 100:  # too few for planes in all directions
            return first
        on &= np.abs(away) <= np.quantile(np.abs(away[on]), _USED)
        n, at = normals[index][on], p[on]
        rows = np.concatenate([np.cross(at, n), n, (n * at).sum(axis=1, keepdims=True)], axis=1)
        change = np.linalg.lstsq(rows, -away[on], rcond=1e-6)[0]
        turn, angle = change[:3], float(np.linalg.norm(change[:3]))
        X_AA = Pose.about(turn / angle, angle) if angle > 0 else Pose.of()
        if not abs(S_AB.scale * (1.0 + change[6]) / first.scale - 1.0) < _CORRECTED:
            return first
        S_AB = Similarity(Pose.of(change[3:6]), 1.0) @ Similarity(X_AA, 1.0 + float(change[6])) @ S_AB
        if np.abs(change).max() < 1e-10:
            break
    return S_AB


@dataclass(frozen=True, eq=False)
class CameraBridge:
    """A similarity from camera poses that are known in two frames.

    Attributes:
        S_WF: The similarity.
        position_error: Largest distance of a camera from its counterpart [m] in W.
        angle_error: Largest angle between a camera and its counterpart [rad].
    """

    S_WF: Similarity
    position_error: float
    angle_error: float


def bridge_cameras(X_FC: Sequence[Pose], X_WC: Sequence[Pose], scale: float | None = None) -> CameraBridge:
    """Return the similarity from F to W by cameras whose poses are known in both, such as those of in-painted frames.

    The rotation is the mean of those of the cameras, so that two cameras, or many on a line, are enough. With one
    camera, the scale must be known, for example from :func:`scale_from_depth`.

    Args:
        X_FC: Poses of the cameras in F, at least one.
        X_WC: Poses of the same cameras in W [m], in the same order.
        scale: Length of one unit of F [m], if it is known.

    Raises:
        ValueError: If the cameras do not determine a similarity.
    """
    if not X_FC or len(X_FC) != len(X_WC):
        raise ValueError(f"the numbers of poses differ, or there are none: {len(X_FC)} and {len(X_WC)}")
    turns = np.stack([w.rotation @ f.rotation.T for f, w in zip(X_FC, X_WC, strict=True)])
    u, _, vt = np.linalg.svd(turns.mean(axis=0))
    R_WF = (u * [1.0, 1.0, np.linalg.det(u) * np.linalg.det(vt)]) @ vt
    p_F, p_W = (np.stack([pose.p for pose in poses]) for poses in (X_FC, X_WC))
    away_f, away_w = (p_F - p_F.mean(axis=0)) @ R_WF.T, p_W - p_W.mean(axis=0)
    if scale is None:
        spread = float((away_f**2).sum())
        if spread <= 1e-12 * max(1.0, float((p_F**2).sum())):
            raise ValueError("the cameras are all at one place, so they do not determine a scale")
        scale = float((away_f * away_w).sum() / spread)
    if not (np.isfinite(scale) and scale > 0):
        raise ValueError("the poses contradict each other; check that each is paired with its own counterpart")
    q = quat_from_matrix(R_WF)
    S_WF = Similarity(Pose.of(p_W.mean(axis=0) - scale * (R_WF @ p_F.mean(axis=0)), q), scale)
    angles = [(Pose.of(q=q) @ Pose.of(q=f.q)).angle_to(w) for f, w in zip(X_FC, X_WC, strict=True)]
    return CameraBridge(S_WF, float(S_WF.residuals(p_F, p_W).max()), max(angles))


# Least number of pixels from which a scale is computed, and the largest spread of their ratios (between the quartiles,
# relative to the median) at which they agree. Noise of depth models is 2 to 5 %.
_PIXELS, _SPREAD = 50, 0.2


def scale_from_depth(depth_f: Array, depth_w: Array) -> float:
    """Return the length of one unit of F [m] from the depths of the same pixels, such as those of a tabletop.

    Args:
        depth_f: Depths in units of F, 0 where unknown, of any shape.
        depth_w: Depths of the same pixels [m], NaN or 0 where unknown.

    Raises:
        ValueError: If too few pixels have both depths, or if their ratios disagree.
    """
    both = (depth_f > 0) & np.isfinite(depth_w) & (depth_w > 0)
    ratios = depth_w[both] / depth_f[both]
    if len(ratios) < _PIXELS:
        raise ValueError(f"only {len(ratios)} pixels show the support in both; {_PIXELS} are needed")
    low, middle, high = np.quantile(ratios, (0.25, 0.5, 0.75))
    if high - low > _SPREAD * middle:
        raise ValueError(f"the depths disagree: their ratios lie between {low:.3g} and {high:.3g}")
    return float(middle)
