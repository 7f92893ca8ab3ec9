"""Read masses, centers of mass and inertias of rigid bodies in a USD stage, in SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from simfoundry.frontends.draft import LinkDraft, ModelDraft
from simfoundry.frontends.mass_repair import WATER_DENSITY, assume_density
from simfoundry.frontends.usd.geoms import UsdGprims
from simfoundry.frontends.usd.joints import attribute_pose
from simfoundry.geometry.frames import IDENTITY, Array, Pose

NOISE = 1e-9
"""Products of inertia below this fraction of the trace are noise of rotated axes in single precision."""


@dataclass
class UsdBody:
    """Rigid body of the stage.

    ``X_WB`` is its frame in the world and ``scale`` the scale of its units [m per unit]; ``X_BL`` is the link frame in
    the body frame, which a joint may change.
    """

    prim: Any
    X_WB: Pose
    scale: Array
    link: LinkDraft
    X_BL: Pose = IDENTITY


def add_mass(pxr: Any, draft: ModelDraft, body: UsdBody, colliders: list[Any], geoms: UsdGprims) -> None:
    """Set mass properties in the precedence of UsdPhysics: body mass, body density, collider masses and materials.

    Units are the same as in ``geoms``.
    """
    physics, link, to_m, to_kg = pxr.UsdPhysics, body.link, geoms.to_m, geoms.to_kg
    api = physics.MassAPI(body.prim)
    mass, density = api.GetMassAttr().Get(), api.GetDensityAttr().Get()
    masses = [float(m) for p in colliders if (m := physics.MassAPI(p).GetMassAttr().Get()) and m > 0]
    densities = {geoms.surface(p).density for p in colliders}
    if mass and mass > 0:
        link.mass = float(mass) * to_kg
        _add_inertia(body, api, to_kg * to_m**2)
    elif density and density > 0:
        link.density = float(density) * to_kg / to_m**3
    elif masses and len(masses) == len(colliders):
        link.mass = math.fsum(masses) * to_kg
        if len(masses) > 1:
            draft.changed(f"masses of the colliders of `{link.name}`", "their sum is spread by volume")
    elif len(densities) == 1 and None not in densities:
        link.density = densities.pop()
    elif link.colliders:
        assume_density(draft, link, f"{WATER_DENSITY:g} kg/m^3, as UsdPhysics takes it")
    else:
        link.mass, link.com, link.assumed = 1.0, np.zeros(3), "import"
        draft.assumed(f"mass of `{link.name}`", "none is given and nothing of it touches; 1 kg, as PhysX takes it")


def _add_inertia(body: UsdBody, api: Any, unit: float) -> None:
    """Set the center of mass and inertia of a body, in the link frame, if the stage specifies them."""
    link, X_LB = body.link, body.X_BL.inverse()
    com = api.GetCenterOfMassAttr().Get()
    is_given = api.GetCenterOfMassAttr().HasAuthoredValue() and all(math.isfinite(v) for v in com)
    if is_given:
        link.com = X_LB.apply(np.array(com, dtype=np.float64) * body.scale)
    diagonal = np.array(api.GetDiagonalInertiaAttr().Get() or (0, 0, 0), dtype=np.float64)
    if not diagonal.any():
        return
    R_LI = (X_LB @ attribute_pose(body.prim, None, api.GetPrincipalAxesAttr().Get())).rotation
    inertia = R_LI @ np.diag(diagonal * unit) @ R_LI.T
    link.inertia = np.where(np.abs(inertia) < NOISE * np.trace(inertia), 0.0, (inertia + inertia.T) / 2)
    if not is_given:
        link.com = X_LB.p.copy()
