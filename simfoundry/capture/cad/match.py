"""Find the model of a library that an object in an image is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simfoundry.capture.cad.library import CadLibrary, CadModel
from simfoundry.capture.shapes.evidence import Evidence, FitCandidate
from simfoundry.capture.shapes.mesh_template import MeshTemplate
from simfoundry.capture.shapes.register_mesh import RegistrationEffort, pose_agreement, register_mesh

# A first look at each model takes 50 ms of processor time. Of 29 YCB objects, alone and in piles, it ranked the right
# one first for 28; thorough registrations decide among the best.
FIRST_LOOK = RegistrationEffort(yaws=8, points=50, rounds=5, judged=4, rays=300, refined=0)
FINALISTS = 3

# Largest cost beyond that of the best model after the first look for which a model is registered thoroughly. The cost
# of the right model decreases by 0.05 on average, and by 0.25 at most.
STILL_LIKELY = 0.25

# A model is not larger than its visible part requires: tolerances of its diameter, and of its silhouette if all of it
# is visible, relative to the silhouettes of its convex hull. A mug's handle or a clamp fills half of its hull.
DIAMETER_SLACK, LEAST_SILHOUETTE, MOST_SILHOUETTE = 1.08, 0.35, 1.25

# Largest share of the rays around an object that end on others, for its silhouette to be that of all of it.
WHOLE_SHARE = 0.03


@dataclass(frozen=True, eq=False)
class CadLookup:
    """Candidates for the fit of an object, from a CAD library."""

    library: CadLibrary

    def candidates(self, evidence: Evidence) -> list[FitCandidate]:
        """Return the model that explains the evidence best, at its pose, if any is likely."""
        found = best_match(evidence, self.library)
        return [] if found is None else [found]


def best_match(evidence: Evidence, library: CadLibrary) -> FitCandidate | None:
    """Return the library model that explains the evidence best, or None if no model has a plausible size."""
    looked: list[tuple[float, CadModel, MeshTemplate]] = []
    for model in library.models:
        template = library.template(model)
        if template is not None and is_plausible(evidence, template):
            cost = register_mesh(evidence, template, effort=FIRST_LOOK).cost
            looked.append((cost, model, template))
    looked.sort(key=lambda each: (each[0], each[1].name))
    likely = [each for each in looked[:FINALISTS] if each[0] <= looked[0][0] + STILL_LIKELY]
    found = [(register_mesh(evidence, template), model) for _, model, template in likely]
    if not found:
        return None
    best, model = min(found, key=lambda each: (each[0].cost, each[1].name))
    mesh = library.mesh(model)
    result = pose_agreement(evidence, (mesh.vertices, mesh.faces), best.X_WO)
    return FitCandidate("cad", mesh, best.X_WO, result, model=model.name, penalty=best.cost - best.agreement.cost)


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
