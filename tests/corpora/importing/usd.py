"""USD: what OpenUSD says of a stage, of the scene that is imported, and of the stage that is compiled from it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.frontends.importer import ImportReport
from simfoundry.geometry.shapes import Mesh
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Scene
from tests.corpora.importing.outcome import LIMIT, MASS, Outcome

BOUND = 1e-4
"""By how much [m] the bounds of all meshes may differ."""


def load_usd(path: Path) -> Any:
    """The stage of a file; None where OpenUSD refuses it."""
    from pxr import Tf, Usd

    try:
        return Usd.Stage.Open(str(path))
    except Tf.ErrorException:
        return None


def compare_usd(outcome: Outcome, report: ImportReport, stage: Any, scene: Scene, compiled: Path) -> None:
    """Bounds of all that is seen in the import; masses and limits of what is compiled back."""
    _compare_bounds(outcome, stage, scene)
    theirs, ours = _masses(stage), _masses(load_usd(compiled))
    for mass in sorted(theirs):
        nearest = min(ours, key=lambda v: abs(v - mass), default=math.nan)
        outcome.compare("mass", nearest / mass, 1.0, MASS, f"a body of {mass:g} kg")
    told = [n for n in report.notes if n.what.startswith(("joint", "motion of", "limits of", "inertia of"))]
    theirs, ours = _limits(stage), _limits(load_usd(compiled))
    if not told:
        for limit in theirs:
            nearest = min(ours, key=lambda v: abs(v - limit), default=math.nan)
            outcome.compare("limit", nearest, limit, LIMIT * max(1.0, abs(limit)), "a joint")


def _masses(stage: Any) -> list[float]:
    """The masses [kg] that rigid bodies state."""
    from pxr import Usd, UsdPhysics

    unit = UsdPhysics.GetStageKilogramsPerUnit(stage)
    out = []
    for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
        if prim.HasAPI(UsdPhysics.RigidBodyAPI) and UsdPhysics.RigidBodyAPI(prim).GetRigidBodyEnabledAttr().Get():
            mass = float(UsdPhysics.MassAPI(prim).GetMassAttr().Get() or 0.0) * unit
            if mass > 0 and math.isfinite(mass):
                out.append(mass)
    return out


def _limits(stage: Any) -> list[float]:
    """The finite limits [rad or m] of revolute and prismatic joints between bodies, in any order."""
    from pxr import Usd, UsdGeom, UsdPhysics

    unit = UsdGeom.GetStageMetersPerUnit(stage)
    out = []
    for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
        for kind, factor in ((UsdPhysics.RevoluteJoint, math.pi / 180), (UsdPhysics.PrismaticJoint, unit)):
            if not prim.IsA(kind) or not UsdPhysics.Joint(prim).GetJointEnabledAttr().Get():
                continue
            low, high = kind(prim).GetLowerLimitAttr().Get(), kind(prim).GetUpperLimitAttr().Get()
            if low is not None and high is not None and math.isfinite(low) and math.isfinite(high) and low < high:
                out += [float(low) * factor, float(high) * factor]
    return out


def _compare_bounds(outcome: Outcome, stage: Any, scene: Scene) -> None:
    from pxr import Usd, UsdGeom

    to_m = UsdGeom.GetStageMetersPerUnit(stage)
    y_up = UsdGeom.GetStageUpAxis(stage) == "Y"
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    cache = UsdGeom.XformCache()
    for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
        if not prim.IsA(UsdGeom.Mesh) or UsdGeom.Imageable(prim).ComputeVisibility() == "invisible":
            continue
        if UsdGeom.Imageable(prim).ComputePurpose() not in ("default", "render"):
            continue
        points = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get() or [], dtype=float).reshape(-1, 3)
        used = np.unique(np.array(UsdGeom.Mesh(prim).GetFaceVertexIndicesAttr().Get() or [], dtype=int))
        if not len(used):
            continue
        X = np.array(cache.GetLocalToWorldTransform(prim)).T
        world = (points[used] @ X[:3, :3].T + X[:3, 3]) * to_m
        world = np.column_stack([world[:, 0], -world[:, 2], world[:, 1]]) if y_up else world
        low, high = np.minimum(low, world.min(axis=0)), np.maximum(high, world.max(axis=0))
    corners = []
    for item in scene.objects:
        poses = link_poses(item)
        for link in item.links:
            for visual in link.visuals:
                if isinstance(visual.geometry, Mesh):
                    X_WG = item.X_WO @ poses[link.name] @ visual.X_LG
                    corners.append(X_WG.apply(visual.geometry.vertices))
    if corners and np.isfinite(low).all():
        points = np.concatenate(corners)
        for k, axis in enumerate("xyz"):
            outcome.compare(
                "bound", float(points[:, k].min()), float(low[k]), BOUND, f"the lowest {axis} of all meshes"
            )
            outcome.compare("bound", float(points[:, k].max()), float(high[k]), BOUND, f"the highest {axis}")
