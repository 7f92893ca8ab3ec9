"""Find models of a library in pixels of an image, whatever regions these belong to."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.cad.library import CadLibrary, CadModel
from simfoundry.capture.cad.pair_features import PairFeatures, spread_points
from simfoundry.capture.cad.placed_model import SATURATION, ObservedScene, color_shares
from simfoundry.capture.segment.masks import Mask
from simfoundry.capture.shapes.closest_points import States, closest_points, moved_states, small_motions, surface_tree
from simfoundry.capture.shapes.mesh_template import MeshTemplate
from simfoundry.capture.shapes.visible_cloud import visible_normals
from simfoundry.geometry.frames import Array, Pose

# Distances between observed points [m]: of those in which models are found, and of those to which planes are fitted,
# within a reach that is smaller than most sides of objects.
SPACING, DENSE, REACH = 0.005, 0.002, 0.012

# Fewest observed points in which a model is found: 5 cm².
FEWEST_POINTS = 20

# Number of observed points that are compared with all of their neighbors, at least, as a share, and at most.
LEAST_REFERENCES, REFERENCES, MOST_REFERENCES = 40, 1 / 6, 150

# An observed point may belong to a model if at least this share of the points of the model has its color, within this
# distance. It is generous, because light is colored.
PALETTE_SHARE, PALETTE_REACH = 0.01, 0.06

# Poses of a model that are judged, those of most votes, by this number of points; the best of them that are moved onto
# the observed points, and are then judged by more; and the poses that are returned.
JUDGED, FEW, MOVED, MANY, BEST = 600, 150, 20, 500, 3

# Two poses are one if they are closer than this [m], [rad].
SAME_M, SAME_RAD = 0.012, 0.25

# Rounds in which a pose is moved, the distance up to which points are matched in the first one [m], and how much less
# in the last; the least cosine between matched normals; and the number of observed points.
ROUNDS, NEAR, CLOSER, ALIKE, NEIGHBORS = 6, 0.02, 0.6, 0.7, 400

# Turns about each axis of a model by which its color may show how it is turned, if its shape does not, and the share of
# its visible part that must gain the right color.
SPINS, SPIN_WORTH = 24, 0.05

# What counts against the pixels that a pose explains: a pixel of another color, one that it contradicts, and a depth
# below the support [m], beyond the first number.
DISCOLORED, MISSED, SUNK_FROM, SUNK = 0.5, 4.0, 0.01, 2e4


@dataclass(frozen=True, eq=False)
class LocatedModel:
    """A model at a pose that explains pixels of an image. ``worth`` is their number, less what counts against it."""

    model: CadModel
    template: MeshTemplate
    X_WO: Pose
    worth: float


def located_models(scene: ObservedScene, library: CadLibrary, asked: Mask) -> list[LocatedModel]:
    """Return models at poses that explain some of the pixels asked for, the best first.

    Args:
        scene: The image.
        library: The models.
        asked: Pixels that no model explains yet, shape (h, w).
    """
    cloud = _Cloud.of(scene, asked)
    out = []
    if cloud is not None:
        for model in library.models:
            template = library.template(model)
            if template is not None:
                out += [
                    LocatedModel(model, template, X_WO, worth) for X_WO, worth in _poses(scene, cloud, template, asked)
                ]
    return sorted(out, key=lambda one: -one.worth)


def turned_by_color(scene: ObservedScene, template: MeshTemplate, X_WO: Pose, asked: Mask) -> Pose:
    """Return the pose at which a model has the colors of the image, turned about one of the axes through its center.

    Depth does not show how a can or a carton is turned about its axes of symmetry.
    """
    if template.colors is None:
        return X_WO
    angles = np.arange(SPINS) * (2 * math.pi / SPINS)
    turns = [Pose.about(axis, float(angle)).rotation for axis in np.eye(3) for angle in angles]
    turned = X_WO.rotation @ np.array(turns)
    shift = X_WO.apply(template.center) - turned @ template.center
    worth = _worth(scene, template, (turned, shift, np.ones(len(turned))), asked, MANY)
    best = int(np.argmax(worth))
    seen = scene.agreement(template, turned[:1], shift[:1], asked, MANY)
    if worth[best] <= worth[0] + SPIN_WORTH * float(seen.right[0] + seen.discolored[0]):
        return X_WO
    return Pose.of(shift[best], Pose.from_matrix(turned[best]).q)


@dataclass(frozen=True, eq=False)
class _Cloud:
    """Observed points [m], their normals and their colors, all of shape (n, 3)."""

    points: Array
    normals: Array
    hues: Array

    @classmethod
    def of(cls, scene: ObservedScene, asked: Mask) -> _Cloud | None:
        known = np.isfinite(scene.frame.depth)
        points, surface = scene.points_W[asked & known], scene.points_W[scene.standing & known]
        if len(points) < FEWEST_POINTS:
            return None
        kept = spread_points(points, SPACING)
        dense = surface[spread_points(surface, DENSE)]
        normals = visible_normals(points[kept], dense, scene.support.X_WC.p, REACH)
        return cls(points[kept], normals, scene.hues[asked & known][kept])

    def like(self, template: MeshTemplate) -> _Cloud:
        """Return the points that have a color of the model."""
        from scipy.spatial import cKDTree

        if template.colors is None:
            return self
        pure = color_shares(template.colors)[:, :2] - 1 / 3
        palette = cKDTree(np.vstack([1 / 3 + factor * pure for factor in np.linspace(*SATURATION, 3)]))
        count = palette.query_ball_point(self.hues[:, :2], PALETTE_REACH, return_length=True)
        alike = count >= PALETTE_SHARE * len(template.points)
        return _Cloud(self.points[alike], self.normals[alike], self.hues[alike])


def _poses(scene: ObservedScene, cloud: _Cloud, template: MeshTemplate, asked: Mask) -> list[tuple[Pose, float]]:
    """Return the best poses of one model, and their worth."""
    own = cloud.like(template)
    if len(own.points) < FEWEST_POINTS:
        return []
    count = min(len(own.points), MOST_REFERENCES, max(LEAST_REFERENCES, int(REFERENCES * len(own.points))))
    references = np.linspace(0, len(own.points) - 1, count).astype(np.int64)
    _, rotations, translations = PairFeatures.of(template).poses(own.points, own.normals, references)
    if not len(rotations):
        return []
    states = rotations[:JUDGED], translations[:JUDGED], np.ones(len(rotations))[:JUDGED]
    order = np.argsort(-_worth(scene, template, states, asked, FEW), kind="stable")
    best = _distinct(template, states, order)
    states = _moved(cloud, template, (states[0][best], states[1][best], states[2][best]))
    worth = _worth(scene, template, states, asked, MANY)
    return [(Pose.of(states[1][k], Pose.from_matrix(states[0][k]).q), float(worth[k]))
            for k in np.argsort(-worth, kind="stable")[:BEST]]  # fmt: skip


def pose_worth(scene: ObservedScene, template: MeshTemplate, X_WO: Pose, asked: Mask) -> float:
    """Return the number of pixels asked for that a model at a pose explains, less what counts against it."""
    states = X_WO.rotation[None], X_WO.p[None], np.ones(1)
    return float(_worth(scene, template, states, asked, len(template.points))[0])


def _worth(scene: ObservedScene, template: MeshTemplate, states: States, asked: Mask, count: int) -> Array:
    rotations, translations, _ = states
    found = scene.agreement(template, rotations, translations, asked, count)
    low = (template.points @ rotations[:, 2, :].T).min(axis=0) + translations[:, 2]
    sunk = SUNK * np.maximum(0.0, -low - SUNK_FROM)
    return np.asarray(found.right - DISCOLORED * found.discolored - MISSED * found.missed - sunk)


def _distinct(template: MeshTemplate, states: States, order: NDArray[np.intp]) -> list[int]:
    """Return the first of some poses that differ from each other."""
    rotations, translations, _ = states
    center = rotations @ template.center + translations
    out: list[int] = []
    for k in order:
        turned = (np.einsum("nij,ij->n", rotations[out], rotations[k]) - 1) / 2 > math.cos(SAME_RAD)
        if not (turned & (np.linalg.norm(center[out] - center[k], axis=1) < SAME_M)).any():
            out.append(int(k))
        if len(out) == MOVED:
            break
    return out


def _moved(cloud: _Cloud, template: MeshTemplate, states: States) -> States:
    """Move poses onto the observed points around them; points that are far off belong to other objects."""
    from scipy.spatial import cKDTree

    tree, around = surface_tree(template), cKDTree(cloud.points)
    chosen, used = np.zeros((len(states[0]), NEIGHBORS), np.int64), np.zeros((len(states[0]), NEIGHBORS), bool)
    for k, center in enumerate(states[0] @ template.center + states[1]):
        near = np.array(around.query_ball_point(center, template.diameter / 2 + NEAR, return_sorted=True), np.int64)
        near = near[np.linspace(0, len(near) - 1, min(len(near), NEIGHBORS)).astype(np.int64)]
        chosen[k, : len(near)], used[k, : len(near)] = near, True
    points, normals = cloud.points[chosen], cloud.normals[chosen]
    for done in range(ROUNDS):
        reach = NEAR * (1 - CLOSER * done / ROUNDS)
        local, index = closest_points(points, normals, template, states, tree)
        distance = np.linalg.norm(local - template.points[index], axis=2)
        alike = np.einsum("nji,npj,npi->np", states[0], normals, template.normals[index]) > ALIKE
        weight = np.where(used & alike & (distance < reach), 1 / (1 + (distance / (0.3 * reach)) ** 2), 0.0)
        weight[weight.sum(axis=1) < FEWEST_POINTS / 2] = 0.0
        some = np.flatnonzero(weight.any(axis=1))
        if len(some):
            x = small_motions(local[some], index[some], weight[some], template)
            size = np.ones(len(some))
            moved = moved_states((states[0][some], states[1][some], size), template.center, x, (size, size))
            for whole, part in zip(states, moved, strict=True):
                whole[some] = part
    return states
