"""Similarity transforms: a rotation, a translation and a uniform scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simfoundry.geometry.frames import Array, Pose, quat_from_matrix

# Least second singular value of the points, relative to the first, at which they determine a rotation. Below it, they
# lie on a line to within 1 mm over a meter, and the rotation about that line would be made of noise.
MIN_SPREAD = 1e-3

# Deviations of a matrix from one of a similarity, and from the identity, that count as rounding: files and engines have
# matrices of single-precision numbers, and products of a few of them.
_ROUNDING, _STILL = 1e-4, 1e-6


@dataclass(frozen=True, eq=False)
class Similarity:
    """A map from frame B to frame A: ``p_A = X_AB.apply(scale * p_B)``.

    Attributes:
        X_AB: Pose of B in A.
        scale: Length in A of one unit in B, greater than zero.
    """

    X_AB: Pose
    scale: float = 1.0

    @classmethod
    def from_matrix(cls, matrix: Array) -> Similarity:
        """Return the similarity of a homogeneous matrix, shape (4, 4). Almost the identity becomes the identity.

        Raises:
            ValueError: If the matrix is not that of a similarity; the message is a participle, such as "mirrored".
        """
        linear = np.asarray(matrix, dtype=np.float64)[:3, :3]
        if not np.isfinite(matrix).all() or not np.linalg.det(linear) > 0:
            raise ValueError("mirrored, flat or not finite")
        scale = float(np.cbrt(np.linalg.det(linear)))
        if np.abs(linear.T @ linear / scale**2 - np.eye(3)).max() > _ROUNDING:
            raise ValueError("sheared or scaled unevenly")
        if np.abs(matrix - np.eye(4)).max() < _STILL:
            return cls(Pose.of())
        return cls(Pose.of(matrix[:3, 3], quat_from_matrix(linear / scale)), scale)

    def apply(self, points: Array) -> Array:
        """Map points of shape (..., 3) from B to A."""
        return self.X_AB.apply(self.scale * np.asarray(points, dtype=np.float64))

    def inverse(self) -> Similarity:
        """Return the map from A to B."""
        X_BA = self.X_AB.inverse()
        return Similarity(Pose.of(X_BA.p / self.scale, X_BA.q), 1.0 / self.scale)

    def __matmul__(self, other: Similarity) -> Similarity:
        """Compose two maps: first ``other``, from C to B, then this one."""
        return Similarity(Pose.of(self.apply(other.X_AB.p), (self.X_AB @ other.X_AB).q), self.scale * other.scale)

    def residuals(self, p_B: Array, p_A: Array) -> Array:
        """Return the distances [m] in A between mapped points and their counterparts, both of shape (n, 3)."""
        return np.asarray(np.linalg.norm(self.apply(p_B) - np.asarray(p_A), axis=1))


def fit_similarity(p_B: Array, p_A: Array, weights: Array | None = None) -> Similarity:
    """Return the similarity from B to A with the least weighted sum of squared residuals between paired points.

    The closed form is that of S. Umeyama, "Least-squares estimation of transformation parameters between two point
    patterns", PAMI 13(4), 1991. It never mirrors, also if the points lie in a plane, as three points always do.

    Args:
        p_B: Points in B, shape (n, 3), n >= 3.
        p_A: Their counterparts in A, shape (n, 3).
        weights: Weights of the pairs, at least zero, shape (n,). By default, all are equal.

    Raises:
        ValueError: If there are fewer than three pairs with a weight, or if the points of either frame coincide or lie
            on a line.
    """
    source, target = np.asarray(p_B, dtype=np.float64), np.asarray(p_A, dtype=np.float64)
    if source.shape != target.shape or source.ndim != 2 or source.shape[1] != 3 or len(source) < 3:
        raise ValueError(f"at least three pairs of points are needed, got {source.shape} and {target.shape}")
    if not (np.isfinite(source).all() and np.isfinite(target).all()):
        raise ValueError("the coordinates of the points must be finite")
    share = np.ones(len(source)) if weights is None else np.asarray(weights, dtype=np.float64)
    if share.shape != (len(source),) or not np.isfinite(share).all() or (share < 0).any() or (share > 0).sum() < 3:
        raise ValueError("each pair needs a weight, at least zero, and three pairs need more than zero")
    share = share / share.sum()
    middle_of_b, middle_of_a = share @ source, share @ target
    root = np.sqrt(share)[:, None]
    b, a = root * (source - middle_of_b), root * (target - middle_of_a)
    for points in (b, a):
        spread = np.linalg.svd(points, compute_uv=False)
        if spread[1] <= MIN_SPREAD * spread[0]:  # also if all coincide
            raise ValueError("the points lie on a line, so they do not determine a rotation; choose them farther apart")
    u, stretch, vt = np.linalg.svd(a.T @ b)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    rotation = (u * signs) @ vt
    scale = float(stretch @ signs / (b**2).sum())
    if scale <= 0:
        raise ValueError("the pairs contradict each other; check that each point is paired with its own counterpart")
    q = Pose.from_matrix(rotation).q
    return Similarity(Pose.of(middle_of_a - scale * (Pose.of(q=q).rotation @ middle_of_b), q), scale)
