"""Fitting of the closed solid that best explains one object's visible points and stands on its support."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import CaptureError, Frame, SupportSurface
from simfoundry.capture.shapes.complete import complete
from simfoundry.capture.shapes.evidence import Evidence, RayAgreement, gather
from simfoundry.capture.shapes.fit_lathe import LatheFit, fit_hollow, fit_lathe
from simfoundry.capture.shapes.fit_primitives import fit_box, fit_cylinder, fit_lying_cylinder, fit_sphere
from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.shapes import Box, Cylinder, Geometry, Mesh, Sphere, revolved

MIN_POINTS = 12  # points: twice the parameters of a box
PROFILE_STEP = 0.0007  # half the depth noise of a good sensor at half a meter [m]
FEW_POINTS = 50  # points: fewer do not tell a curved side from noise
LATHE_SIDES = 32  # sides of a solid of revolution: 0.5 % short of the circle
OVERSIZE = 2.0  # times what was seen: a nearly flat side would pass for a piece of a huge cylinder

# Gain in cost that a family needs over an upright box or cylinder to be chosen. The more freely a family
# follows the points, the less its lower cost says.
PRIOR = {"box": 0.0, "cylinder": 0.0, "sphere": 0.02, "lying": 0.08, "hollow": 0.02, "lathe": 0.06, "completed": 0.14}

GAIN = 0.03  # share of the object that a completed shape must explain beyond a simple one


@dataclass(frozen=True, eq=False)
class FittedShape:
    """A solid fitted to one object.

    ``geometry`` is a primitive, or a closed mesh; ``X_WO`` its pose in the world, with the origin at the center of the
    bounding box for primitives and at the center of the base, z up, for meshes; ``fit_m`` the median distance of the
    object's visible points from the surface [m]; ``confidence`` in [0, 1], see :func:`confidence`; ``hollow`` says that
    it is an open container modeled with its cavity; ``profile`` (radius, height) [m], shape (k, 2), is there where the
    mesh is a body of revolution.
    """

    geometry: Geometry
    X_WO: Pose
    fit_m: float
    confidence: float
    hollow: bool
    profile: Array | None = None


@dataclass(frozen=True, eq=False)
class FitCandidate:
    """One family's best solid; ``guessed`` if a prior supplied an extent that was not seen."""

    family: str
    geometry: Geometry
    X_WO: Pose
    agreement: RayAgreement
    guessed: bool = False
    profile: Array | None = None

    @property
    def cost(self) -> float:
        """The cost that candidates compete by."""
        return self.agreement.cost + PRIOR[self.family]


def fit_shape(
    frame: Frame,
    support: SupportSurface,
    mask: NDArray[np.bool_],
    base_z: float,
    *,
    labels: NDArray[np.int32] | None = None,
) -> FittedShape:
    """Fit the solid that best explains the object under ``mask`` (bool, shape (h, w)).

    It stands on ``base_z`` [m], the height of the surface below it in the world. ``labels`` (int32, shape (h, w)) marks
    all objects of the picture: pixels of the others are then unknown, where they have no depth, rather than free.
    Raises :class:`CaptureError` if fewer than ``MIN_POINTS`` pixels have depth.
    """
    if mask.shape != frame.depth.shape:
        raise ValueError(f"a mask of shape {mask.shape} does not match a picture of shape {frame.depth.shape}")
    if int((mask & np.isfinite(frame.depth)).sum()) < MIN_POINTS:
        raise _too_few(int((mask & np.isfinite(frame.depth)).sum()))
    evidence = gather(frame, support, mask, base_z, labels)
    if len(evidence.points) < MIN_POINTS:
        raise _too_few(len(evidence.points))
    reach = OVERSIZE * float(np.ptp(evidence.points, axis=0).max()) + evidence.scale
    found = candidates(frame, support, evidence)
    best = choose([c for c in found if max(size_of(c.geometry)) <= reach] or found[:1])
    return FittedShape(
        geometry=best.geometry,
        X_WO=best.X_WO,
        fit_m=best.agreement.fit if math.isfinite(best.agreement.fit) else evidence.scale,
        confidence=confidence(best, evidence),
        hollow=best.family == "hollow",
        profile=best.profile,
    )


