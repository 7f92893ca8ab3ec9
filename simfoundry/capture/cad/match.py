"""Find the model of a library that an object in an image is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simfoundry.capture.cad.library import CadLibrary, CadModel
from simfoundry.capture.shapes.evidence import Evidence, FitCandidate
from simfoundry.capture.shapes.mesh_template import MeshTemplate
from simfoundry.capture.shapes.register_mesh import (
    RegistrationEffort,
    misplacement,
    pose_agreement,
    refine_registration,
    register_mesh,
)
from simfoundry.geometry.frames import Pose

# A first look at each model takes 50 ms of processor time. Of 29 YCB objects, alone and in piles, it ranked the right
# one first for 28; thorough registrations decide among the best.
FIRST_LOOK = RegistrationEffort(yaws=8, points=50, rounds=5, judged=4, rays=300, refined=0)
FINALISTS = 3

# Largest cost after the first look, beyond that of the best model registered so far, for which a model is registered
# thoroughly. The cost of the right model decreases by 0.05 on average.
STILL_LIKELY = 0.15

# A model that explains at least this share of the points of an object, and intrudes no more than this, is preferred to
# a solid whose cost is less by up to the third number: the sizes of a solid follow the errors of the depth, and those
# of a model do not. All but one of 42 isolated YCB objects are explained so well by their own model, and none of 21 by
# another one. In real pictures, the right model of a carton costs 0.04 more than a box.
EXPLAINS_ALL, INTRUDES_NOWHERE, WORTH = 0.95, 0.02, 0.06

# A model is not larger than its visible part requires: tolerances of its diameter, and of its silhouette if all of it
# is visible, relative to the silhouettes of its convex hull. A mug's handle or a clamp fills half of its hull.
DIAMETER_SLACK, LEAST_SILHOUETTE, MOST_SILHOUETTE = 1.08, 0.35, 1.25

# Largest share of the rays around an object that end on others, for its silhouette to be that of all of it.
WHOLE_SHARE = 0.03


@dataclass(frozen=True, eq=False)
class ModelMatch:
    """A model of a library at a pose.

    Attributes:
        model: Name of the model.
        X_WO: Its pose in the world.
        cost: The cost of its registration.
        is_sure: True if it agrees with the image wherever it is visible.
    """

    model: str
    X_WO: Pose
    cost: float
    is_sure: bool = False


@dataclass(frozen=True, eq=False)
class CadLookup:
    """Candidates for the fit of an object, from a CAD library.

    If ``known`` states which model the object is and about where, no other model is registered.
    """

    library: CadLibrary
    known: ModelMatch | None = None

    def candidates(self, evidence: Evidence) -> list[FitCandidate]:
        """Return the model that explains the evidence best, at its pose, if any is likely."""
        if self.known is None:
            found = best_match(evidence, self.library)
        else:
            found = self.known if self.known.is_sure else self._refined(evidence, self.known)
        if found is None:
            return []
        mesh = self.library.mesh(self.library.named(found.model))
        result = pose_agreement(evidence, (mesh.vertices, mesh.faces), found.X_WO)
        low = float(found.X_WO.apply(mesh.vertices)[:, 2].min())
        penalty = misplacement(evidence, low)
        if result.explained >= EXPLAINS_ALL and result.intrusion <= INTRUDES_NOWHERE:
            penalty -= WORTH
        return [FitCandidate("cad", mesh, found.X_WO, result, model=found.model, penalty=penalty)]

    def base_z(self, stated: float) -> float:
        """Return the height on which the object stands [m]: that of its model if this is sure, or else ``stated``."""
        template = None
        if self.known is not None and self.known.is_sure:
            template = self.library.template(self.library.named(self.known.model))
        if self.known is None or template is None:
            return stated
        return max(0.0, float(self.known.X_WO.apply(template.vertices)[:, 2].min()))

    def _refined(self, evidence: Evidence, known: ModelMatch) -> ModelMatch | None:
        template = self.library.template(self.library.named(known.model))
        if template is None:
            return None
        found = refine_registration(evidence, template, known.X_WO)
        return ModelMatch(known.model, found.X_WO, found.cost)


def best_match(evidence: Evidence, library: CadLibrary) -> ModelMatch | None:
    """Return the library model that explains the evidence best, or None if no model has a plausible size."""
    looked: list[tuple[float, CadModel, MeshTemplate]] = []
    for model in library.models:
        template = library.template(model)
        if template is not None and is_plausible(evidence, template):
            cost = register_mesh(evidence, template, effort=FIRST_LOOK).cost
            looked.append((cost, model, template))
    looked.sort(key=lambda each: (each[0], each[1].name))
    best: ModelMatch | None = None
    for cost, model, template in looked[:FINALISTS]:
        if best is None or cost <= best.cost + STILL_LIKELY:
            found = register_mesh(evidence, template)
            if best is None or found.cost < best.cost:
                best = ModelMatch(model.name, found.X_WO, found.cost)
    return best


def is_plausible(evidence: Evidence, template: MeshTemplate) -> bool:
    """Return True if the visible part of an object is neither too large nor too small for a model."""
    points = evidence.points
    spread = float(np.linalg.norm(points - np.median(points, axis=0), axis=1).max())
    if spread > DIAMETER_SLACK * template.diameter + 2 * evidence.scale:
        return False
    area = visible_area(evidence)
    low, high = template.silhouettes
    if area > MOST_SILHOUETTE * high:
        return False
    is_whole = float(evidence.hidden.mean()) < WHOLE_SHARE
    return not is_whole or area > LEAST_SILHOUETTE * low


def visible_area(evidence: Evidence) -> float:
    """Return the area of the visible part of an object, seen from the camera [m²]."""
    mask = evidence.inside & np.isfinite(evidence.depth)
    if not mask.any():
        return 0.0
    # Rays of a regular grid have equal areas on the plane at depth 1.
    rays = evidence.rays @ evidence.support.X_WC.rotation
    x, y = np.unique(rays[:, 0].round(9)), np.unique(rays[:, 1].round(9))
    cell = float(np.median(np.diff(x)) * np.median(np.diff(y))) if len(x) > 1 and len(y) > 1 else 0.0
    share = evidence.inside.sum() / mask.sum()
    return float(cell * (evidence.depth[mask] ** 2).sum() * share)
