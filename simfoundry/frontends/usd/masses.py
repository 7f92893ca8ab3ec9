"""Masses, centres of mass and inertias of the rigid bodies of a USD stage, in SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from simfoundry.frontends.draft import Draft, LinkDraft
from simfoundry.frontends.mass_repair import USUAL_DENSITY, take_density
from simfoundry.frontends.usd.geoms import Geoms
from simfoundry.geometry.frames import IDENTITY, Array, Pose


@dataclass
class Body:
    """A rigid body of the stage.

    ``X_WB`` is its frame in the world, ``scale`` that of its units [m per unit]; ``X_BL`` is the frame of its link in
    its own, which a joint may move.
    """

    prim: Any
    X_WB: Pose
    scale: Array
    link: LinkDraft
    X_BL: Pose = IDENTITY


def weigh(pxr: Any, draft: Draft, body: Body, colliders: list[Any], geoms: Geoms, units: tuple[float, float]) -> None:
    """Mass properties in UsdPhysics' order: mass of the body, its density, masses and materials of its colliders.

    ``units`` are the metres and kilograms of one unit of the stage.
    """
    physics, link, (to_m, to_kg) = pxr.UsdPhysics, body.link, units
    api = physics.MassAPI(body.prim)
    mass, density = api.GetMassAttr().Get(), api.GetDensityAttr().Get()
    if mass and mass > 0:
        link.mass = float(mass) * to_kg
        _inertia(body, api, to_kg * to_m**2)
        return
    if density and density > 0:
        link.density = float(density) * to_kg / to_m**3
        return
    masses = [float(m) for p in colliders if (m := physics.MassAPI(p).GetMassAttr().Get()) and m > 0]
    if masses and len(masses) == len(colliders):
        link.mass = math.fsum(masses) * to_kg
        if len(masses) > 1:
            draft.changed(f"masses of the colliders of `{link.name}`", "their sum is spread by volume")
        return
    densities = {geoms.surface(p).density for p in colliders}
    known = densities.pop() if len(densities) == 1 else None
    if known is not None:
        link.density = known
    elif any(part.use != "visual" for part in link.parts):
        take_density(draft, link, f"{USUAL_DENSITY:g} kg/m^3, as UsdPhysics takes it")
    else:
        link.mass, link.com, link.assumed = 1.0, np.zeros(3), "import"
        draft.assumed(f"mass of `{link.name}`", "none is given and nothing of it touches; 1 kg, as PhysX takes it")


def _inertia(body: Body, api: Any, unit: float) -> None:
    """Centre of mass and inertia of a body where the stage gives them, in the frame of its link."""
    link, X_LB = body.link, body.X_BL.inverse()
    com = api.GetCenterOfMassAttr().Get()
    given = api.GetCenterOfMassAttr().HasAuthoredValue() and all(math.isfinite(v) for v in com)
    if given:
        link.com = X_LB.apply(np.array(com, dtype=np.float64) * body.scale)
    diagonal = np.array(api.GetDiagonalInertiaAttr().Get() or (0, 0, 0), dtype=np.float64)
    if not diagonal.any():
        return
    axes = Pose.of()
    rotation = api.GetPrincipalAxesAttr().Get()
    if rotation is not None and (rotation.GetReal() or any(rotation.GetImaginary())):
        axes = Pose.of(q=[rotation.GetReal(), *rotation.GetImaginary()])
    R_LI = (X_LB @ axes).rotation
    inertia = R_LI @ np.diag(diagonal * unit) @ R_LI.T
    link.inertia = np.where(np.abs(inertia) < 1e-9 * np.trace(inertia), 0.0, (inertia + inertia.T) / 2)
    if not given:
        link.com = X_LB.p.copy()
