"""The world frame of a stage, in meters and with z up.

It can be determined for any stage units and for any way of including a compiled stage in another stage.
"""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING

import numpy as np

from simfoundry.frontends.usd.compiled.stage import StageError, factored
from simfoundry.geometry.frames import Array

if TYPE_CHECKING:
    from pxr import Usd

# Relative tolerance for the scale of a corrective transform; inches are often written as 0.0254 or 39.37.
SAME_SIZE = 1e-4

# Cosine of the maximum tilt (8 degrees) that counts as upright.
UPRIGHT_COS = 0.99

# Rotation from a frame with y up to a frame with z up.
Y_TO_Z = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])


class StageFrame:
    """A converter from the frames of prims to the world frame in meters with z up, at the earliest time.

    There are two ways to use a compiled stage in another stage with different units. A stronger layer does not change
    the numbers, so they are still in meters even if the layer declares other units. In contrast, a stage that
    references the compiled stage needs a parent transform to correct for different units or a different up axis. These
    two cases are distinguished by the transform of the document's prim.

    ``X_WS``, shape (4, 4), is the transform from the frame and units of the stage to the world.
    """

    def __init__(self, stage: Usd.Stage, carrier: Usd.Prim) -> None:
        from pxr import Usd, UsdGeom

        self.cache = UsdGeom.XformCache(Usd.TimeCode.EarliestTime())
        self.to_m, self.X_WS = 1.0, np.eye(4)
        self._choose(stage, np.array(self.cache.GetLocalToWorldTransform(carrier), dtype=np.float64).T, carrier)

    def matrix(self, prim: Usd.Prim) -> Array:
        """Return the transform from a prim's frame to the world, for row vectors as in USD.

        Returns:
            Transformation matrix, shape (4, 4).
        """
        return np.asarray(np.array(self.cache.GetLocalToWorldTransform(prim), dtype=np.float64) @ self.X_WS.T)

    def anew(self) -> StageFrame:
        """Return a copy without any cached transforms, for a stage that differs only in its session layer."""
        from pxr import Usd, UsdGeom

        other = copy(self)
        other.cache = UsdGeom.XformCache(Usd.TimeCode.EarliestTime())
        return other

    def _choose(self, stage: Usd.Stage, X_SC: Array, carrier: Usd.Prim) -> None:
        """Interpret numbers as meters or as stage units, whichever preserves the size of the document's prim."""
        from pxr import UsdGeom

        unit = float(UsdGeom.GetStageMetersPerUnit(stage))
        up = str(UsdGeom.GetStageUpAxis(stage))
        declared = np.eye(4)
        declared[:3, :3] = unit * (Y_TO_Z if up == "Y" else np.eye(3))
        as_meters, as_declared = (_scale(X @ X_SC) for X in (np.eye(4), declared))
        if as_meters is None and as_declared is None and abs(unit - 1.0) > SAME_SIZE:
            factors = " x ".join(f"{v:.4g}" for v in factored(X_SC.T)[1])
            raise StageError(
                f"{carrier.GetPath()}: it is scaled by {factors} in a stage with a unit of {unit:g} m, which neither "
                f"preserves the size of the document nor looks intentional; scale it by {1 / unit:g}, or set the "
                "stage's `metersPerUnit` to 1"
            )
        turned = _is_upright(declared @ X_SC) and not _is_upright(X_SC)
        if as_declared is not None and (as_meters is None or turned):
            declared[:3, :3] /= as_declared
            self.X_WS, self.to_m = declared, unit
        elif as_declared is None and as_meters is None and turned:  # in meters, and scaled intentionally
            self.X_WS = declared


def _scale(X_WC: Array) -> float | None:
    """Return the uniform scale of a transform, or None if the scale is non-uniform or not close to 1."""
    scale = factored(X_WC.T)[1]
    return float(scale.mean()) if bool(np.abs(scale - 1.0).max() <= SAME_SIZE) else None


def _is_upright(X_WC: Array) -> bool:
    """Return True if the z axis of the document points up in the world."""
    z = X_WC[:3, 2]
    return bool(z[2] >= UPRIGHT_COS * float(np.linalg.norm(z)))
