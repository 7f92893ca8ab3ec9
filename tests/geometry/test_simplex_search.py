"""Test that the simplex search takes the same steps as that of SciPy."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import minimize

from simfoundry.geometry.frames import Array
from simfoundry.geometry.simplex_search import minimize_simplex


def _bowl(x: Array) -> float:
    return float(((np.arange(1, len(x) + 1) * x - 0.3) ** 2).sum())


def _stairs(x: Array) -> float:
    """Costs that are equal at many corners, as those that count pixels are."""
    return round(_bowl(x), 2)


def _waves(x: Array) -> float:
    return float(np.sin(5 * x).sum() + np.abs(x).sum())


def _cliff(x: Array) -> float:
    return np.inf if x[0] > 0.2 else _bowl(x)


@pytest.mark.parametrize("cost", [_bowl, _stairs, _waves, _cliff])
@pytest.mark.parametrize("count", [1, 3, 6])
@pytest.mark.parametrize("evaluations", [2, 9, 60, 400])
def test_the_steps_are_those_of_scipy(cost: Callable[[Array], float], count: int, evaluations: int) -> None:
    start = np.linspace(0.4, -0.2, count)
    simplex = np.vstack([start, start + np.diag(np.linspace(0.1, 0.25, count))])
    options = {"initial_simplex": simplex, "maxfev": evaluations, "xatol": 2e-4, "fatol": 1e-4}
    with np.errstate(invalid="ignore"):
        expected = minimize(cost, start, method="Nelder-Mead", options=options)
        value, x = minimize_simplex(cost, simplex, evaluations, near=2e-4, flat=1e-4)
    assert value == expected.fun
    assert x.tolist() == expected.x.tolist()