def choose(found: list[FitCandidate]) -> FitCandidate:
    """Choose the cheapest candidate; a completed shape only if it explains clearly more than the best simple one.

    It follows every dent, so its residuals are smaller than those of a carton that bulges a little.
    """
    best = min(found, key=lambda c: c.cost)
    simple = min((c for c in found if c.family != "completed"), key=lambda c: c.cost, default=best)
    return simple if _net(best.agreement) - _net(simple.agreement) < GAIN else best


def _net(result: RayAgreement) -> float:
    return result.explained - result.intrusion


def candidates(frame: Frame, support: SupportSurface, evidence: Evidence) -> list[FitCandidate]:
    """Fit every family that the evidence can support; few points support boxes and cylinders only."""
    box, cylinder = fit_box(evidence), fit_cylinder(evidence)
    found = [
        FitCandidate("box", box.box, box.X_WO, box.agreement, box.guessed_depth),
        FitCandidate("cylinder", cylinder.shape, cylinder.X_WO, cylinder.agreement),
    ]
    if len(evidence.points) < FEW_POINTS:
        return found
    for family, fit in (("lying", fit_lying_cylinder(evidence)), ("sphere", fit_sphere(evidence))):
        found.append(FitCandidate(family, fit.shape, fit.X_WO, fit.agreement))
    found.append(_turned("lathe", fit_lathe(evidence)))
    hollow = fit_hollow(evidence)
    if hollow is not None:
        found.append(_turned("hollow", hollow))
    completed = complete(frame, support, evidence)
    found.append(FitCandidate("completed", completed.mesh, completed.X_WO, completed.agreement))
    return found


def _turned(family: str, fit: LatheFit) -> FitCandidate:
    profile = thinned(fit.profile)
    return FitCandidate(family, revolved(profile, LATHE_SIDES), fit.X_WO, fit.agreement, profile=profile)


def thinned(profile: Array) -> Array:
    """The profile without the corners that change it by less than ``PROFILE_STEP``; its ends stay on the axis."""
    import shapely

    line = shapely.LineString(np.round(profile, 4)).simplify(PROFILE_STEP, preserve_topology=False)
    return np.asarray(line.coords)


def confidence(candidate: FitCandidate, evidence: Evidence) -> float:
    """Confidence in a fit, in [0, 1]: the product of five shares.

    The share of measured pixels explained within the noise scale; the share of rays without intrusion into free space;
    ``exp(-fit / (5 % of the size))``; ``min(1, sqrt(points / 400))``; and 0.6 if a prior supplied an unseen extent, 0.7
    for a completed shape, whose far side is a guess throughout, else 1.
    """
    result = candidate.agreement
    size = float(np.ptp(evidence.points, axis=0).max())
    fit = math.exp(-result.fit / max(0.05 * size, 1e-6)) if math.isfinite(result.fit) else 0.0
    unseen = 0.6 if candidate.guessed else 0.7 if candidate.family == "completed" else 1.0
    enough = min(1.0, math.sqrt(len(evidence.points) / 400))
    value = result.explained * max(0.0, 1.0 - result.intrusion) * fit * enough * unseen
    return float(min(1.0, max(0.0, value)))


def size_of(geometry: Geometry) -> tuple[float, float, float]:
    """Extents of a geometry's bounding box in its own frame [m]."""
    if isinstance(geometry, Box):
        return float(geometry.size[0]), float(geometry.size[1]), float(geometry.size[2])
    if isinstance(geometry, Sphere):
        return (2 * geometry.radius,) * 3
    if isinstance(geometry, Mesh):
        extent = np.ptp(geometry.vertices, axis=0)
        return float(extent[0]), float(extent[1]), float(extent[2])
    height = geometry.height if isinstance(geometry, Cylinder) else geometry.height + 2 * geometry.radius
    return 2 * geometry.radius, 2 * geometry.radius, height


def _too_few(count: int) -> CaptureError:
    return CaptureError(
        "SF505",
        f"an object has depth at {count} pixels only; a shape needs {MIN_POINTS}",
        "give it a mask by hand, take the picture from nearer, or leave the object out",
    )
