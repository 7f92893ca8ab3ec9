"""Find poses of a model from pairs of points, without any segmentation of the image.

Two points of a surface with their normals have a distance and three angles, which do not depend on the pose. An
observed point and its neighbors are compared with all pairs of points of the model, which each vote for a pose at which
the points coincide (Drost et al., Model Globally, Match Locally, CVPR 2010).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.shapes.mesh_template import MeshTemplate
from simfoundry.geometry.frames import Array

# Distances of one kind, relative to the diameter of the model, and the least [m]; angles of one kind [deg]; and turns
# about the normal of the observed point that are distinguished. The first and the last are the values of the paper.
DISTANCE_STEP, LEAST_STEP, ANGLE_STEP_DEG, TURNS = 0.05, 0.005, 12.0, 30
ANGLES = round(180 / ANGLE_STEP_DEG)

# Number of points of a model that form pairs. With 350, the table of a model has 120,000 pairs.
MODEL_POINTS = 350

# Number of neighbors of an observed point that vote, and the fewest.
MAX_NEIGHBORS, FEWEST_NEIGHBORS = 250, 15

# Number of poses that an observed point may support.
POSES_OF_POINT = 3


@dataclass(frozen=True, eq=False)
class PairFeatures:
    """The pairs of points of a model, sorted by their kind.

    Attributes:
        points: Points of the surface [m], shape (n, 3).
        frames: Rotations that turn the normal at each point into x, shape (n, 3, 3).
        step: Distances of one kind [m].
        diameter: Largest distance of two points [m].
        kinds: Kind of each pair, ascending, shape (k,).
        first: Index of the first point of each pair, shape (k,).
        turns: Angle of the second point of each pair about the normal of the first [rad], shape (k,).
    """

    points: Array
    frames: Array
    step: float
    diameter: float
    kinds: NDArray[np.int64]
    first: NDArray[np.int64]
    turns: Array

    @classmethod
    def of(cls, template: MeshTemplate) -> PairFeatures:
        """Prepare the pairs of a model."""
        step = max(DISTANCE_STEP * template.diameter, LEAST_STEP)
        kept = spread_points(template.points, step)
        kept = kept[np.linspace(0, len(kept) - 1, min(len(kept), MODEL_POINTS)).astype(np.int64)]
        points, normals = template.points[kept], template.normals[kept]
        frames = _frames(normals)
        offsets = points[None] - points[:, None]
        kinds, distance = _kinds(offsets, normals[:, None], normals[None], step)
        turns = _turns(np.einsum("nij,nmj->nmi", frames, offsets))
        apart = distance > step
        first = np.broadcast_to(np.arange(len(points))[:, None], kinds.shape)[apart]
        order = np.argsort(kinds[apart], kind="stable")
        return cls(points, frames, step, template.diameter, kinds[apart][order], first[order], turns[apart][order])

    def poses(self, points: Array, normals: Array, references: NDArray[np.int64]) -> tuple[Array, Array, Array]:
        """Return poses of the model for which many observed points vote.

        Args:
            points: Observed points [m], shape (n, 3).
            normals: Normals there, shape (n, 3).
            references: Indices of the points that are compared with all of their neighbors.

        Returns:
            The number of votes for each pose, shape (m,), and the rotations, (m, 3, 3), and translations [m], (m, 3).
            The poses with most votes come first.
        """
        from scipy.spatial import cKDTree

        tree = cKDTree(points)
        found: list[tuple[int, Array, Array]] = []
        for k in references:
            near = np.array(tree.query_ball_point(points[k], self.diameter, return_sorted=True))
            near = near[near != k]
            if len(near) >= FEWEST_NEIGHBORS:
                near = near[np.linspace(0, len(near) - 1, min(len(near), MAX_NEIGHBORS)).astype(np.int64)]
                found += self._votes(points[k], normals[k], points[near], normals[near])
        found.sort(key=lambda each: -each[0])
        votes, rotations, translations = (np.array([each[j] for each in found]) for j in range(3))
        return votes, rotations.reshape(-1, 3, 3), translations.reshape(-1, 3)

    def _votes(self, point: Array, normal: Array, others: Array, normals: Array) -> list[tuple[int, Array, Array]]:
        """Return the poses at which pairs of an observed point coincide with pairs of the model, with their votes."""
        (frame,) = _frames(normal[None])
        kinds, distance = _kinds(others - point, normal, normals, self.step)
        low, high = np.searchsorted(self.kinds, kinds, "left"), np.searchsorted(self.kinds, kinds, "right")
        count = np.where(distance > self.step, high - low, 0)
        if not count.any():
            return []
        starts = np.concatenate([[0], np.cumsum(count)[:-1]])
        pairs = np.repeat(low - starts, count) + np.arange(count.sum())
        turn = self.turns[pairs] - np.repeat(_turns((others - point) @ frame.T), count)
        part = np.floor(turn % (2 * math.pi) * (TURNS / (2 * math.pi))).astype(np.int64) % TURNS
        counts = np.bincount(self.first[pairs] * TURNS + part, minlength=len(self.points) * TURNS).reshape(-1, TURNS)
        votes = (counts + np.roll(counts, 1, axis=1)).ravel()  # a turn near the end of a part votes for both
        out: list[tuple[int, Array, Array]] = []
        most = np.sort(np.argpartition(-votes, 3 * POSES_OF_POINT)[: 3 * POSES_OF_POINT])
        for best in most[np.argsort(-votes[most], kind="stable")]:
            owner, part_of_turn = divmod(int(best), TURNS)
            c, s = (f(part_of_turn * 2 * math.pi / TURNS) for f in (math.cos, math.sin))
            rotation = frame.T @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ self.frames[owner]
            if all(np.trace(rotation.T @ other) < 1 + 2 * math.cos(4 * math.pi / TURNS) for _, other, _ in out):
                out.append((int(votes[best]), rotation, point - rotation @ self.points[owner]))
            if len(out) == POSES_OF_POINT:
                break
        return out


def spread_points(points: Array, step: float) -> NDArray[np.int64]:
    """Return the indices of points [m], one in each cell of a grid with cells of ``step`` [m], ascending."""
    cells = np.floor(points / step).astype(np.int64)
    return np.sort(np.unique(cells, axis=0, return_index=True)[1])


def _frames(normals: Array) -> Array:
    """Return rotations that turn unit vectors into x, shape (n, 3, 3)."""
    least = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    y = np.cross(normals, least)
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    return np.stack([normals, y, np.cross(normals, y)], axis=1)


def _kinds(offsets: Array, first: Array, second: Array, step: float) -> tuple[NDArray[np.int64], Array]:
    """Return the kinds of pairs of points, and their distances [m], from the offsets and the normals of both points."""
    distance = np.linalg.norm(offsets, axis=-1)
    along = offsets / np.maximum(distance, 1e-9)[..., None]
    kinds = np.floor(distance / step).astype(np.int64)
    for a, b in ((first, along), (second, along), (first, second)):
        angle = np.degrees(np.arccos(np.clip((a * b).sum(axis=-1), -1, 1)))
        kinds = kinds * ANGLES + np.minimum(angle / ANGLE_STEP_DEG, ANGLES - 1).astype(np.int64)
    return kinds, distance


def _turns(offsets: Array) -> Array:
    """Return the angles of offsets about x [rad], in the sense of which a pose is the difference."""
    return np.arctan2(-offsets[..., 2], offsets[..., 1])
