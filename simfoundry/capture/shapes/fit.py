"""Fit the closed solid that stands on the support and best explains the visible points of an object."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from simfoundry.assets import mass
from simfoundry.assets.mesh import open_edges
from simfoundry.capture.frame import CaptureError, Frame, SupportSurface
from simfoundry.capture.segment.masks import Labels, Mask
from simfoundry.capture.shapes.complete import complete
from simfoundry.capture.shapes.evidence import Evidence, FitCandidate, RayAgreement, gather
from simfoundry.capture.shapes.fit_handle import FittedHandle, with_handle
from simfoundry.capture.shapes.fit_lathe import fit_hollow, fit_lathe
from simfoundry.capture.shapes.fit_leaning import fit_leaning_box
from simfoundry.capture.shapes.fit_open_box import fit_open_box
from simfoundry.capture.shapes.fit_primitives import fit_box, fit_cylinder, fit_lying_cylinder, fit_sphere
from simfoundry.capture.shapes.fit_relief import fit_mirrored_relief, fit_relief
from simfoundry.capture.shapes.fit_tilted import fit_tilted, fit_tilted_hollow
from simfoundry.capture.shapes.mesh_template import simplified_surface
from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.shapes import Geometry, Mesh, closed_mesh, tessellate

MIN_POINTS = 12  # minimum number of points: twice the number of parameters of a box
FEW_POINTS = 50  # with fewer points than this, a curved side cannot be distinguished from noise
OVERSIZE = 2.0  # maximum size relative to the visible part; a nearly flat side could be part of a huge cylinder
GAIN = 0.03  # minimum fraction of the object that a completed shape must explain in addition to a simple one

MAX_ALTERNATIVES = 2  # each one that is tried costs a settling of the entire scene
# Least decrease of the cost beyond the prior for which a completed shape is chosen all the same. Among 21 isolated YCB
# objects, a box or a cylinder that is right never costs 0.1 more.
COST_GAIN = 0.1

# Cost of the best simple solid above which bodies about tilted axes are tried, which takes 0.7 s. The right solid of a
# can or a carton costs less.
POOR = 0.34

# Largest number of triangles of a solid that follows the visible points. A height field has up to 13,000, most of which
# follow noise: its convex parts are found in a quarter of the time with 1200, and are as near (7.7 instead of 8.3 mm).
MOST_FACES = 1200

# Largest change of the volume of a solid by which it is not another shape: less than a depth error of 1 mm makes of an
# object that is 3 cm high.
SAME_VOLUME = 0.03

# Least share of the visible points that a CAD model must explain, and largest intrusion, to be a candidate at all. A
# region that contains another object, too, is explained less: 0.72 of a carton with a drill before it. Of 21 isolated
# YCB objects whose own model is missing from the library, one becomes another model, which explains 0.71 of it.
EXPLAINED, INTRUDES = 0.7, 0.1

# Families whose shape follows the visible points.
FLEXIBLE = frozenset({"completed", "relief", "mirrored"})

# Families of open containers.
HOLLOW = frozenset({"hollow", "tilted_hollow", "open_box"})

# Families of shapes with a level base, which stand if anything does.
STABLE = frozenset({"box", "cylinder", "lathe", "hollow", "open_box"})


@dataclass(frozen=True, eq=False)
class FittedShape:
    """A solid fitted to one object.

    Attributes:
        geometry: A primitive or a closed mesh.
        X_WO: Pose of the solid in the world. The origin is the center of the bounding box for a primitive, and the
            center of the base (z up) for a mesh.
        fit_m: Median distance of the object's visible points from the surface [m].
        confidence: Confidence in the fit, in [0, 1]. See :func:`confidence`.
        hollow: True for an open container that is modeled with its cavity.
        profile: Pairs (radius, height) [m], shape (k, 2), or None if the mesh is not a body of revolution.
        alternatives: The next best solids, which replace this one if it does not come to rest.
        model: Name of the CAD model that it is, or an empty string.
        wall: Thickness of the floor and the walls of a box without a lid [m], whose frame is at the middle of its
            outside, or 0 for other solids.
        handle: The handle of a body of revolution, whose mesh includes it, or None.
    """

    geometry: Geometry
    X_WO: Pose
    fit_m: float
    confidence: float
    hollow: bool
    profile: Array | None = None
    alternatives: tuple[FittedShape, ...] = ()
    model: str = ""
    wall: float = 0.0
    handle: FittedHandle | None = None


# Returns further candidates for the evidence, such as CAD models.
Suggest = Callable[[Evidence], list[FitCandidate]]


def fit_shape(
    frame: Frame,
    support: SupportSurface,
    mask: Mask,
    base_z: float,
    *,
    labels: Labels | None = None,
    suggest: Suggest | None = None,
) -> FittedShape:
    """Fit the solid that best explains the object under ``mask``, a bool array of shape (h, w).

    Args:
        frame: The RGB-D frame.
        support: The surface that supports the objects.
        mask: The object's pixels.
        base_z: Height in the world of the surface on which the object stands [m].
        labels: Labels of all objects in the image (int32, shape (h, w)). If they are specified, pixels of other objects
            without depth are treated as unknown rather than free.
        suggest: Returns further candidates, which are judged like the others.

    Raises:
        CaptureError: Fewer than ``MIN_POINTS`` pixels have depth.
    """
    if mask.shape != frame.depth.shape:
        raise ValueError(f"a mask of shape {mask.shape} does not match an image of shape {frame.depth.shape}")
    count = int((mask & np.isfinite(frame.depth)).sum())
    if count >= MIN_POINTS:
        evidence = gather(frame, support, mask, base_z, labels)
        count = len(evidence.points)
    if count < MIN_POINTS:
        message = f"an object has depth at only {count} pixels; fitting a shape requires {MIN_POINTS}"
        hint = "provide a mask for it, move the camera closer, or leave the object out"
        raise CaptureError("SF505", message, hint)
    found = [with_handle(candidate, evidence) for candidate in candidates(evidence)]
    known = [] if suggest is None else [c for c in suggest(evidence) if _is_likely(c.agreement)]
    best = choose([*(c for c in found if _is_plausible(c, evidence)), *known] or [fit_box(evidence)])
    others = sorted((c for c in found if c is not best and c.family in STABLE), key=lambda c: c.cost)
    kept = [*others[:MAX_ALTERNATIVES], *(c for c in known if c is not best)]
    return replace(_fitted(best, evidence), alternatives=tuple(_fitted(c, evidence) for c in kept))


def _is_plausible(candidate: FitCandidate, evidence: Evidence) -> bool:
    """Return True if a solid is not much larger than the visible part of the object."""
    reach = OVERSIZE * float(np.ptp(evidence.points, axis=0).max()) + evidence.scale
    return max(size_of(candidate.geometry)) <= reach


def _is_likely(result: RayAgreement) -> bool:
    """Return True if a CAD model may be the object, and not only resemble a part of it."""
    return result.explained > EXPLAINED and result.intrusion < INTRUDES


def _fitted(candidate: FitCandidate, evidence: Evidence) -> FittedShape:
    fit_m = candidate.agreement.fit if math.isfinite(candidate.agreement.fit) else evidence.scale
    hollow = candidate.family in HOLLOW
    sure, one = confidence(candidate, evidence), candidate
    geometry = one.geometry
    if one.family in FLEXIBLE and isinstance(geometry, Mesh):
        geometry = lighter_mesh(geometry)
    return FittedShape(geometry, one.X_WO, fit_m, sure, hollow, one.profile, (), one.model, one.wall, one.handle)


def lighter_mesh(mesh: Mesh) -> Mesh:
    """Return a closed mesh of about :data:`MOST_FACES` triangles, or the same mesh if its shape would change."""
    if len(mesh.faces) <= MOST_FACES:
        return mesh
    vertices, faces = simplified_surface(mesh.vertices, mesh.faces, MOST_FACES)
    vertices[:, 2] = np.maximum(vertices[:, 2], mesh.vertices[:, 2].min())  # its base remains level
    before, after = mass.mesh(mesh.vertices, mesh.faces).volume, mass.mesh(vertices, faces).volume
    if open_edges(faces) or abs(after - before) > SAME_VOLUME * abs(before):
        return mesh
    return closed_mesh(vertices, faces)


def choose(found: list[FitCandidate]) -> FitCandidate:
    """Return the candidate with the lowest cost.

    A completed shape follows every dent. Even for a slightly bulging carton, its residuals are therefore smaller than
    those of a box. It is chosen only if it explains clearly more than the best simple shape, or costs clearly less, as
    for a flat tool, whose box is too thin for its intrusion to be told from noise.
    """
    best = min(found, key=lambda c: c.cost)
    simple = min((c for c in found if c.family not in FLEXIBLE), key=lambda c: c.cost, default=best)
    new, old = (c.agreement.explained - c.agreement.intrusion for c in (best, simple))
    return best if new - old >= GAIN or best.cost < simple.cost - COST_GAIN else simple


# Fits of solids that do not follow the visible points: those that take little time or are often right come first.
RIGID = (
    fit_cylinder,
    fit_sphere,
    fit_hollow,
    fit_box,
    fit_lathe,
    fit_lying_cylinder,
    fit_open_box,
    fit_leaning_box,
)


def candidates(evidence: Evidence) -> list[FitCandidate]:
    """Fit every family of shapes that the evidence supports.

    If there are only a few points, these families are boxes and cylinders. The search for a solid ends early if it is
    not expected to cost less than the best one before.
    """
    few, found = (fit_cylinder, fit_box), list[FitCandidate]()
    for fit in RIGID if len(evidence.points) >= FEW_POINTS else few:
        one = fit(evidence, min((c.cost for c in found if _is_plausible(c, evidence)), default=math.inf))
        found += [] if one is None else [one]
    if len(evidence.points) < FEW_POINTS:
        return found
    found += filter(None, (fit(evidence) for fit in (complete, fit_relief, fit_mirrored_relief)))
    if min(c.cost for c in found if c.family not in FLEXIBLE) > POOR:
        found += filter(None, (fit(evidence) for fit in (fit_tilted, fit_tilted_hollow)))
    return found


# Scores of agreement, and the F1 scores at 1 cm of solids with these scores, on 114 objects of 18 synthetic tables
# (`python -m tests.corpora.confidence --fit`): the two below 0.5 were wrong, and of 110 above 0.65 one was.
CALIBRATION = ((0.0, 0.3, 0.55, 0.65, 0.8, 1.0), (0.0, 0.23, 0.66, 0.93, 0.95, 1.0))


def confidence(candidate: FitCandidate, evidence: Evidence) -> float:
    """Return the confidence in a fit, in [0, 1]: the F1 score at 1 cm of solids with the same score of agreement."""
    return float(np.interp(agreement_score(candidate, evidence), *CALIBRATION))


def agreement_score(candidate: FitCandidate, evidence: Evidence) -> float:
    """Return how well a fit agrees with what was seen, in [0, 1].

    The score is the product of five factors:

    - the fraction of measured pixels explained within the noise scale
    - the fraction of rays without intrusion into free space
    - ``exp(-fit / (5% of the size))``
    - ``min(1, sqrt(points / 400))``
    - 0.6 if a prior supplied an extent that was not visible, 0.7 for a completed shape (because its entire far side is
      a guess), and otherwise 1
    """
    result = candidate.agreement
    size = float(np.ptp(evidence.points, axis=0).max())
    fit = math.exp(-result.fit / max(0.05 * size, 1e-6)) if math.isfinite(result.fit) else 0.0
    unseen = 0.6 if candidate.guessed else 0.7 if candidate.family in FLEXIBLE else 1.0
    enough = min(1.0, math.sqrt(len(evidence.points) / 400))
    value = result.explained * max(0.0, 1.0 - result.intrusion) * fit * enough * unseen
    return float(min(1.0, max(0.0, value)))


def size_of(geometry: Geometry) -> tuple[float, ...]:
    """Return the extents of the bounding box of a geometry in its own frame [m]."""
    return tuple(np.ptp(tessellate(geometry).vertices, axis=0).tolist())
