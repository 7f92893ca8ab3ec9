"""Mass matrices by MuJoCo."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

STATES = 3
"""Joint states at which mass matrices are compared."""

TOLD = ("inertia of", "mass of", "motion of", "armature of")
"""How notes of an import start that explain another mass matrix."""


def mass_matrix(model: Any, data: Any) -> NDArray[np.float64]:
    """The mass matrix at the state of ``data``, shape (nv, nv)."""
    import mujoco

    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    try:
        mujoco.mj_fullM(model, data, full)
    except TypeError:  # before MuJoCo 3.4
        mujoco.mj_fullM(model, full, data.qM)
    return full
