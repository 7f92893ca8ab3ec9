"""Random splats for tests, with values from the whole range that trainers write."""

from __future__ import annotations

import numpy as np

from simfoundry.splats.gaussians import GaussianSplat, gaussian_splat


def random_splat(count: int, degree: int, seed: int, extremes: bool = True, spread: float = 3.0) -> GaussianSplat:
    """Return ``count`` Gaussians within a few times ``spread`` [m]; extremes are opaque or flat."""
    rng = np.random.default_rng(seed)
    opacities = 1 / (1 + np.exp(-rng.normal(0, 3, count)))
    scales = np.exp(rng.normal(-3, 1, (count, 3)))
    if extremes:
        opacities[:: max(1, count // 3)] = rng.choice([0.0, 1.0])
        scales[:: max(1, count // 2), 2] = 0.0
    return gaussian_splat(
        "random",
        positions=rng.normal(0, spread, (count, 3)),
        scales=scales,
        rotations=rng.normal(size=(count, 4)),
        opacities=opacities,
        harmonics=rng.normal(0, 0.3, (count, (degree + 1) ** 2, 3)),
    )
