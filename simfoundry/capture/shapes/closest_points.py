"""Move a mesh onto observed points by matching them with the closest points of its surface, again and again."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.shapes.mesh_template import MeshTemplate
from simfoundry.capture.shapes.visible_cloud import VisibleCloud
from simfoundry.geometry.frames import Array

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

# Share of the diameter of the mesh that a turned normal counts as, so that points match with surface that faces alike.
NORMAL_WEIGHT = 0.25

# Weight of the distance between matched points beside that along the normal. It pulls in points beyond an edge.
POINT_WEIGHT = 0.1

# Range of the estimated scale relative to that at which the visible parts of mesh and object have the same size.
SCALE_RANGE = 2.5

# Rounds of matching after which only this share of the starts goes on, those that are closest to the observed points.
EARLY_ROUNDS, GOING_ON = 2, 0.4

# Rotations (n, 3, 3), translations (n, 3) [m] and scales (n,) of several starts.
States = tuple[Array, Array, Array]


def surface_tree(template: MeshTemplate) -> cKDTree:
    """Return the points of a mesh with their turned normals, in which :func:`closest_points` searches."""
    from scipy.spatial import cKDTree

    return cKDTree(np.hstack([template.points, template.normals * (NORMAL_WEIGHT * template.diameter)]))


def closest_points(
    points: Array, normals: Array, template: MeshTemplate, states: States, tree: cKDTree
) -> tuple[Array, NDArray[np.intp]]:
    """Match observed points with points of a mesh that face alike.

    Args:
        points: Observed points [m], shape (p, 3), or (n, p, 3) if they differ between the states.
        normals: Their normals, of the same shape.
        template: The mesh.
        states: Poses of the mesh.
        tree: Its surface, from :func:`surface_tree`.

    Returns:
        The observed points in the frame of the mesh, shape (n, p, 3), and the indices of the points of the mesh that
        they are matched with, shape (n, p).
    """
    turns, shifts, scale = states
    local = np.einsum("nji,npj->npi", turns, points - shifts[:, None]) / scale[:, None, None]
    facing = np.einsum("nji,npj->npi", turns, np.broadcast_to(normals, local.shape))
    both = np.concatenate([local, facing * (NORMAL_WEIGHT * template.diameter)], axis=2).reshape(-1, 6)
    return local, tree.query(both)[1].reshape(local.shape[:2])


def matched_states(
    cloud: VisibleCloud, template: MeshTemplate, states: States, free_scale: bool, rounds: int
) -> States:
    """Move all starts onto the observed points.

    Each round matches the points, and moves each start by :func:`small_motions`. Matches that are far off for the start
    count less.
    """
    tree = surface_tree(template)
    low, high = states[2] / SCALE_RANGE, states[2] * SCALE_RANGE
    for done in range(rounds):
        local, index = closest_points(cloud.points, cloud.normals, template, states, tree)
        distance = np.linalg.norm(local - template.points[index], axis=2)
        if done == EARLY_ROUNDS:
            ranked = np.argsort(_trimmed_mean(distance) * states[2], kind="stable")
            kept = np.sort(ranked[: max(1, int(GOING_ON * len(ranked)))])
            states = states[0][kept], states[1][kept], states[2][kept]
            local, index, distance, low, high = local[kept], index[kept], distance[kept], low[kept], high[kept]
        spread = np.maximum(np.median(distance, axis=1, keepdims=True), 0.01 * template.diameter)
        weight = 1.0 / (1.0 + (distance / (2 * spread)) ** 2) ** 2  # Geman and McClure's
        x = small_motions(local, index, weight, template, 7 if free_scale else 6)
        states = moved_states(states, template.center, x, (low, high))
    return states


def small_motions(
    local: Array, index: NDArray[np.intp], weight: Array, template: MeshTemplate, unknowns: int = 6
) -> Array:
    """Return the motions that bring points onto the planes of their matched points, and weakly onto these points.

    Args:
        local: Observed points in the frame of the mesh [m], shape (n, p, 3).
        index: Indices of the matched points of the mesh, shape (n, p).
        weight: Weights of the matches, shape (n, p).
        template: The mesh.
        unknowns: 6, or 7 to scale the mesh as well.

    Returns:
        Small rotations [rad] and translations [m] of the observed points about the center of the mesh, and logarithms
        of their scale, shape (n, unknowns).
    """
    normal, offset = template.normals[index], local - template.points[index]
    lever = local - template.center
    along = [np.cross(lever, normal), normal, (lever * normal).sum(axis=2, keepdims=True)]
    slopes = np.concatenate(along, axis=2)[:, :, :unknowns]
    normal_matrix = np.einsum("np,npi,npj->nij", weight, slopes, slopes)
    b = -np.einsum("np,npi,np->ni", weight, slopes, (offset * normal).sum(axis=2))
    for axis in range(3):  # the distance between points, one axis after the other
        unit = np.broadcast_to(np.eye(3)[axis], lever.shape)
        slopes = np.concatenate([np.cross(lever, unit), unit, lever[:, :, axis, None]], axis=2)[:, :, :unknowns]
        normal_matrix += POINT_WEIGHT * np.einsum("np,npi,npj->nij", weight, slopes, slopes)
        b -= POINT_WEIGHT * np.einsum("np,npi,np->ni", weight, slopes, offset[:, :, axis])
    normal_matrix += np.eye(unknowns) * (1e-6 * np.trace(normal_matrix, axis1=1, axis2=2))[:, None, None]
    return np.asarray(np.linalg.solve(normal_matrix, b[:, :, None])[:, :, 0])


def moved_states(state: States, center: Array, x: Array, limits: tuple[Array, Array]) -> States:
    """Apply small motions of the observed points in the frame of the mesh about its center, shape (n, 6 or 7)."""
    turns, shifts, scale = state
    # The points move by the motion, so that the mesh moves by its inverse.
    turn = rotations_about(x[:, :3])
    turns_new = np.einsum("nij,nkj->nik", turns, turn)
    factor = np.exp(-x[:, 6]) if x.shape[1] == 7 else np.ones(len(x))
    scale_new = np.clip(scale * factor, *limits)
    # A point q of the mesh's frame becomes turn (q - center) scale / scale_new + center + shift.
    target = np.einsum("nij,nj->ni", turns, center * scale[:, None]) + shifts
    moved_center = np.einsum("nij,nj->ni", turns_new, center + x[:, 3:6])
    return turns_new, target - scale_new[:, None] * moved_center, scale_new


def rotations_about(vectors: Array) -> Array:
    """Return the rotations about vectors by their lengths [rad], shape (n, 3, 3)."""
    angle = np.linalg.norm(vectors, axis=1)
    limited = np.minimum(angle, 0.5)  # a linear step is not valid beyond
    axis = vectors / np.maximum(angle, 1e-12)[:, None]
    K = np.zeros((len(vectors), 3, 3))
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -axis[:, 2], axis[:, 1], -axis[:, 0]
    K -= K.transpose(0, 2, 1)
    sine, cosine = np.sin(limited)[:, None, None], np.cos(limited)[:, None, None]
    return np.asarray(np.eye(3) + sine * K + (1 - cosine) * (K @ K))


def point_distances(cloud: VisibleCloud, template: MeshTemplate, states: States) -> Array:
    """Return the trimmed mean distance of observed points from the matched points in meters, shape (n,)."""
    local, index = closest_points(cloud.points, cloud.normals, template, states, surface_tree(template))
    return _trimmed_mean(np.linalg.norm(local - template.points[index], axis=2)) * states[2]


def _trimmed_mean(distance: Array) -> Array:
    """Return the mean of the smallest nine tenths of the distances in each row."""
    ordered = np.sort(distance, axis=1)
    return np.asarray(ordered[:, : max(1, int(0.9 * distance.shape[1]))].mean(axis=1))
